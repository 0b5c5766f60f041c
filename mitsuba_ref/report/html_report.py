"""The HTML report, a folder that is written scene by scene."""

import json
import re
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from caster.description.input_files import opened_input
from caster.system.atomic_files import OutputError, atomic_write, check_folder, write_text
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, SceneVerdict, Verdict, json_number
from mitsuba_ref.report.evidence import CLASS_COLORS, UNLISTED_COLOR
from mitsuba_ref.report.reproducers import replay, replay_around
from mitsuba_ref.report.scene_record import SceneRecord, scene_record
from mitsuba_ref.report.verdict_text import failure_text, group_lines, mark_of, outcome_text

MAX_PIXELS = 1 << 21  # of a window that a page shows: 80 MB for half as many; browsers run out of memory
SECONDS_BETWEEN_WRITES = 2.0  # of the list, during a run

RECORD_HEAD = "ray_reference_scene("  # what the file of a scene begins with


class HtmlReport:
    """Writes verdicts as pages. `keep` may be called from several threads, the other methods from one."""

    def __init__(self, path: str | Path, requested: int, candidate: str = "") -> None:
        """path: a folder. candidate: judged in place of our caster, where that is known before the first verdict.

        Raises OutputError where nothing can be written, or where another page is there.
        """
        self.path, self.requested, self.candidate = Path(path).absolute(), requested, candidate
        self.index = self.path / "index.html"
        if self.path.suffix.lower() == ".html":
            raise OutputError(f"{path}: a report is a folder, expected a name such as {Path(path).with_suffix('')}")
        refuse_page_of_others(self.index)
        self.data = check_folder(check_folder(self.path) / "data")
        self.rows: list[dict[str, Any]] = []
        self.verdicts: list[SceneVerdict] = []
        self._thumbnails: dict[str, str] = {}  # of the scenes whose record is written
        self._lock = threading.Lock()
        self._written = float("-inf")

    def keep(self, verdict: SceneVerdict) -> SceneVerdict:
        """Write the evidence of a verdict, and return the verdict without it. Raises OutputError."""
        found = page_record(verdict) if isinstance(verdict.seen, Seen) else verdict.seen
        if found is not None:
            about = {"verdict": verdict.to_dict(), **found.about}
            parts = {"about": as_json(about)} | {name: as_json(each) for name, each in found.layers.items()}
            write_text(self.data / file_of(verdict.name), record_script(verdict.name, parts))
            with self._lock:
                self._thumbnails[verdict.name] = found.thumbnail
        return replace(verdict, seen=None)

    def add(self, verdict: SceneVerdict) -> None:
        """Append a scene to the list, which is written every few seconds. Raises OutputError."""
        thumbnail = self._thumbnails.get(verdict.name)
        self.candidate = self.candidate or verdict.candidate
        self.rows.append(index_row(verdict, file_of(verdict.name) if thumbnail is not None else "", thumbnail or ""))
        self.verdicts.append(replace(verdict, seen=None))
        if time.monotonic() - self._written > SECONDS_BETWEEN_WRITES:
            self.write()

    def write(self) -> None:
        """Write the page of all scenes added so far. Raises OutputError."""
        with atomic_write(self.index) as part, part.open("w", encoding="utf-8") as file:
            file.writelines(page(self._run(), self.rows))
        self._written = time.monotonic()

    def sweep(self, spared: Collection[str] = ()) -> str:
        """Remove scenes of earlier reports that this page does not list, except `spared`; a line on their number."""
        listed = {row["file"] for row in self.rows} | {file_of(name) for name in spared}
        obsolete = [path for path in self.data.glob("*.js") if path.name not in listed and is_record(path)]
        for path in obsolete:
            path.unlink(missing_ok=True)
        return f"{self.path}: removed {len(obsolete)} scenes of an earlier report" if obsolete else ""

    def _run(self) -> dict[str, Any]:
        return {
            "summary": outcome_text(Verdict(tuple(self.verdicts), self.requested)),
            "candidate": self.candidate,
            "requested": self.requested,
            "classes": [*CLASSES, UNLISTED],
            "colors": CLASS_COLORS | {UNLISTED: UNLISTED_COLOR},
            "common": [" ".join(line.split()) for line in group_lines(self.verdicts)],
        }


def refuse_page_of_others(index: Path) -> None:
    """Raise OutputError for an existing file that is no report."""
    if not index.exists():
        return
    with opened_input(index, "page") as file:
        start = file.read(4096)
    if b"<title>ray-reference" not in start:
        raise OutputError(f"{index}: exists, and is no report of validate; choose another folder")


def is_record(path: Path) -> bool:
    """Whether a file was written by a report."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(len(RECORD_HEAD)) == RECORD_HEAD


def page_record(verdict: SceneVerdict) -> SceneRecord | None:
    """The record of a scene for its page; None without evidence, or of too many pixels."""
    if verdict.seen is None or len(verdict.seen.judgement.classes) > MAX_PIXELS:
        return None
    return scene_record(verdict.seen)


def file_of(scene: str) -> str:
    """Name of a scene's record in the folder data."""
    return f"{quote(scene, safe=' ')}.js"


def record_script(name: str, parts: Mapping[str, str]) -> str:
    """A script that passes a scene's record to the page."""
    inside = ",\n".join(f"{as_json(part)}:{text}" for part, text in parts.items())
    return f"{RECORD_HEAD}{as_json(name)},{{\n{inside}\n}});\n"


def write_report(path: str | Path, verdicts: Sequence[SceneVerdict], requested: int) -> Path:
    """Write a whole report; returns the file to open. Raises OutputError."""
    report = HtmlReport(path, requested)
    for verdict in verdicts:
        report.add(report.keep(verdict))
    report.write()
    report.sweep()
    return report.index


# ---- the page ----


# Plain scripts of the folder `page`, in this order, in one scope: a page opened from a file may not load modules.
SCRIPTS = (
    "floats", "arrays", "colors", "record", "state", "layers", "paint", "legend", "rows", "list", "panes", "zoom",
    "pointer", "inspector", "summary", "scene", "help", "keys", "start",
)  # fmt: skip


def page(run: dict[str, Any], rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The page in pieces. run: data of the whole run; rows: of the index."""
    scripts = "\n".join(_part(f"{name}.js") for name in SCRIPTS)
    before, after = _part("page.html").split("<!--DATA-->")
    yield before.replace("/*STYLE*/", _part("page.css"))
    yield f'<script type="application/json" id="index">{as_json(run | {"scenes": rows})}</script>\n'
    yield after.replace("/*SCRIPT*/", f'(function () {{\n"use strict";\n{scripts}}})();')


def as_json(value: Any) -> str:
    """JSON that may stand in a script element: no text can end it."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _part(name: str) -> str:
    return (resources.files("mitsuba_ref.report") / "page" / name).read_text(encoding="utf-8")


def index_row(verdict: SceneVerdict, file: str, thumbnail: str) -> dict[str, Any]:
    """One scene of the index. file: its record in the folder data, "" without any."""
    first = verdict.failures[0] if verdict.failures else None
    check, ratio = (first.check, first.ratio) if first else verdict.worst
    failed = {each.check for each in verdict.failures} | {each.name for each in verdict.checks if not each.ok}
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
        "failed_at": sorted(failed),
        "failure": "" if verdict.ok else re.sub("^FAIL", mark_of(verdict), failure_text(verdict), flags=re.MULTILINE),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
        "pixel": None if first is None else [first.x, first.y],
    }
