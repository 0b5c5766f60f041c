"""A report as it comes to be: scene by scene, as a folder or as one file."""

import tempfile
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from caster.whole_files import OutputError, check_folder, check_writable, write_text, written_aside
from mitsuba_ref.report import one_file
from mitsuba_ref.report.assembling import as_json, page
from mitsuba_ref.report.index import row
from mitsuba_ref.report.record import LAYERS, record
from mitsuba_ref.verdict import CANDIDATE_WRONG, CLASSES, OURS_WRONG, UNLISTED, SceneVerdict
from mitsuba_ref.written import Listed, Swept, Written

# One file: what a browser opens within two seconds on a small machine, and mail and CI servers take.
MOST_BYTES = 25_000_000

# Pixels of a scene up to which everything is written to the bit: 80 MB, and up to which as float32: as much again.
# Beyond, browsers run out of memory.
EXACT_UP_TO = 1 << 20
PICTURES_UP_TO = 1 << 22
SECONDS_BETWEEN = 2.0  # writings of the list while a run goes on


class Kept(NamedTuple):
    """What was written of a scene."""

    file: str  # in the folder data; "" for nothing
    thumbnail: str
    sizes: dict[str, int]  # bytes of each part of its record


NOTHING_KEPT = Kept("", "", {})


def refuse_page_of_others(index: Path) -> None:
    """Raises OutputError for a file that is there and is no report."""
    if index.is_file() and b"<title>ray-reference" not in index.read_bytes()[:4096]:
        raise OutputError(f"{index}: is there already, and is no report of validate; choose another folder")


class Report:
    """Where verdicts become pages. `keep` may be called from several threads, the others from one."""

    def __init__(self, path: str | Path, asked: int, candidate: str = "") -> None:
        """path: a folder, or a file if it ends in .html. candidate: who is judged in the place of ours, where that is
        known before any verdict says so. Raises OutputError where nothing can be written."""
        self.path, self.asked = Path(path).absolute(), asked
        self.one_file = self.path.suffix.lower() == ".html"
        self.candidate = candidate
        self.rows: list[dict[str, Any]] = []
        self._kept: dict[str, Kept] = {}
        self._lock = threading.Lock()
        self._written = float("-inf")
        if self.one_file:
            check_writable(self.path)
            self._aside = tempfile.TemporaryDirectory(prefix="mitsuba-ref-report-")
            self.data = Path(self._aside.name)
        else:
            refuse_page_of_others(self.path / "index.html")
            self.data = check_folder(check_folder(self.path) / "data")
        self._data = Written(self.data)

    @property
    def index(self) -> Path:
        """The file to open."""
        return self.path if self.one_file else self.path / "index.html"

    def holds(self, verdict: SceneVerdict) -> bool:
        """Whether what a verdict of the same inputs rests on was written here before; one file holds nothing."""
        return verdict.pixels > PICTURES_UP_TO or self.one_file or self._of_earlier(verdict) is not None

    def _of_earlier(self, verdict: SceneVerdict) -> Listed | None:
        if self.one_file or not verdict.inputs:
            return None
        return self._data.as_told(file_of(verdict), inputs=verdict.inputs)

    def keep(self, verdict: SceneVerdict) -> SceneVerdict:
        """Write down what a verdict rests on, and give it back without. Raises OutputError."""
        before = self._of_earlier(verdict) if verdict.kept else None
        if before is not None:
            self._data.add(verdict.name, [file_of(verdict)], **before.told)
            with self._lock:
                self._kept[verdict.name] = Kept(file_of(verdict), before.told.get("thumbnail", ""), {})
        if verdict.seen is None or verdict.pixels > PICTURES_UP_TO:
            return replace(verdict, seen=None)
        rounded = (self.one_file and verdict.ok) or verdict.pixels > EXACT_UP_TO
        found = record(verdict, verdict.seen, exact=not rounded)
        parts = {"about": as_json(found.about)} | {name: as_json(each) for name, each in found.layers.items()}
        file = file_of(verdict)
        text = one_file.aside(parts) if self.one_file else called(verdict.name, parts)
        write_text(self.data / file, text)
        self._data.add(verdict.name, [file], inputs=verdict.inputs, thumbnail=found.thumbnail)
        sizes = {name: len(text.encode()) for name, text in parts.items()}
        with self._lock:
            self._kept[verdict.name] = Kept(file, found.thumbnail, sizes)
        return replace(verdict, seen=None)

    def add(self, verdict: SceneVerdict) -> None:
        """A scene whose turn it is in the list; the list is written now and then. Raises OutputError."""
        kept = self._kept.get(verdict.name, NOTHING_KEPT)
        self.candidate = self.candidate or verdict.candidate
        self.rows.append(row(verdict, kept.file, kept.thumbnail))
        if not self.one_file and time.monotonic() - self._written > SECONDS_BETWEEN:
            self.write()

    def write(self) -> None:
        """The page about all that was added. Raises OutputError."""
        run = self._run()
        scenes: Iterator[str] = iter(())
        if self.one_file:
            room = MOST_BYTES - sum(len(text.encode()) for text in page(run, self.rows))
            listed = [each["name"] for each in self.rows]
            sizes = {name: self._kept[name].sizes for name in listed if name in self._kept}
            chosen = one_file.choose(self.rows, sizes, room, LAYERS)
            run["left_out"] = one_file.left_out(sizes, chosen)
            scenes = one_file.elements(self.data, self.rows, chosen)
        with written_aside(self.index) as part, part.open("w", encoding="utf-8") as file:
            file.writelines(page(run, self.rows, scenes))
        self._written = time.monotonic()

    def sweep(self, spared: Collection[str] = ()) -> Swept:
        """Remove the scenes of earlier reports that the page no longer leads to, but for these. Raises OutputError."""
        return Swept() if self.one_file else self._data.sweep(lambda scene: scene in spared)

    def close(self) -> None:
        """Remove what lay aside."""
        if self.one_file:
            self._aside.cleanup()

    def _run(self) -> dict[str, Any]:
        passed = sum(each["ok"] for each in self.rows)
        said = f"{passed} of {len(self.rows)} scenes pass"
        if len(self.rows) < self.asked:
            said += f"; {self.asked - len(self.rows)} of {self.asked} were not judged"
        wrong = CANDIDATE_WRONG if self.candidate else OURS_WRONG
        return {
            "summary": said,
            "candidate": self.candidate,
            "asked": self.asked,
            "classes": [*(wrong if name == OURS_WRONG else name for name in CLASSES), UNLISTED],
            "one_file": self.one_file,
            "most_bytes": MOST_BYTES,
            "left_out": {},
        }


def file_of(verdict: SceneVerdict) -> str:
    """In the folder data."""
    return f"{quote(verdict.name, safe=' ')}.js"


def called(name: str, parts: Mapping[str, str]) -> str:
    """A script that hands a scene's record to the page."""
    inside = ",\n".join(f"{as_json(part)}:{text}" for part, text in parts.items())
    return f"ray_reference_scene({as_json(name)},{{\n{inside}\n}});\n"


def write_report(path: str | Path, verdicts: Sequence[SceneVerdict], asked: int) -> Path:
    """All at once; returns the file to open. Raises OutputError."""
    report = Report(path, asked)
    try:
        for verdict in verdicts:
            report.add(report.keep(verdict))
        report.write()
        report.sweep()
    finally:
        report.close()
    return report.index
