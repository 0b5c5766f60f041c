"""Results of earlier runs: reading of verdict.json, and reuse of what was judged of the same inputs (--resume)."""

import hashlib
import importlib.metadata
import json
import os
import platform
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import MAX_TEXT_BYTES, read_input, read_own
from caster.system import processor
from caster.system.atomic_files import append_text, write_text
from mitsuba_ref.judge.verdict import VERDICT_FORMAT, SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.rendering import variant_of
from mitsuba_ref.report.output_manifest import JOURNAL, OutFolder
from mitsuba_ref.runner.many_scenes import Entry, JudgeScene, SceneEntry

# Exceptions of a file that is no JSON, or of a record of another shape.
MALFORMED = (AttributeError, KeyError, TypeError, ValueError, ArithmeticError, RecursionError)
MAX_INPUT_CHARACTERS = 60  # of a wrong value in a message
NOT_RECORDED = {"seen"}  # fields of a scene that no file has


class UnreadableVerdict(FileMissing):
    """A file that exists, but is no verdict of this version."""


def read_verdict(path: str | os.PathLike[str]) -> Verdict:
    """The verdict that `validate --json` wrote. Raises FileMissing, or UnreadableVerdict with the reason."""
    try:
        record = json.loads(read_input(path, "verdict", MAX_TEXT_BYTES))
    except FileMissing as error:
        if Path(path).exists():
            raise UnreadableVerdict(str(error)) from error
        raise FileMissing(f"{path}: expected what `mitsuba-ref validate --json` writes, found no file") from None
    except MALFORMED as error:
        raise UnreadableVerdict(f"{path}: expected JSON, got something else: {error}") from error
    if not isinstance(record, dict) or record.get("format") != VERDICT_FORMAT:
        found = record.get("format") if isinstance(record, dict) else type(record).__name__
        raise UnreadableVerdict(
            f"{path}: expected a verdict of format {VERDICT_FORMAT}, got {found!r}: judge these scenes again"
        )
    try:
        return verdict_of(record)
    except MALFORMED as error:
        raise UnreadableVerdict(f"{path}: not a whole verdict: {_first_error(error)}") from error


def _first_error(error: Exception) -> str:
    """Where a record differs from its model: the first field, what is expected there and what was got."""
    if not isinstance(error, ValidationError):
        return f"{type(error).__name__}: {error}"
    first = error.errors()[0]
    got = repr(first["input"])[:MAX_INPUT_CHARACTERS]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}, got {got}"


def verdict_of(record: dict[str, Any]) -> Verdict:
    """The verdict of a run from its JSON values. Raises one of MALFORMED."""
    found = TypeAdapter(Verdict).validate_python(record)
    if found.ok != record["ok"]:
        raise ValueError(f"its ok is {record['ok']}, by its scenes it is {found.ok}")
    for each, scene in zip(record["scenes"], found.scenes, strict=True):
        check_ok(each, scene)
    return found


def scene_of(record: dict[str, Any]) -> SceneVerdict:
    """The verdict of one scene from its JSON values. Raises one of MALFORMED."""
    found = TypeAdapter(SceneVerdict).validate_python(record)
    check_ok(record, found)
    return found


def check_ok(record: dict[str, Any], scene: SceneVerdict) -> None:
    """Raise ValueError where a record lacks a field, or its own `ok` contradicts its numbers."""
    missing = {each.name for each in fields(SceneVerdict)} - NOT_RECORDED - record.keys()
    if missing:
        raise ValueError(f"{scene.name} lacks {', '.join(sorted(missing))}")
    journal_line(scene)  # raises ValueError for a number that JSON has no word for
    if scene.ok != record["ok"]:
        raise ValueError(f"{scene.name}: its ok is {record['ok']}, by its numbers it is {scene.ok}")


