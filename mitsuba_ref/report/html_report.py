"""The HTML report, a folder that is written scene by scene."""

import inspect
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from importlib import resources
from pathlib import Path
from time import monotonic
from typing import Any
from urllib.parse import quote

from caster import __version__
from caster.description.input_files import opened_input
from caster.system.atomic_files import OutputError, atomic_write, check_folder, write_text
from mitsuba_ref.error_model.tolerances import LARGEST_Z
from mitsuba_ref.judge.checks import all_checks
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, SceneVerdict, Verdict, json_number
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.evidence import CLASS_COLORS, UNLISTED_COLOR
from mitsuba_ref.report.reproducers import replay, replay_around
from mitsuba_ref.report.scene_record import CODES, SceneRecord, scene_record
from mitsuba_ref.report.verdict_text import (
    broken_checks,
    counts_shown,
    failing_checks,
    failure_text,
    group_lines,
    mark_of,
    outcome_text,
)

MAX_PIXELS = 1 << 21  # of a window that a page shows, each of which takes a third of a kB in the browser
SECONDS_BETWEEN_WRITES = 2.0  # of the list, during a run
GIT_SECONDS = 5.0  # that git may take to name the commit


class HtmlReport:
    """Writes verdicts as pages. `keep` may be called from several threads, the other methods from one."""

    def __init__(self, path: str | Path, requested: int, candidate: str = "") -> None:
        """path: a folder. candidate: judged in place of our caster, where that is known before the first verdict.

        Raises OutputError where nothing can be written, or where another page is there.
        """
        self.requested, self.candidate = requested, candidate
        self.index, self.data = report_folder(path)
        self.verdicts: list[SceneVerdict] = []
        self.thumbnails: dict[str, str] = {}  # of the scenes whose record is written
        self._written = float("-inf")
        self._about, self._started = run_facts(), monotonic()

    def keep(self, verdict: SceneVerdict) -> SceneVerdict:
        """Write the evidence of a verdict, and return the verdict without it. Raises OutputError."""
        found = page_record(verdict) if isinstance(verdict.seen, Seen) else verdict.seen
        if found is not None:
            about = {"verdict": verdict.to_dict(), **found.about}
            write_record(self.data, verdict.name, {"about": about, **found.layers})
            self.thumbnails[verdict.name] = found.thumbnail
        return replace(verdict, seen=None)

    def add(self, verdict: SceneVerdict) -> None:
        """Append a scene to the list, which is written every few seconds. Raises OutputError."""
        self.verdicts.append(verdict)
        if monotonic() - self._written > SECONDS_BETWEEN_WRITES:
            self.write()

    def write(self) -> None:
        """Write the page of all scenes added so far. Raises OutputError."""
        verdict = Verdict(tuple(self.verdicts), self.requested, requested_candidate=self.candidate)
        took = max([monotonic() - self._started, *(scene.seconds for scene in verdict.scenes if not scene.kept)])
        run = {
            **page_words(),
            "facts": [*self._about, ("duration", f"{took:.1f} s"), *(("reference", each) for each in verdict.versions)],
            "summary": outcome_text(verdict),
            "candidate": verdict.candidate,
            "requested": self.requested,
            "classes": [*CLASSES, UNLISTED],
            "colors": CLASS_COLORS | {UNLISTED: UNLISTED_COLOR},
            "common": [" ".join(line.split()) for line in group_lines(self.verdicts)],
        }
        rows = [index_row(each, self.thumbnails.get(each.name)) for each in self.verdicts]
        write_page(self.index, run, rows)
        self._written = monotonic()


def report_folder(path: str | Path) -> tuple[Path, Path]:
    """The page of a report and its folder of data, which is made. Raises OutputError."""
    folder = Path(path).absolute()
    index = folder / "index.html"
    if folder.suffix.lower() == ".html":
        raise OutputError(f"{path}: a report is a folder, expected a name such as {Path(path).with_suffix('')}")
    refuse_page_of_others(index)
    return index, check_folder(check_folder(folder) / "data")


