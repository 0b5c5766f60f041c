"""Verdicts of earlier runs: stored ones, found by a hash of all that they depend on, and verdict.json read back."""

import json
import os
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from caster.cameras import CAMERAS
from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import read_input
from caster.scene.model import Scene
from caster.shapes import SHAPES
from mitsuba_ref.judge.verdict import VERDICT_FORMAT, SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.rendering import variant_of
from mitsuba_ref.reference.store import REFERENCE_SETTINGS, environment_settings, key_of, machine

MAX_INPUT_CHARACTERS = 60  # of a wrong value in a message
PACKAGES = ("caster", "mitsuba_ref")
OUR_SETTINGS = ("CASTER_", "MITSUBA_", "NUMBA_")  # prefixes of environment variables that may matter


@cache
def code_hash() -> str:
    """A hash of the source files of both packages."""
    root = Path(__file__).resolve().parents[2]
    sources = [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]
    return key_of(part for path in sources for part in (path.relative_to(root).as_posix(), path.read_bytes()))


def verdict_key(scene: Scene, path: str, **about: Any) -> str:
    """A hash of all that the verdict of a scene depends on: scene, mesh and source bytes, versions, variant, options.

    about: options. "" if that is not known: for a scene without a variant, and where other packages add kinds.
    """
    foreign = any(not kind.__module__.startswith("caster.") for kind in (*SHAPES, *CAMERAS))
    if foreign or entry_points(group="mitsuba_ref.plugins"):
        return ""
    try:
        variant = variant_of(scene)
        file = read_input(path, "scene file")
    except SceneError:
        return ""
    known = {
        "format": VERDICT_FORMAT,
        "code": code_hash(),
        "scene": scene.sha256(),  # mesh files by their bytes
        "path": path,  # replays name it
        "variant": variant,
        "library": variants.environment_for(variant),  # libLLVM
        "settings": environment_settings(*OUR_SETTINGS, *REFERENCE_SETTINGS),
        **machine(),
        **about,
    }
    return key_of(["verdict", json.dumps(known, sort_keys=True, default=str), file])


def check_ok(record: dict[str, Any], found: SceneVerdict | Verdict) -> None:
    """Raise ValueError if the `ok` of a record does not follow from its numbers."""
    try:
        ok = json.loads(json.dumps(found.to_dict(), allow_nan=False))["ok"]
    except KeyError as error:  # a class has no count
        raise ValueError(f"expected counts of {error}") from error
    if record.get("ok") is not ok:
        raise ValueError(f"its ok is {record.get('ok')}, by its numbers it is {ok}")


class UnreadableVerdict(FileMissing):
    """A file exists, but holds no verdict of this version."""


def read_verdict(path: str | os.PathLike[str]) -> Verdict:
    """The verdict that `validate --json` wrote. Raises FileMissing, or UnreadableVerdict with the reason."""
    content = read_input(path, "verdict of `mitsuba-ref validate --json`")
    try:
        record = json.loads(content)
        form = record.get("format") if isinstance(record, dict) else type(record).__name__
        if form != VERDICT_FORMAT:
            raise ValueError(f"expected a verdict of format {VERDICT_FORMAT}, got {form!r}: judge these scenes again")
        found = TypeAdapter(Verdict).validate_python(record)
        for each, scene in zip(record["scenes"], found.scenes, strict=True):
            check_ok(each, scene)
        check_ok(record, found)
    except ValidationError as error:
        first = error.errors()[0]
        got = repr(first["input"])[:MAX_INPUT_CHARACTERS]
        where = ".".join(map(str, first["loc"]))
        raise UnreadableVerdict(f"{path}: not a whole verdict: {where}: {first['msg']}, got {got}") from error
    except (ValueError, RecursionError) as error:
        raise UnreadableVerdict(f"{path}: not a whole verdict: {error}") from error
    return found
