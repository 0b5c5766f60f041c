"""The folder of --out: what a run writes there is recorded with its verdicts, what earlier runs left there goes."""

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
    """Which files of the folder are of this run. Raises OutputError where nothing can be written."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, OutputManifest(folder)

    def begin(self) -> None:
        """The verdict of an earlier run goes, since its files are about to; --resume has read it.

        A run that is killed leaves none, and not one that looks like its own. Raises OutputError.
        """
        remove(self.folder / VERDICT)

    def remove_journal(self) -> None:
        """Remove the journal, which verdict.json replaces once it is there."""
        (self.folder / JOURNAL).unlink(missing_ok=True)

    def recorded(self, judge: JudgeScene) -> JudgeScene:
        """The same way to a verdict, which then says what was written for it: bytes and sha256 of each file."""

        def work(entry: SceneEntry, folder: Path | None) -> SceneVerdict:
            return self.record(judge(entry, folder))

        return work

    def record(self, verdict: SceneVerdict) -> SceneVerdict:
        """The verdict with the files that are there for it."""
        found = self.written.add(verdict.name, files_of(verdict))
        return replace(
            verdict, files={file: FileRecord(digest.bytes, digest.sha256) for file, digest in found.items()}
        )

    def has_files(self, verdict: SceneVerdict) -> bool:
        """Whether all that was written for a verdict is there to the bit; a verdict that does not say so has not."""
        known = {file: FileDigest(record.bytes, record.sha256) for file, record in verdict.files.items()}
        return all(file in known and known[file].fits(self.folder / file) for file in files_of(verdict))

    def sweep(self, verdict: Verdict, selected: Collection[str] | None) -> RemovedFiles:
        """Remove what earlier runs left. Spared: scenes that are not judged yet, and those of the other shards.

        selected: names of the scenes of all shards; None for a run of some scenes, which says nothing of others.
        """
        judged = {scene.name for scene in verdict.scenes}
        return self.written.sweep(
            lambda scene: scene not in judged and (selected is None or scene in selected)
        )


def files_of(verdict: SceneVerdict) -> tuple[str, ...]:
    """Names of the files that a verdict comes with; none if there was no comparison."""
    if verdict.problem:
        return ()
    pictures = ("candidate" if verdict.candidate and which == "ours" else which for which in IMAGES)
    return (*(f"{verdict.name}.{which}.exr" for which in pictures), *verdict.reproducers)


# What an earlier run of the same inputs found: kept while it runs, taken over by --resume, judged anew otherwise.


PACKAGES = ("caster", "mitsuba_ref")
LIBRARIES = (
    "numpy",
    "numba",
    "llvmlite",
    "mitsuba",
    "drjit",
    "OpenEXR",
    "pydantic",
)  # that a verdict may depend on
JOURNAL = "judged.jsonl"  # a line for each scene that is done, while a run lasts; then verdict.json has them


@cache
def code_hash() -> str:
    """A hash of every source file of both packages."""
    root = Path(__file__).resolve().parents[2]
    told = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            told.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return told.hexdigest()


@cache
def environment() -> dict[str, str]:
    """Versions of what computes, and the machine."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "code": code_hash()}
    for name in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def inputs_hash(entry: SceneEntry) -> str:
    """A hash of all that the verdict of a scene depends on: scene and mesh bytes, code, versions, variant, options.

    Nothing for a scene that has no variant: it cannot be judged, so nothing of it is kept.
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
    """Results in one folder. resume: take over what is there, if its inputs are the same."""

    def __init__(
        self,
        out: OutFolder,
        judge: JudgeScene,
        *,
        resume: bool,
        has_page: Callable[[SceneVerdict], bool] = lambda verdict: True,
    ) -> None:
        """has_page: whether the report that was asked for has what a verdict rests on."""
        self.has_page = has_page
        self.out, self.folder, self.journal = out, out.folder, out.folder / JOURNAL
        self.judge_anew = out.recorded(judge)
        self.lock = threading.Lock()
        self.known = dict(self._read()) if resume else {}
        # Whole lines of all that is known: an interruption may overwrite verdict.json with less, and a line that was
        # cut short would spoil the next one.
        write_text(self.journal, "".join(map(journal_line, self.known.values())))

    def judge(self, entry: SceneEntry, folder: Path | None) -> SceneVerdict:
        """What is known of the same inputs, marked as kept; or else judged, and kept for later."""
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
        """Of the last whole run, and then of the one that was interrupted. What does not read is judged anew."""
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
        """A line that was cut short is of a scene that was not done."""
        found = []
        try:
            lines = self.journal.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            return []
        for line in lines:
            with suppress(ValueError):
                found.append(json.loads(line))
        return found
