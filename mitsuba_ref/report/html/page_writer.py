"""Assembly of the report's page: template, index of scenes, and for one file the records that fit into it."""

import html
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mitsuba_ref.judge.verdict import UNLISTED, WRONG, SceneVerdict, json_number
from mitsuba_ref.report.reproducers import replay, replay_around
from mitsuba_ref.report.terminal import failure_text

ABOUT_PART = "about"  # the part that all others need

# Of each part: the element around it, or its name in the list of omitted parts.
ELEMENT_OVERHEAD_BYTES = 200

Sizes = Mapping[str, Mapping[str, int]]  # scene -> part -> bytes
Chosen = set[tuple[str, str]]  # scene, part


def choose(rows: Sequence[Mapping[str, Any]], sizes: Sizes, room: int, layers: Sequence[str]) -> Chosen:
    """Parts that fit into `room` bytes: all of the failing scenes first, then of the others layer by layer."""
    chosen: Chosen = set()
    room -= ELEMENT_OVERHEAD_BYTES * sum(map(len, sizes.values()))
    for scene, part in _in_order(rows, layers):
        size = sizes.get(scene, {}).get(part)
        if size is not None and size <= room and (part == ABOUT_PART or (scene, ABOUT_PART) in chosen):
            chosen.add((scene, part))
            room -= size
    return chosen


def _in_order(rows: Sequence[Mapping[str, Any]], layers: Sequence[str]) -> Iterator[tuple[str, str]]:
    failing = [row["name"] for row in rows if not row["ok"]]
    passing = [row["name"] for row in rows if row["ok"]]
    yield from ((scene, ABOUT_PART) for scene in (*failing, *passing))
    yield from ((scene, layer) for scene in failing for layer in layers)
    yield from ((scene, layer) for layer in layers for scene in passing)


def left_out(sizes: Sizes, chosen: Chosen) -> dict[str, list[str]]:
    """Scene -> its omitted parts."""
    missing = {
        scene: [part for part in parts if (scene, part) not in chosen] for scene, parts in sizes.items()
    }
    return {scene: parts for scene, parts in missing.items() if parts}


def record_lines(parts: Mapping[str, str]) -> str:
    """A scene's record in a temporary file: one line per part."""
    return "".join(f"{name} {text}\n" for name, text in parts.items())


def elements(folder: Path, rows: Sequence[Mapping[str, Any]], chosen: Chosen) -> Iterator[str]:
    """Inert script elements, one per part, which the page reads on demand."""
    for row in rows:
        if not row["file"]:
            continue
        for line in (folder / row["file"]).read_text(encoding="utf-8").splitlines():
            part, text = line.split(" ", 1)
            if (row["name"], part) in chosen:
                scene = quote(row["name"])
                yield f'<script type="application/json" data-scene="{scene}" data-part="{part}">{text}</script>\n'


# Plain scripts of the folder `page`, in this order, in one scope: a page opened from a file may not load modules.
SCRIPTS = (
    "floats", "arrays", "colors", "record", "state", "layers", "paint", "legend", "rows", "list", "panes", "zoom",
    "pointer", "inspector", "summary", "scene", "help", "keys", "start",
)  # fmt: skip


def page(run: dict[str, Any], rows: Sequence[dict[str, Any]], scenes: Iterable[str] = ()) -> Iterator[str]:
    """The page in pieces. run: data of the whole run; rows: of the index; scenes: elements to include."""
    index = run | {"scenes": [{key: each for key, each in row.items() if key != "thumbnail"} for row in rows]}
    before, between, after = _template()
    yield before
    yield _plain_table(run, rows)
    yield between
    yield f'<script type="application/json" id="index">{as_json(index)}</script>\n'
    yield from scenes
    yield after


