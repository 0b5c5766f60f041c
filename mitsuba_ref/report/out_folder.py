"""The folder of --out: verdict.json, images and reproducers; obsolete files of the judged scenes are removed."""

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.description.input_files import read_text
from caster.system.atomic_files import OutputError, check_folder, write_text
from mitsuba_ref.judge.verdict import FileRecord, SceneVerdict, Verdict
from mitsuba_ref.report.results import plural

IMAGES = ("ours", "reference", "verdict")
VERDICT = "verdict.json"


def verdict_json(verdict: Verdict) -> str:
    """The text of verdict.json."""
    return json.dumps(verdict.to_dict(), indent=1, allow_nan=False) + "\n"


def record_of(path: Path) -> FileRecord | None:
    """Size and hash of a file; None if it cannot be read or is not a regular file (a device may have no end)."""
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            return FileRecord(file.tell(), digest)
    except OSError:
        return None


def files_of(verdict: SceneVerdict) -> tuple[str, ...]:
    """Names of the files of a scene; none if there was no comparison."""
    if verdict.problem:
        return ()
    images = ("candidate" if verdict.candidate and which == "ours" else which for which in IMAGES)
    return (*(f"{verdict.name}.{which}.exr" for which in images), *verdict.reproducers)


def file_records(folder: Path, verdict: SceneVerdict) -> dict[str, FileRecord]:
    """Size and hash of each existing file of a scene."""
    found = {name: record_of(folder / name) for name in files_of(verdict)}
    return {name: record for name, record in found.items() if record is not None}


class OutFolder:
    """The folder of --out during a run. Raises OutputError if it cannot be written."""

    def __init__(self, folder: Path) -> None:
        """Removes the verdict of an earlier run, so that a killed run leaves none."""
        self.folder = check_folder(folder)
        self.earlier = dict(self._listed())  # scene -> its files, by the verdict.json of an earlier run
        _remove(self.folder / VERDICT)

    def _listed(self) -> Any:
        with suppress(SceneError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            for scene in json.loads(read_text(self.folder / VERDICT, "verdict"))["scenes"]:
                yield scene["name"], {name: FileRecord(**record) for name, record in scene["files"].items()}

    def finish(self, verdict: Verdict) -> str:
        """Write verdict.json and remove obsolete files of the judged scenes, such as reproducers of pixels that are no
        longer wrong; a sentence on their number. Files of other scenes and altered files stay."""
        write_text(self.folder / VERDICT, verdict_json(verdict))
        removed = 0
        for scene in verdict.scenes:
            for name, written in self.earlier.get(scene.name, {}).items():
                path = self.folder / name
                if name not in scene.files and name == path.name and record_of(path) == written:
                    _remove(path)
                    removed += 1
        return f"{self.folder}: removed {plural(removed, 'file')} of an earlier run, now obsolete" if removed else ""


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot remove what an earlier run wrote: {error.strerror or error}") from error
