"""Verdicts of earlier runs: stored ones, found by a hash of all that they depend on, and verdict.json read back."""

import hashlib
import json
import re
from collections.abc import Collection
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from caster.cameras import CAMERAS
from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import FileName, read_input
from caster.scene.model import Scene
from caster.shapes import SHAPES
from mitsuba_ref.judge.verdict import VERDICT_FORMAT, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.rendering import variant_of
from mitsuba_ref.reference.store import REFERENCE_SETTINGS, environment_settings, key_of, machine
from mitsuba_ref.report.output import json_text

MAX_INPUT_CHARACTERS = 60  # of a wrong value in a message
PACKAGES = ("caster", "mitsuba_ref")
OUR_SETTINGS = ("CASTER_", "MITSUBA_", "NUMBA_")  # prefixes of environment variables that may matter


# Of these modules a scene needs those of its shapes and camera, and what they import; of all others, every one.
OF_KINDS = ("caster.shapes.", "caster.cameras.", "caster.kernels.", "mitsuba_ref.shapes.", "mitsuba_ref.cameras.")
MODULE_NAME = re.compile(r"\b(?:caster|mitsuba_ref)(?:\.\w+)+")


class Source(NamedTuple):
    """A source file."""

    digest: str
    names: frozenset[str]  # of modules in it, also in text and comments


@cache
def sources() -> dict[str, Source]:
    """Every source file of both packages, with the data of its module, by the name of the module."""
    root, found = Path(__file__).resolve().parents[2], {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            files = (path, path.with_suffix(".txt"))  # teapot.txt
            data = b"".join(each.read_bytes() for each in files if each.exists())
            found[name] = Source(hashlib.sha256(data).hexdigest(), frozenset(MODULE_NAME.findall(data.decode())))
    return found


def modules_for(scene: Scene) -> set[str]:
    """The modules whose code may run when the scene is judged: all but those of other shapes and cameras.

    A module of mitsuba_ref.shapes or .cameras may describe several kinds: it is needed if it names one of the scene's,
    or none. The modules of the others are not followed from there, nor from where all kinds are registered.
    """
    known = sources()
    kinds = {type(each).__module__ for each in (*scene.shapes, scene.camera)}
    waiting = [*kinds, *(name for name in known if name.endswith("__init__") or not name.startswith(OF_KINDS))]
    for name in (each for each in known if each.startswith(OF_KINDS[3:])):
        described = {each for each in known[name].names if each in known and each.startswith(OF_KINDS[:2])}
        waiting += [name] if described & kinds or not described else []
    needed = set[str]()
    while waiting:
        name = waiting.pop()
        if name in needed or name not in known:
            continue
        needed.add(name)
        mine = name.startswith(OF_KINDS[3:])
        if not name.endswith("__init__"):
            waiting += [each for each in known[name].names if not (mine and each.startswith(OF_KINDS[:2]))]
    return needed


def code_hash(modules: Collection[str] | None = None) -> str:
    """A hash of the source files of both packages, or of some modules."""
    known = sources()
    chosen = known if modules is None else sorted(modules)
    return key_of(part for name in chosen for part in (name, known[name].digest))


SOURCES, SETTINGS = "source code", "environment"


def worker_identity(modules: Collection[str] | None = None) -> dict[str, str]:
    """All that results depend on, by name: of these modules, or of all. The processor may differ; verdicts name it."""
    settings = environment_settings(*OUR_SETTINGS, *REFERENCE_SETTINGS)
    return {**machine(), SOURCES: code_hash(modules), SETTINGS: settings}


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
        "scene": scene.sha256(),  # mesh files by their bytes
        "path": path,  # replays name it
        "variant": variant,
        "library": variants.environment_for(variant),  # libLLVM
        **worker_identity(None if about.get("thorough") else modules_for(scene)),
        **about,
    }
    return key_of(["verdict", json.dumps(known, sort_keys=True, default=str), file])


class UnreadableVerdict(FileMissing):
    """A file exists, but holds no verdict of this version."""


def read_verdict(path: FileName) -> Verdict:
    """The verdict that `validate --json` wrote. Raises FileMissing, or UnreadableVerdict with the reason."""
    content = read_input(path, "verdict of `mitsuba-ref validate --json`")
    try:
        record = json.loads(content)
        form = record.get("format") if isinstance(record, dict) else type(record).__name__
        if form != VERDICT_FORMAT:
            raise ValueError(f"expected a verdict of format {VERDICT_FORMAT}, got {form!r}: judge these scenes again")
        found = TypeAdapter(Verdict).validate_python(record)
        json_text(found)  # raises for numbers that no verdict has
        right = [scene.ok for scene in found.scenes] + [found.ok]
        for written, ok in zip((*record["scenes"], record), right, strict=True):
            if written.get("ok") is not ok:
                raise ValueError(f"its ok is {written.get('ok')}, by its numbers it is {ok}")
    except ValidationError as error:
        first = error.errors()[0]
        got = repr(first["input"])[:MAX_INPUT_CHARACTERS]
        where = ".".join(map(str, first["loc"]))
        raise UnreadableVerdict(f"{path}: not a whole verdict: {where}: {first['msg']}, got {got}") from error
    except KeyError as error:
        raise UnreadableVerdict(f"{path}: not a whole verdict: expected counts of {error}") from error
    except (ValueError, RecursionError) as error:
        raise UnreadableVerdict(f"{path}: not a whole verdict: {error}") from error
    return found