PACKAGES = ("caster", "mitsuba_ref")
VERDICT_LIBRARIES = ("numpy", "numba", "llvmlite", "mitsuba", "drjit", "OpenEXR", "pydantic")  # that verdicts depend on


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
    """Versions of the libraries, and the processor."""
    found = {"python": platform.python_version(), "processor": processor.description(), "code": code_hash()}
    for name in VERDICT_LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def inputs_hash(entry: SceneEntry, *, thorough: bool = False) -> str:
    """A hash of all that the verdict of a scene depends on: scene and mesh bytes, code, versions, variant, options.

    "" for a scene without a variant: it cannot be judged, so its result is not reused.
    """
    try:
        variant = variant_of(entry.scene)
        file = read_input(entry.path, "scene file", MAX_TEXT_BYTES)
    except SceneError:
        return ""
    known = {
        "format": VERDICT_FORMAT,
        "scene": entry.scene.sha256(),  # mesh files by their bytes
        "file": hashlib.sha256(file).hexdigest(),
        "path": entry.path,  # replays name it
        "resized": entry.resized,
        "options": entry.options,
        "thorough": thorough,
        "variant": variant,
        "settings": variants.environment_for(variant),  # libLLVM
        **environment(),
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def journal_line(verdict: SceneVerdict) -> str:
    return json.dumps(verdict.to_dict(), allow_nan=False) + "\n"


def recorded(judge: JudgeScene, out: OutFolder) -> JudgeScene:
    """The same judge; its verdicts then list the files written for them, with size and SHA-256."""

    def work(entry: Entry, folder: Path | None, **options: Any) -> SceneVerdict:
        return out.record(judge(entry, folder, **options))

    return work


class ResumableResults:
    """Results in one folder. resume: reuse those with the same inputs."""

    def __init__(
        self,
        out: OutFolder,
        judge: JudgeScene,
        *,
        resume: bool,
        thorough: bool = False,
        has_page: Callable[[SceneVerdict], bool] = lambda verdict: True,
    ) -> None:
        """thorough: as `judge` judges; has_page: whether the requested HTML report holds the record of a verdict."""
        self.has_page = has_page
        self.inputs_of = partial(inputs_hash, thorough=thorough)
        self.out, self.folder, self.journal = out, out.folder, out.folder / JOURNAL
        self.judge_anew = judge
        self.lock = threading.Lock()
        self.known = dict(self._read()) if resume else {}
        # Whole lines of all that is known: an interruption may overwrite verdict.json with less, and a line that was
        # cut short would spoil the next one.
        write_text(self.journal, "".join(map(journal_line, self.known.values())))

    def judge(self, entry: Entry, folder: Path | None) -> SceneVerdict:
        """The known result of the same inputs, marked as kept; otherwise judged, and recorded in the journal."""
        known = self.known.get(entry.name)
        whole = known is not None and not known.problem and self.out.has_files(known) and self.has_page(known)
        inputs = known.inputs if known is not None and whole else ""
        verdict = self.judge_anew(entry, folder, inputs_of=self.inputs_of, known=inputs)
        if known is not None and inputs and verdict.inputs == inputs and not verdict.problem:
            return self.out.record(replace(known, kept=True))
        verdict = self.out.record(verdict)
        self._write(verdict)
        return verdict

    def _write(self, verdict: SceneVerdict) -> None:
        with self.lock:
            append_text(self.journal, journal_line(verdict))

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
            record = json.loads(read_own(self.folder / "verdict.json", "verdict"))
            return list(record["scenes"]) if record.get("format") == VERDICT_FORMAT else []
        except (SceneError, *MALFORMED):
            return []

    def _of_the_journal(self) -> list[dict[str, Any]]:
        """Records of the journal; a truncated line belongs to a scene that was not finished."""
        found = []
        try:
            lines = read_own(self.journal, "journal").splitlines()
        except SceneError:
            return []
        for line in lines:
            with suppress(*MALFORMED):
                found.append(json.loads(line))
        return found
