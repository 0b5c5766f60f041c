"""The page: its parts, which lie in the folder `page`, with what it is to show written into it."""

import html
import json
from collections.abc import Iterable, Iterator, Sequence
from importlib import resources
from typing import Any

from mitsuba_ref.verdict import UNLISTED

# Plain scripts, in this order, in one scope: a page opened from a file may not load modules.
SCRIPTS = (
    "floats", "arrays", "colors", "record", "state", "layers", "paint", "legend", "rows", "list", "panes", "zoom",
    "pointer", "inspector", "summary", "scene", "help", "keys", "start",
)  # fmt: skip


def page(run: dict[str, Any], rows: Sequence[dict[str, Any]], scenes: Iterable[str] = ()) -> Iterator[str]:
    """The page in pieces. run: what is said once; rows: of mitsuba_ref.report.index; scenes: elements to include."""
    told = run | {"scenes": [{key: each for key, each in row.items() if key != "thumbnail"} for row in rows]}
    before, between, after = _template()
    yield before
    yield _plain_table(run, rows)
    yield between
    yield f'<script type="application/json" id="index">{as_json(told)}</script>\n'
    yield from scenes
    yield after


def as_json(value: Any) -> str:
    """JSON that may stand in a script element: no text can end it."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _template() -> tuple[str, str, str]:
    """What stands before the plain table, between it and the data, and behind them."""
    scripts = "\n".join(_part(f"{name}.js") for name in SCRIPTS)
    before, rest = _part("page.html").split("<!--TABLE-->")
    between, after = rest.split("<!--DATA-->")
    alone = f'(function () {{\n"use strict";\n{scripts}}})();'
    return before.replace("/*STYLE*/", _part("page.css")), between, after.replace("/*SCRIPT*/", alone)


def _part(name: str) -> str:
    return (resources.files("mitsuba_ref.report") / "page" / name).read_text(encoding="utf-8")


def _plain_table(run: dict[str, Any], rows: Sequence[dict[str, Any]]) -> str:
    """All verdicts for a browser that runs no scripts; the scripts take the thumbnails from it."""
    classes = [name for name in run["classes"] if name != UNLISTED]
    heads = ["", "verdict", "scene", "hit", *(name.replace("_", " ") for name in classes), "worst", "seconds"]
    head = "".join(f'<th scope="col">{head}</th>' for head in heads)
    failing_first = sorted(enumerate(rows), key=lambda each: bool(each[1]["ok"]))
    body = "\n".join(_plain_row(place, row, classes) for place, row in failing_first)
    judged = f"candidate {run['candidate']}: " if run["candidate"] else ""
    return (
        f'<table id="plain"><caption>{html.escape(judged + run["summary"])}</caption>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>\n"
    )


def _plain_row(place: int, row: dict[str, Any], classes: Sequence[str]) -> str:
    picture = f'<img src="{row["thumbnail"]}" alt="" loading="lazy">' if row["thumbnail"] else ""
    check, ratio = row["worst"]
    worst = f"{ratio:.3g} {check.replace('_', ' ')}" if check and isinstance(ratio, float) else "-"
    name = f"<strong>{html.escape(row['name'])}</strong>"
    if row["says"]:
        name += f"<pre>{html.escape(row['says'])}</pre>"
    counts = [
        f"{row['hit']}",
        *(f"{row['counts'][each]}" for each in classes),
        worst,
        "kept" if row["kept"] else f"{row['seconds']:.1f}",
    ]
    mark = "PASS" if row["ok"] else "FAIL"
    cells = "".join(f"<td>{cell}</td>" for cell in [picture, mark, name, *counts])
    return f'<tr class="{mark.lower()}" data-place="{place}">{cells}</tr>'
