"""The HTML report, written scene by scene, as a folder or as one file."""

import html
import json
import re
import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from caster.description.input_files import opened_input
from caster.system.atomic_files import (
    OutputError,
    ScratchFolder,
    atomic_write,
    check_folder,
    check_writable,
    write_text,
)
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, WRONG, SceneVerdict, json_number
from mitsuba_ref.report.evidence import Evidence
from mitsuba_ref.report.output_manifest import ManifestEntry, OutputManifest, RemovedFiles
from mitsuba_ref.report.reproducers import replay, replay_around
from mitsuba_ref.report.scene_record import PIXEL_LAYERS, SceneRecord, scene_record
from mitsuba_ref.report.verdict_text import class_text, failure_text, group_lines, mark_of

# One file: opens within two seconds on a small machine, and is accepted by mail and CI servers.
ONE_FILE_LIMIT_BYTES = 25_000_000

# Pixels of a scene up to which everything is written to the bit (80 MB), and up to which as float32 (as much again).
# Beyond, browsers run out of memory.
MAX_PIXELS_EXACT = 1 << 20
MAX_PIXELS_WITH_IMAGES = 1 << 22
SECONDS_BETWEEN_WRITES = 2.0  # of the list, during a run


class WrittenScene(NamedTuple):
    """Files and sizes of one scene's record."""

    file: str  # in the folder data; "" for nothing
    thumbnail: str
    sizes: dict[str, int]  # bytes of each part of its record


WAIVED_WORDS = {"KNOWN": "known to fail", "SKIP": "declined by the candidate"}  # by the mark of the row
NOTHING_WRITTEN = WrittenScene("", "", {})


def refuse_page_of_others(index: Path) -> None:
    """Raise OutputError for an existing file that is no report."""
    if not index.exists():
        return
    with opened_input(index, "page") as (file, _):
        start = file.read(4096)
    if b"<title>ray-reference" not in start:
        raise OutputError(f"{index}: exists, and is no report of validate; choose another folder")


class HtmlReport:
    """Writes verdicts as pages. `keep` may be called from several threads, the other methods from one."""

    def __init__(self, path: str | Path, requested: int, candidate: str = "") -> None:
        """path: a folder, or a file if it ends in .html. candidate: judged in place of our caster, where that is
        known before the first verdict. Raises OutputError where nothing can be written."""
        self.path, self.requested = Path(path).absolute(), requested
        self.one_file = self.path.suffix.lower() == ".html"
        self.candidate = candidate
        self.rows: list[dict[str, Any]] = []
        self.verdicts: list[SceneVerdict] = []
        self._kept: dict[str, WrittenScene] = {}
        self._lock = threading.Lock()
        self._written = float("-inf")
        if self.one_file:
            check_writable(self.path)
            self._temporary = ScratchFolder()
            self.data = Path(self._temporary.name)
        else:
            refuse_page_of_others(self.path / "index.html")
            self.data = check_folder(check_folder(self.path) / "data")
        self._data = OutputManifest(self.data)

    @property
    def index(self) -> Path:
        """The file to open."""
        return self.path if self.one_file else self.path / "index.html"

    def holds(self, verdict: SceneVerdict) -> bool:
        """Whether the record of a verdict of the same inputs is in the folder; never in one file."""
        return verdict.pixels > MAX_PIXELS_WITH_IMAGES or self.one_file or self._of_earlier(verdict) is not None

    def _of_earlier(self, verdict: SceneVerdict) -> ManifestEntry | None:
        if self.one_file or not verdict.inputs:
            return None
        return self._data.unchanged(file_of(verdict), inputs=verdict.inputs)

    def keep(self, verdict: SceneVerdict) -> SceneVerdict:
        """Write down what a verdict rests on, and give it back without. Raises OutputError."""
        before = self._of_earlier(verdict) if verdict.kept else None
        if before is not None:
            self._data.add(verdict.name, [file_of(verdict)], **before.labels)
            with self._lock:
                self._kept[verdict.name] = WrittenScene(file_of(verdict), before.labels.get("thumbnail", ""), {})
        seen = verdict.seen
        found = page_record(verdict, one_file=self.one_file) if isinstance(seen, Evidence) else seen
        if found is None:
            return replace(verdict, seen=None)
        about = {"verdict": verdict.to_dict(), **found.about}
        parts = {"about": as_json(about)} | {name: as_json(each) for name, each in found.layers.items()}
        file = file_of(verdict)
        text = record_lines(parts) if self.one_file else record_script(verdict.name, parts)
        write_text(self.data / file, text)
        self._data.add(verdict.name, [file], inputs=verdict.inputs, thumbnail=found.thumbnail)
        sizes = {name: len(text.encode()) for name, text in parts.items()}
        with self._lock:
            self._kept[verdict.name] = WrittenScene(file, found.thumbnail, sizes)
        return replace(verdict, seen=None)

    def add(self, verdict: SceneVerdict) -> None:
        """Append a scene to the list; the list is written every few seconds. Raises OutputError."""
        kept = self._kept.get(verdict.name, NOTHING_WRITTEN)
        self.candidate = self.candidate or verdict.candidate
        self.rows.append(index_row(verdict, kept.file, kept.thumbnail))
        self.verdicts.append(replace(verdict, seen=None))
        if not self.one_file and time.monotonic() - self._written > SECONDS_BETWEEN_WRITES:
            self.write()

    def write(self) -> None:
        """Write the page of all scenes added so far. Raises OutputError."""
        run = self._run()
        scenes: Iterator[str] = iter(())
        if self.one_file:
            room = ONE_FILE_LIMIT_BYTES - sum(len(text.encode()) for text in page(run, self.rows))
            listed = [each["name"] for each in self.rows]
            sizes = {name: self._kept[name].sizes for name in listed if name in self._kept}
            chosen = choose(self.rows, sizes, room, PIXEL_LAYERS)
            run["left_out"] = left_out(sizes, chosen)
            scenes = elements(self.data, self.rows, chosen)
        with atomic_write(self.index) as part, part.open("w", encoding="utf-8") as file:
            file.writelines(page(run, self.rows, scenes))
        self._written = time.monotonic()

    def sweep(self, spared: Collection[str] = ()) -> RemovedFiles:
        """Remove scenes of earlier reports that this page does not list, except these. Raises OutputError."""
        return RemovedFiles() if self.one_file else self._data.sweep(lambda scene: scene in spared)

    def close(self) -> None:
        """Remove temporary files."""
        if self.one_file:
            self._temporary.cleanup()

    def _run(self) -> dict[str, Any]:
        passed = sum(each["ok"] for each in self.rows)
        summary = f"{passed} of {len(self.rows)} scenes pass"
        for mark, words in WAIVED_WORDS.items():
            count = sum(each["mark"] == mark for each in self.rows)
            summary += f"; {count} {words}" if count else ""
        if len(self.rows) < self.requested:
            summary += f"; {self.requested - len(self.rows)} of {self.requested} were not judged"
        return {
            "summary": summary,
            "candidate": self.candidate,
            "requested": self.requested,
            "classes": [*CLASSES, UNLISTED],
            "one_file": self.one_file,
            "most_bytes": ONE_FILE_LIMIT_BYTES,
            "left_out": {},
            "common": [" ".join(line.split()) for line in group_lines(self.verdicts)],
        }


