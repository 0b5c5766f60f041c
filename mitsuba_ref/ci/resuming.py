"""What an earlier run of the same inputs found: kept while it runs, taken over by --resume, judged anew otherwise."""

import hashlib
import importlib.metadata
import json
import platform
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from caster.whole_files import OutputError, write_text
from caster.wording import SceneError
from mitsuba_ref import variants
from mitsuba_ref.campaign import Entry, JudgeEntry
from mitsuba_ref.ci.out_folder import OutFolder
from mitsuba_ref.ci.reading import BROKEN, scene_of
from mitsuba_ref.reference import variant_of
from mitsuba_ref.verdict import FORMAT, SceneVerdict

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
def surroundings() -> dict[str, str]:
    """Versions of what computes, and the machine."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "code": code_hash()}
    for name in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def inputs_of(entry: Entry) -> str:
    """A hash of all that the verdict of a scene depends on: scene and mesh bytes, code, versions, variant, options.

    Nothing for a scene that has no variant: it cannot be judged, so nothing of it is kept.
    """
    try:
        variant = variant_of(entry.scene)
        file = Path(entry.path).read_bytes()
    except (SceneError, OSError):
        return ""
    known = {
        "format": FORMAT,
        "scene": entry.scene.sha256(),  # mesh files by their bytes
        "file": hashlib.sha256(file).hexdigest(),
        "path": entry.path,  # replays name it
        "resized": entry.resized,
        "options": entry.options,
        "variant": variant,
        "settings": variants.settings(variant),  # libLLVM
        **surroundings(),
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def line_of(verdict: SceneVerdict) -> str:
    return json.dumps(verdict.to_dict(), allow_nan=False) + "\n"


class Kept:
    """Results in one folder. resume: take over what is there, if its inputs are the same."""

    def __init__(
        self,
        out: OutFolder,
        judge: JudgeEntry,
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
        write_text(self.journal, "".join(map(line_of, self.known.values())))

    def judge(self, entry: Entry, folder: Path | None) -> SceneVerdict:
        """What is known of the same inputs, marked as kept; or else judged, and kept for later."""
        inputs = inputs_of(entry)
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
                file.write(line_of(verdict))
        except OSError as error:
            raise OutputError(f"{self.journal}: cannot write: {error.strerror or error}") from error

    def _read(self) -> Iterator[tuple[str, SceneVerdict]]:
        """Of the last whole run, and then of the one that was interrupted. What does not read is judged anew."""
        for record in (*self._of_the_verdict(), *self._of_the_journal()):
            try:
                scene = scene_of(record)
            except BROKEN:
                continue
            yield scene.name, scene

    def _of_the_verdict(self) -> list[dict[str, Any]]:
        try:
            record = json.loads((self.folder / "verdict.json").read_text(encoding="utf-8"))
            return list(record["scenes"]) if record.get("format") == FORMAT else []
        except (OSError, *BROKEN):
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
