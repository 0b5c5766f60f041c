"""The HTML report, a folder that is written scene by scene."""

import json
import re
import threading
import time
from collections.abc import Collection, Iterator, Sequence
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
from mitsuba_ref.report.verdict_text import failing_checks, failure_text, group_lines, mark_of, outcome_text

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
        self.verdicts: list[SceneVerdict] = []
        self._thumbnails: dict[str, str] = {}  # of the scenes whose record is written
        self._lock = threading.Lock()
        self._written = float("-inf")

    def keep(self, verdict: SceneVerdict) -> SceneVerdict:
        """Write the evidence of a verdict, and return the verdict without it. Raises OutputError."""
        found = page_record(verdict) if isinstance(verdict.seen, Seen) else verdict.seen
        if found is not None:
            about = {"verdict": verdict.to_dict(), **found.about}
            parts = {"about": script_json(about)} | {name: script_json(each) for name, each in found.layers.items()}
            inside = ",\n".join(f"{script_json(part)}:{text}" for part, text in parts.items())
            script = f"{RECORD_HEAD}{script_json(verdict.name)},{{\n{inside}\n}});\n"  # passes the record to the page
            write_text(self.data / file_of(verdict.name), script)
            with self._lock:
                self._thumbnails[verdict.name] = found.thumbnail
        return replace(verdict, seen=None)

    def add(self, verdict: SceneVerdict) -> None:
        """Append a scene to the list, which is written every few seconds. Raises OutputError."""
        self.verdicts.append(verdict)
        if time.monotonic() - self._written > SECONDS_BETWEEN_WRITES:
            self.write()

    def write(self) -> None:
        """Write the page of all scenes added so far. Raises OutputError."""
        verdict = Verdict(tuple(self.verdicts), self.requested, requested_candidate=self.candidate)
        run = {
            "summary": outcome_text(verdict),
            "candidate": verdict.candidate,
            "requested": self.requested,
            "classes": [*CLASSES, UNLISTED],
            "colors": CLASS_COLORS | {UNLISTED: UNLISTED_COLOR},
            "common": [" ".join(line.split()) for line in group_lines(self.verdicts)],
        }
        with atomic_write(self.index) as part, part.open("w", encoding="utf-8") as file:
            file.writelines(page(run, [index_row(each, self._thumbnails.get(each.name)) for each in self.verdicts]))
        self._written = time.monotonic()

    def sweep(self, spared: Collection[str] = ()) -> str:
        """Remove scenes of earlier reports that this page does not list, except `spared`; a line on their number."""
        listed = {file_of(name) for name in (*self._thumbnails, *spared)}
        obsolete = [path for path in self.data.glob("*.js") if path.name not in listed and is_record(path)]
        for path in obsolete:
            path.unlink(missing_ok=True)
        return f"{self.path}: removed {len(obsolete)} scenes of an earlier report" if obsolete else ""


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
    yield f'<script type="application/json" id="index">{script_json(run | {"scenes": rows})}</script>\n'
    yield after.replace("/*SCRIPT*/", f'(function () {{\n"use strict";\n{scripts}}})();')


def script_json(value: Any) -> str:
    """JSON that may stand in a script element: no text can end it."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _part(name: str) -> str:
    return (resources.files("mitsuba_ref.report") / "page" / name).read_text(encoding="utf-8")


SAME_AS_VERDICT = ("name", "path", "ok", "size", "hit_pixels", "counts", "failing", "adjudicated")


def index_row(verdict: SceneVerdict, thumbnail: str | None) -> dict[str, Any]:
    """One scene of the index. thumbnail: None for a scene without a record in the folder data."""
    check, ratio = (verdict.failures[0].check, verdict.failures[0].ratio) if verdict.failures else verdict.worst
    return {name: getattr(verdict, name) for name in SAME_AS_VERDICT} | {
        "file": "" if thumbnail is None else file_of(verdict.name),
        "thumbnail": thumbnail or "",
        "mark": mark_of(verdict),
        "crashed": bool(verdict.problem),
        "unlisted": verdict.cases.get(UNLISTED, 0),
        "worst": [check, json_number(ratio)],
        "ratios": {name: json_number(share) for name, share in verdict.ratios.items()},
        "seconds": round(verdict.seconds, 2),
        "failed_at": sorted(failing_checks(verdict)),
        "failure": "" if verdict.ok else re.sub("^FAIL", mark_of(verdict), failure_text(verdict), flags=re.MULTILINE),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
    }
