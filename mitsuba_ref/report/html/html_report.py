"""The HTML report, written scene by scene, as a folder or as one file."""

import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from caster.image.atomic_files import (
    OutputError,
    ScratchFolder,
    atomic_write,
    check_folder,
    check_writable,
    write_text,
)
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, SceneVerdict
from mitsuba_ref.report.html import page_writer
from mitsuba_ref.report.html.page_writer import as_json, index_row, page
from mitsuba_ref.report.html.scene_record import PIXEL_LAYERS, scene_record
from mitsuba_ref.report.output_manifest import ManifestEntry, OutputManifest, RemovedFiles

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


NOTHING_WRITTEN = WrittenScene("", "", {})


def refuse_page_of_others(index: Path) -> None:
    """Raise OutputError for an existing file that is no report."""
    if index.is_file() and b"<title>ray-reference" not in index.read_bytes()[:4096]:
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
        return (
            verdict.pixels > MAX_PIXELS_WITH_IMAGES or self.one_file or self._of_earlier(verdict) is not None
        )

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
                self._kept[verdict.name] = WrittenScene(
                    file_of(verdict), before.labels.get("thumbnail", ""), {}
                )
        if verdict.seen is None or verdict.pixels > MAX_PIXELS_WITH_IMAGES:
            return replace(verdict, seen=None)
        rounded = (self.one_file and verdict.ok) or verdict.pixels > MAX_PIXELS_EXACT
        found = scene_record(verdict, verdict.seen, exact=not rounded)
        parts = {"about": as_json(found.about)} | {name: as_json(each) for name, each in found.layers.items()}
        file = file_of(verdict)
        text = page_writer.record_lines(parts) if self.one_file else record_script(verdict.name, parts)
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
            chosen = page_writer.choose(self.rows, sizes, room, PIXEL_LAYERS)
            run["left_out"] = page_writer.left_out(sizes, chosen)
            scenes = page_writer.elements(self.data, self.rows, chosen)
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
        }


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