def write_record(data: Path, name: str, parts: Mapping[str, Any]) -> None:
    """Write the record of a scene as a script that passes it to the page. Raises OutputError."""
    inside = ",\n".join(f"{script_json(part)}:{script_json(value)}" for part, value in parts.items())
    write_text(data / file_of(name), f"ray_reference_scene({script_json(name)},{{\n{inside}\n}});\n")


def run_facts() -> list[tuple[str, str]]:
    """Command, date, commit, versions and machine of this run."""
    program, *options = sys.argv or [""]
    name = "mitsuba-ref" if Path(program).name == "__main__.py" else Path(program).name
    found = [
        ("command", shlex.join([name, *options])),
        ("date", datetime.now().astimezone().isoformat(" ", "seconds")),
        ("commit", commit()),
        ("versions", f"caster {__version__}, {', '.join(f'{name} {each}' for name, each in machine().items())}"),
    ]
    return [(term, words) for term, words in found if words]


def commit(folder: str = ".") -> str:
    """The commit of a folder, with -dirty if files were changed; "" if there is none."""
    asked = ["git", "-C", folder, "describe", "--always", "--dirty", "--exclude=*"]
    with suppress(OSError, subprocess.TimeoutExpired):
        return subprocess.run(asked, capture_output=True, text=True, timeout=GIT_SECONDS, check=False).stdout.strip()
    return ""


def refuse_page_of_others(index: Path) -> None:
    """Raise OutputError for an existing file that is no report."""
    if not index.exists():
        return
    with opened_input(index, "page") as file:
        start = file.read(4096)
    if b"<title>ray-reference" not in start:
        raise OutputError(f"{index}: exists, and is no report of validate; choose another folder")


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
Json = dict[str, Any]  # for the scripts of the page
SCRIPTS = (
    "floats", "arrays", "colors", "record", "words", "state", "layers", "paint", "legend", "rows", "list", "panes",
    "zoom", "levels", "pointer", "inspector", "evidence", "summary", "scene", "help", "keys", "start",
)  # fmt: skip


def page_words() -> Json:
    """What the page needs to decode records, and the sentence of each scene check."""
    checks = {each.name: (inspect.getdoc(each.make) or "").partition("\n\n")[0] for each in all_checks()}
    return {"codes": CODES, "checks": checks, "largest_z": LARGEST_Z}


def write_page(index: Path, run: Json, rows: Sequence[Json]) -> None:
    """Write the page. Raises OutputError."""
    with atomic_write(index) as part, part.open("w", encoding="utf-8") as file:
        file.writelines(page(run, rows))


def page(run: Json, rows: Sequence[Json]) -> Iterator[str]:
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


SAME_AS_VERDICT = ("name", "path", "ok", "size", "hit_pixels", "failing", "adjudicated")


def index_row(verdict: SceneVerdict, thumbnail: str | None) -> Json:
    """One scene of the index. thumbnail: None for a scene without a record in the folder data."""
    broken = [(check.name, check.ratio) for check in broken_checks(verdict)]
    failed = [(failure.check, failure.ratio) for failure in verdict.failures]
    check, ratio = [*failed, *broken, verdict.worst][0]
    return {name: getattr(verdict, name) for name in SAME_AS_VERDICT} | {
        "file": "" if thumbnail is None else file_of(verdict.name),
        "thumbnail": thumbnail or "",
        "mark": mark_of(verdict),
        "counts": counts_shown(verdict),
        "crashed": bool(verdict.problem),
        "unlisted": verdict.cases.get(UNLISTED, 0),
        "worst": [check, json_number(ratio)],
        "ratios": {name: json_number(share) for name, share in verdict.ratios.items()},
        "seconds": round(verdict.seconds, 2),
        "failed_at": sorted(failing_checks(verdict)),
        "failure": "" if verdict.ok else re.sub("^FAIL", mark_of(verdict), failure_text(verdict), flags=re.MULTILINE),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
        "bounce": verdict.bounce,
        "view": verdict.view,
    }
