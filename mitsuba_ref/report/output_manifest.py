"""What runs have written into a folder, by a list of our own there: files of earlier runs can go, others never do."""

import hashlib
import json
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from caster.image.atomic_files import OutputError, write_text

MANIFEST = (
    "written.jsonl"  # a line for each file, added to as they are written; the last line of a file counts
)


@dataclass(frozen=True)
class FileDigest:
    """What a file was when it was written."""

    bytes: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> "FileDigest | None":
        """None where there is no file that can be read."""
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
                return cls(file.tell(), digest)
        except OSError:
            return None

    def fits(self, path: Path) -> bool:
        """Whether the file is there, to the bit."""
        try:
            return path.stat().st_size == self.bytes and FileDigest.of(path) == self
        except OSError:
            return False

    def to_dict(self) -> dict[str, Any]:
        return vars(self)


class ManifestEntry(NamedTuple):
    """A line of the list. run: which one wrote it; told: what else is to be remembered of the file."""

    scene: str
    digest: FileDigest
    run: str
    told: dict[str, str]


@dataclass(frozen=True)
class RemovedFiles:
    """What became of the files of earlier runs: names."""

    removed: tuple[str, ...] = ()
    altered: tuple[str, ...] = ()  # not what was written, so they stay

    def words(self, folder: Path) -> str:
        """On one line, "" if there is nothing to tell."""
        told = []
        if self.removed:
            files = "file" if len(self.removed) == 1 else "files"
            told.append(f"removed {len(self.removed)} {files} that an earlier run wrote and this one did not")
        if self.altered:
            told.append(f"left {len(self.altered)} that somebody altered since: {', '.join(self.altered)}")
        return f"{folder}: {'; '.join(told)}" if told else ""


class OutputManifest:
    """The list of one folder. `add` may be called from several threads."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.list = folder, folder / MANIFEST
        self.lock, self.run = threading.Lock(), secrets.token_hex(8)
        self.now: dict[str, FileDigest] = {}
        self.earlier = self._known()
        write_text(self.list, "".join(self._lines(self.earlier)))  # a line cut short would spoil the next

    def add(self, scene: str, files: Iterable[str], **told: str) -> dict[str, FileDigest]:
        """These of the scene are as they shall be; what is not there is left out. told: to be remembered of them.

        Raises OutputError.
        """
        found = {file: digest for file in files if (digest := FileDigest.of(self.folder / file)) is not None}
        try:
            with self.lock, self.list.open("a", encoding="utf-8") as out:
                out.writelines(
                    self._lines(
                        {file: ManifestEntry(scene, each, self.run, told) for file, each in found.items()}
                    )
                )
                self.now |= found
        except OSError as error:
            raise OutputError(f"{self.list}: cannot write: {error.strerror or error}") from error
        return found

    def as_told(self, file: str, **told: str) -> ManifestEntry | None:
        """What an earlier run wrote and told these things of, if it is still there to the bit."""
        known = self.earlier.get(file)
        if (
            known is None
            or not told.items() <= known.told.items()
            or not known.digest.fits(self.folder / file)
        ):
            return None
        return known

    def sweep(self, spared: Callable[[str], bool] = lambda scene: False) -> RemovedFiles:
        """Remove what runs before this one wrote and this one did not, but for the scenes that are spared.

        A file that is not listed, or is no longer what was written, is somebody else's; what another run lists
        meanwhile is that run's. Raises OutputError.
        """
        known, removed, altered = self._known(), [], []
        for file, line in sorted(known.items()):
            path = self.folder / file
            kept = line != self.earlier.get(file) or file in self.now or spared(line.scene)
            if kept and path.exists():
                continue
            del known[file]
            if line.digest.fits(path):
                remove(path)
                removed.append(file)
            elif path.exists():
                altered.append(file)
        write_text(self.list, "".join(self._lines(known)))
        return RemovedFiles(tuple(removed), tuple(altered))

    def _known(self) -> dict[str, ManifestEntry]:
        """By the names of files. Lines that do not read, or lead out of the folder, count for nothing."""
        found = {}
        with suppress(OSError, ValueError):
            for line in self.list.read_text(encoding="utf-8").splitlines():
                with suppress(ValueError, KeyError, TypeError):
                    told = json.loads(line)
                    file = str(told["file"])
                    if file == Path(file).name:
                        digest = FileDigest(int(told["bytes"]), str(told["sha256"]))
                        more = str(told["run"]), dict(told.get("told", {}))
                        found[file] = ManifestEntry(str(told["scene"]), digest, *more)
        return found

    @staticmethod
    def _lines(files: dict[str, ManifestEntry]) -> Iterator[str]:
        for file, (scene, digest, run, told) in files.items():
            line = {"file": file, "scene": scene, **digest.to_dict(), "run": run}
            yield json.dumps(line | ({"told": told} if told else {})) + "\n"


def remove(path: Path) -> None:
    """A file that an earlier run wrote, if it is there. Raises OutputError."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot remove what an earlier run wrote: {error.strerror or error}"
        ) from error
