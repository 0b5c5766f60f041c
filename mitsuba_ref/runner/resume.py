"""The folder of --out, and results of earlier runs in it: recorded while a run lasts, reused by --resume."""

import hashlib
import importlib.metadata
import json
import platform
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.image.atomic_files import OutputError, write_text
from mitsuba_ref.judge.verdict import VERDICT_FORMAT, FileRecord, SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.rendering import variant_of
from mitsuba_ref.report.output_manifest import FileDigest, OutputManifest, RemovedFiles, remove
from mitsuba_ref.runner.scene_runner import JudgeScene, SceneEntry
from mitsuba_ref.runner.verdict_file import MALFORMED, scene_of

IMAGES = ("ours", "reference", "verdict")
VERDICT = "verdict.json"


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

    def recorded(self, judge: JudgeScene) -> JudgeScene:
        """The same judge; its verdicts then list the files written for them, with size and SHA-256."""

        def work(entry: SceneEntry, folder: Path | None) -> SceneVerdict:
            return self.record(judge(entry, folder))

        return work

    def record(self, verdict: SceneVerdict) -> SceneVerdict:
        """The verdict with its files in the folder."""
        found = self.written.add(verdict.name, files_of(verdict))
        return replace(
            verdict, files={file: FileRecord(digest.bytes, digest.sha256) for file, digest in found.items()}
        )

    def has_files(self, verdict: SceneVerdict) -> bool:
        """Whether every file of a verdict is listed in it, and exists with the same bytes."""
        known = {file: FileDigest(record.bytes, record.sha256) for file, record in verdict.files.items()}
        return all(file in known and known[file].fits(self.folder / file) for file in files_of(verdict))

    def sweep(self, verdict: Verdict, selected: Collection[str] | None) -> RemovedFiles:
        """Remove files of earlier runs. Spared: scenes that are not judged yet, and those of other shards.

        selected: names of the scenes of all shards; None for a run of single scenes, which leaves others alone.
        """
        judged = {scene.name for scene in verdict.scenes}
        return self.written.sweep(
            lambda scene: scene not in judged and (selected is None or scene in selected)
        )


def files_of(verdict: SceneVerdict) -> tuple[str, ...]:
    """Names of the files of a verdict; none if there was no comparison."""
    if verdict.problem:
        return ()
    images = ("candidate" if verdict.candidate and which == "ours" else which for which in IMAGES)
    return (*(f"{verdict.name}.{which}.exr" for which in images), *verdict.reproducers)


PACKAGES = ("caster", "mitsuba_ref")
VERDICT_LIBRARIES = (
    "numpy",
    "numba",
    "llvmlite",
    "mitsuba",
    "drjit",
    "OpenEXR",
    "pydantic",
)  # that verdicts depend on
JOURNAL = "judged.jsonl"  # a line for each scene that is done, while a run lasts; then verdict.json has them


@cache
def code_hash() -> str:
    """A hash of every source file of both packages."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


@cache
def environment() -> dict[str, str]:
    """Versions of the libraries, and the machine."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "code": code_hash()}
    for name in VERDICT_LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def inputs_hash(entry: SceneEntry) -> str:
    """A hash of all that the verdict of a scene depends on: scene and mesh bytes, code, versions, variant, options.

    "" for a scene without a variant: it cannot be judged, so its result is not reused.
    """
    try:
        variant = variant_of(entry.scene)
        file = Path(entry.path).read_bytes()
    except (SceneError, OSError):
        return ""
    known = {
        "format": VERDICT_FORMAT,
        "scene": entry.scene.sha256(),  # mesh files by their bytes
        "file": hashlib.sha256(file).hexdigest(),
        "path": entry.path,  # replays name it
        "resized": entry.resized,
        "options": entry.options,
        "variant": variant,
        "settings": variants.environment_for(variant),  # libLLVM
        **environment(),
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def journal_line(verdict: SceneVerdict) -> str:
    return json.dumps(verdict.to_dict(), allow_nan=False) + "\n"


class ResumableResults:
    """Results in one folder. resume: reuse those with the same inputs."""

    def __init__(
        self,
        out: OutFolder,
        judge: JudgeScene,
        *,
        resume: bool,
        has_page: Callable[[SceneVerdict], bool] = lambda verdict: True,
    ) -> None:
        """has_page: whether the requested HTML report holds the record of a verdict."""
        self.has_page = has_page
        self.out, self.folder, self.journal = out, out.folder, out.folder / JOURNAL
        self.judge_anew = out.recorded(judge)
        self.lock = threading.Lock()
        self.known = dict(self._read()) if resume else {}
        # Whole lines of all that is known: an interruption may overwrite verdict.json with less, and a line that was
        # cut short would spoil the next one.
        write_text(self.journal, "".join(map(journal_line, self.known.values())))

    def judge(self, entry: SceneEntry, folder: Path | None) -> SceneVerdict:
        """The known result of the same inputs, marked as kept; otherwise judged, and recorded in the journal."""
        inputs = inputs_hash(entry)
        known = self.known.get(entry.name)
        if (
            known is not None
            and inputs
            and known.inputs == inputs
            and not known.problem
            and self.out.has_files(known)
            and self.has_page(known)
        ):
            return self.out.record(replace(known, kept=True))
        verdict = replace(self.judge_anew(entry, folder), inputs=inputs)
        self._write(verdict)
        return verdict

    def _write(self, verdict: SceneVerdict) -> None:
        try:
            with self.lock, self.journal.open("a", encoding="utf-8") as file:
                file.write(journal_line(verdict))
        except OSError as error:
            raise OutputError(f"{self.journal}: cannot write: {error.strerror or error}") from error

    def _read(self) -> Iterator[tuple[str, SceneVerdict]]:
        """Results of the last complete run, then of an interrupted one. Malformed records are ignored."""
        for record in (*self._of_the_verdict(), *self._of_the_journal()):
            try:
                scene = scene_of(record)
            except MALFORMED:
                continue
            yield scene.name, scene

    def _of_the_verdict(self) -> list[dict[str, Any]]:
        try:
            record = json.loads((self.folder / "verdict.json").read_text(encoding="utf-8"))
            return list(record["scenes"]) if record.get("format") == VERDICT_FORMAT else []
        except (OSError, *MALFORMED):
            return []

    def _of_the_journal(self) -> list[dict[str, Any]]:
        """Records of the journal; a truncated line belongs to a scene that was not finished."""
        found = []
        try:
            lines = self.journal.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            return []
        for line in lines:
            with suppress(ValueError):
                found.append(json.loads(line))
        return found