def as_json(value: Any) -> str:
    """JSON that may stand in a script element: no text can end it."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _template() -> tuple[str, str, str]:
    """The page before the plain table, between it and the data, and after them."""
    scripts = "\n".join(_part(f"{name}.js") for name in SCRIPTS)
    before, rest = _part("page.html").split("<!--TABLE-->")
    between, after = rest.split("<!--DATA-->")
    alone = f'(function () {{\n"use strict";\n{scripts}}})();'
    return before.replace("/*STYLE*/", _part("page.css")), between, after.replace("/*SCRIPT*/", alone)


def _part(name: str) -> str:
    return (resources.files("mitsuba_ref.report.html") / "page" / name).read_text(encoding="utf-8")


def _plain_table(run: dict[str, Any], rows: Sequence[dict[str, Any]]) -> str:
    """All verdicts for a browser without scripts; the scripts take the thumbnails from it."""
    classes = [name for name in run["classes"] if name != UNLISTED]
    heads = [
        "",
        "verdict",
        "scene",
        "hit",
        *(class_words(name, run["candidate"]) for name in classes),
        "worst",
        "seconds",
    ]
    head = "".join(f'<th scope="col">{head}</th>' for head in heads)
    failing_first = sorted(enumerate(rows), key=lambda each: bool(each[1]["ok"]))
    body = "\n".join(_plain_row(place, row, classes) for place, row in failing_first)
    judged = f"candidate {run['candidate']}: " if run["candidate"] else ""
    return (
        f'<table id="plain"><caption>{html.escape(judged + run["summary"])}</caption>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>\n"
    )


def class_words(name: str, candidate: str) -> str:
    """A class for people: the subject is named where it is wrong."""
    if name == WRONG:
        return "candidate wrong" if candidate else "ours wrong"
    return name.replace("_", " ")


def _plain_row(place: int, row: dict[str, Any], classes: Sequence[str]) -> str:
    thumbnail = f'<img src="{row["thumbnail"]}" alt="" loading="lazy">' if row["thumbnail"] else ""
    check, ratio = row["worst"]
    worst = f"{ratio:.3g} {check.replace('_', ' ')}" if check and isinstance(ratio, float) else "-"
    name = f"<strong>{html.escape(row['name'])}</strong>"
    if row["failure"]:
        name += f"<pre>{html.escape(row['failure'])}</pre>"
    counts = [
        f"{row['hit']}",
        *(f"{row['counts'][each]}" for each in classes),
        worst,
        "kept" if row["kept"] else f"{row['seconds']:.1f}",
    ]
    mark = "PASS" if row["ok"] else "FAIL"
    cells = "".join(f"<td>{cell}</td>" for cell in [thumbnail, mark, name, *counts])
    return f'<tr class="{mark.lower()}" data-place="{place}">{cells}</tr>'


def index_row(verdict: SceneVerdict, file: str, thumbnail: str) -> dict[str, Any]:
    """One scene of the index. file: of its images in the folder data, "" without any."""
    first = verdict.failures[0] if verdict.failures else None
    check, ratio = (first.check, first.ratio) if first else verdict.worst
    return {
        "name": verdict.name,
        "path": verdict.path,
        "file": file,
        "thumbnail": thumbnail,
        "ok": verdict.ok,
        "crashed": bool(verdict.problem),
        "size": list(verdict.size),
        "hit": verdict.hit_pixels,
        "counts": dict(verdict.counts),
        "unlisted": verdict.cases.get(UNLISTED, 0),
        "failing": verdict.failing,
        "adjudicated": verdict.adjudicated,
        "worst": [check, json_number(ratio)],
        "ratios": {name: json_number(share) for name, share in verdict.ratios.items()},
        "seconds": round(verdict.seconds, 2),
        "kept": verdict.kept,
        "failed_at": sorted({each.check for each in verdict.failures} | _failed_checks(verdict)),
        "failure": "" if verdict.ok else failure_text(verdict),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
        "pixel": None if first is None else [first.x, first.y],
    }


def _failed_checks(verdict: SceneVerdict) -> set[str]:
    return {check.name for check in verdict.checks if not check.ok}
