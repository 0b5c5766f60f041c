"""Manifest of the files that runs wrote into a folder: files of earlier runs can be removed, others never are."""

import hashlib
import secrets
import threading
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, NonNegativeInt, ValidationError

from caster.description.errors import SceneError
from caster.description.input_files import read_own
from caster.system.atomic_files import OutputError, append_text, write_text
from mitsuba_ref.judge.verdict import FileRecord, SceneVerdict, Verdict

MANIFEST = "written.jsonl"  # a line for each file, added to as they are written; the last line of a file counts


def record_of(path: Path) -> FileRecord | None:
    """Size and hash of a file; None if it cannot be read."""
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            return FileRecord(file.tell(), digest)
    except OSError:
        return None


def is_unchanged(path: Path, record: FileRecord) -> bool:
    """Whether the file exists with the same bytes."""
    try:
        return path.stat().st_size == record.bytes and record_of(path) == record
    except OSError:
        return False


def _in_the_folder(file: str) -> str:
    if file != Path(file).name:
        raise ValueError(f"expected a file of the same folder, got {file!r}")
    return file


class ManifestEntry(BaseModel, frozen=True, strict=True):
    """A line of the manifest. run: id of the run that wrote the file; labels: further facts about it."""

    file: Annotated[str, AfterValidator(_in_the_folder)]
    scene: str
    bytes: NonNegativeInt
    sha256: str
    run: str
    labels: dict[str, str] = {}

    @property
    def digest(self) -> FileRecord:
        return FileRecord(self.bytes, self.sha256)


@dataclass(frozen=True)
class RemovedFiles:
    """Names of files of earlier runs that were removed, or left."""

    removed: tuple[str, ...] = ()
    altered: tuple[str, ...] = ()  # changed since they were written, so they stay

    def words(self, folder: Path) -> str:
        """On one line; "" if there are none."""
        parts = []
        if self.removed:
            files = "file" if len(self.removed) == 1 else "files"
            parts.append(f"removed {len(self.removed)} {files} that an earlier run wrote and this one did not")
        if self.altered:
            parts.append(f"left {len(self.altered)} that were altered since: {', '.join(self.altered)}")
        return f"{folder}: {'; '.join(parts)}" if parts else ""


class OutputManifest:
    """The manifest of one folder. `add` may be called from several threads."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.list = folder, folder / MANIFEST
        self.lock, self.run = threading.Lock(), secrets.token_hex(8)
        self.now: dict[str, FileRecord] = {}
        self.earlier = self._known()
        write_text(self.list, self._lines(self.earlier.values()))  # a truncated line would spoil the next

    def add(self, scene: str, files: Iterable[str], **labels: str) -> dict[str, FileRecord]:
        """Record files of a scene; missing ones are left out. labels: further facts about them.

        Raises OutputError.
        """
        found = {file: digest for file in files if (digest := record_of(self.folder / file)) is not None}
        entries = [
            ManifestEntry(file=file, scene=scene, bytes=each.bytes, sha256=each.sha256, run=self.run, labels=labels)
            for file, each in found.items()
        ]
        with self.lock:
            append_text(self.list, self._lines(entries))
            self.now |= found
        return found

    def unchanged(self, file: str, **labels: str) -> ManifestEntry | None:
        """The entry of a file of an earlier run with these labels, if the file still has the same bytes."""
        known = self.earlier.get(file)
        if (
            known is None
            or not labels.items() <= known.labels.items()
            or not is_unchanged(self.folder / file, known.digest)
        ):
            return None
        return known

    def sweep(self, spared: Callable[[str], bool] = lambda scene: False) -> RemovedFiles:
        """Remove what earlier runs wrote and this one did not, except for spared scenes.

        Files that are not listed, or were altered, are left alone; what a concurrent run lists
        belongs to that run. Raises OutputError.
        """
        known, removed, altered = self._known(), [], []
        for file, line in sorted(known.items()):
            path = self.folder / file
            kept = line != self.earlier.get(file) or file in self.now or spared(line.scene)
            if kept and path.exists():
                continue
            del known[file]
            if is_unchanged(path, line.digest):
                remove(path)
                removed.append(file)
            elif path.exists():
                altered.append(file)
        write_text(self.list, self._lines(known.values()))
        return RemovedFiles(tuple(removed), tuple(altered))

    def _known(self) -> dict[str, ManifestEntry]:
        """File name -> entry. Malformed lines, and names outside the folder, are ignored."""
        found = {}
        with suppress(SceneError):
            for line in read_own(self.list, "manifest").splitlines():
                with suppress(ValidationError):
                    entry = ManifestEntry.model_validate_json(line)
                    found[entry.file] = entry
        return found

    @staticmethod
    def _lines(entries: Iterable[ManifestEntry]) -> str:
        return "".join(entry.model_dump_json(exclude_defaults=True) + "\n" for entry in entries)


def remove(path: Path) -> None:
    """Remove a file of an earlier run, if it exists. Raises OutputError."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot remove what an earlier run wrote: {error.strerror or error}") from error


IMAGES = ("ours", "reference", "verdict")
VERDICT = "verdict.json"
JOURNAL = "judged.jsonl"  # a line for each scene that is done, while a run lasts; then verdict.json has them


class OutFolder:
    """Files of this run in a folder. Raises OutputError where it cannot be written."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, OutputManifest(folder)

    def begin(self) -> None:
        """Remove the verdict of an earlier run, whose files will be replaced; --resume has read it.

        A run that is killed leaves no verdict rather than that of another run. Raises OutputError.
        """
        remove(self.folder / VERDICT)

    def remove_journal(self) -> None:
        """Remove the journal, which verdict.json replaces once it is there."""
        (self.folder / JOURNAL).unlink(missing_ok=True)

    def record(self, verdict: SceneVerdict) -> SceneVerdict:
        """The verdict with its files in the folder."""
        return replace(verdict, files=self.written.add(verdict.name, files_of(verdict)))

    def has_files(self, verdict: SceneVerdict) -> bool:
        """Whether every file of a verdict is listed in it, and exists with the same bytes."""
        known = verdict.files
        return all(file in known and is_unchanged(self.folder / file, known[file]) for file in files_of(verdict))

    def sweep(self, verdict: Verdict, selected: Collection[str] | None) -> RemovedFiles:
        """Remove files of earlier runs. Spared: scenes that are not judged yet, and those of other shards.

        selected: names of the scenes of all shards; None for a run of single scenes, which leaves others alone.
        """
        judged = {scene.name for scene in verdict.scenes}
        return self.written.sweep(lambda scene: scene not in judged and (selected is None or scene in selected))


def files_of(verdict: SceneVerdict) -> tuple[str, ...]:
    """Names of the files of a verdict; none if there was no comparison."""
    if verdict.problem:
        return ()
    images = ("candidate" if verdict.candidate and which == "ours" else which for which in IMAGES)
    return (*(f"{verdict.name}.{which}.exr" for which in images), *verdict.reproducers)