def page_record(verdict: SceneVerdict, *, one_file: bool) -> SceneRecord | None:
    """What a page of a scene shows of its evidence; None for a film too large. one_file: of a report in one file."""
    if verdict.seen is None or verdict.pixels > MAX_PIXELS_WITH_IMAGES:
        return None
    rounded = (one_file and verdict.ok) or verdict.pixels > MAX_PIXELS_EXACT
    return scene_record(verdict.seen, exact=not rounded)


def file_of(verdict: SceneVerdict) -> str:
    """Name of a scene's record in the folder data."""
    return f"{quote(verdict.name, safe=' ')}.js"


def record_script(name: str, parts: Mapping[str, str]) -> str:
    """A script that passes a scene's record to the page."""
    inside = ",\n".join(f"{as_json(part)}:{text}" for part, text in parts.items())
    return f"ray_reference_scene({as_json(name)},{{\n{inside}\n}});\n"


def write_report(path: str | Path, verdicts: Sequence[SceneVerdict], requested: int) -> Path:
    """Write a whole report; returns the file to open. Raises OutputError."""
    report = HtmlReport(path, requested)
    try:
        for verdict in verdicts:
            report.add(report.keep(verdict))
        report.write()
        report.sweep()
    finally:
        report.close()
    return report.index


# ---- the page: template, index of scenes, and for one file the records that fit into it ----

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
    missing = {scene: [part for part in parts if (scene, part) not in chosen] for scene, parts in sizes.items()}
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
    return (resources.files("mitsuba_ref.report") / "page" / name).read_text(encoding="utf-8")


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
    failing_first = sorted(enumerate(rows), key=lambda each: each[1]["mark"] != "FAIL")
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
    return class_text(name)


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
    mark = row["mark"]
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
        "mark": mark_of(verdict),
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
        "failure": "" if verdict.ok else re.sub("^FAIL", mark_of(verdict), failure_text(verdict), flags=re.MULTILINE),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
        "pixel": None if first is None else [first.x, first.y],
    }


def _failed_checks(verdict: SceneVerdict) -> set[str]:
    return {check.name for check in verdict.checks if not check.ok}
