"""Judging a scene of many: its entry, its stored verdict, its replay; and the selection of scenes by name."""

import json
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from caster.cli.shared_arguments import resized
from caster.description.errors import SceneError
from caster.description.input_files import read_input
from caster.rendering.threads import set_default_threads
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.system.atomic_files import OutputError
from caster.system.cluster import CallEnded
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.aggregate import scene_statistics
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request, send_stored
from mitsuba_ref.reference.original_files import AS_IT_IS, Opening, is_original, open_scene
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.reference.store import key_of, local_store
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.runner.verdict_files import verdict_key
from mitsuba_ref.subjects.ray_files import HIT_ARRAYS, RAY_ARRAYS, HitsFile, RayList, lay_out
from mitsuba_ref.subjects.subject import OURS, Subject

UNKNOWN = "unknown"  # hash of inputs that cannot be read


@dataclass(frozen=True)
class SceneEntry:
    """A scene to judge, loaded when its turn comes by the process that judges it, and released afterwards."""

    name: str
    path: str
    size: tuple[int, int] | None = None  # of the film in place of the scene's own; a replay repeats it
    mesh_dirs: tuple[str, ...] = ()
    options: tuple[str, ...] = ()  # all others that a replay repeats
    given: Scene | None = None  # in place of the file
    subject: Subject | None = None  # of this entry alone: answers that were computed beforehand
    rays: SharedRays | None = None  # of a list, which the film is filled with
    ray_range: tuple[int, int] = (0, 0)  # first and end of them in their list
    command: str = "validate"  # that judges it
    opening: Opening = AS_IT_IS  # of a Mitsuba file
    bounce: int = 0  # of the secondary rays to judge; 0: the camera's rays
    inputs: str = ""  # of inputs_hash, where the run and its workers may have different files

    def load(self) -> Scene:
        """The scene to judge, with the requested film. Raises SceneError, FileMissing."""
        if self.given is None and is_original(self.path):
            return open_scene(self.path, self.opening, size=self.size, mesh_dirs=self.mesh_dirs)
        return resized(load_scene(self.path, self.mesh_dirs) if self.given is None else self.given, self.size)


def inputs_hash(entry: SceneEntry, scene: Scene | None = None) -> str:
    """A hash of an entry's scene and mesh files, or of a Mitsuba file's text. scene: as loaded. Raises SceneError."""
    if entry.given is None and is_original(entry.path):
        return key_of([read_input(entry.path, "scene file")])
    return (scene or entry.load()).sha256()


def with_inputs_hash(entry: SceneEntry) -> SceneEntry:
    """The entry with its inputs_hash, or UNKNOWN, with which no worker judges it."""
    try:
        return replace(entry, inputs=inputs_hash(entry))
    except (SceneError, MemoryError):
        return replace(entry, inputs=UNKNOWN)


def entries_of_hits(
    name: str,
    path: str,
    scene: Scene,
    rays: RayList,
    hits: Mapping[str, Array],
    where: str,
    precision: str | None = None,
    row: int | None = None,
    options: tuple[str, ...] = (),
) -> list[SceneEntry]:
    """Entries that judge given hits of rays: one for nearest hits, one for any-hit answers. Raises SceneError.

    where: the source of the hits, for messages. row: of the one ray to judge; None: all of them.
    """
    count, hits = len(rays.rows), {name: values for name, values in hits.items() if name not in RAY_ARRAYS}
    for array, values in hits.items():
        if array not in HIT_ARRAYS:
            raise SceneError(f"{where}: expected arrays of {', '.join(HIT_ARRAYS)}, got '{array}'")
        if values.shape[:1] != (count,):
            raise SceneError(
                f"{where}: {array}: expected one row for each of the {count} rays, got shape {values.shape}"
            )
    if not {"t", "any_hit"} & hits.keys():
        raise SceneError(f"{where}: expected an array t, or any_hit; got {', '.join(hits)}")
    first, last = (0, count) if row is None else (row, row + 1)
    if first >= count:
        raise SceneError(f"--row {first}: expected a ray of 0 to {count - 1}")
    film, shared = lay_out(scene, rays._replace(rows=rays.rows[first:last]))
    arrays = {array: values[first:last] for array, values in hits.items()}
    endings = [("t", ""), ("any_hit", " any-hit" if "t" in hits else "")]
    return [
        SceneEntry(
            name + ending,
            path,
            options=options,
            given=film,
            subject=HitsFile(where, arrays, precision, array == "any_hit"),
            rays=shared,
            ray_range=(first, last),
            command="judge",
        )
        for array, ending in endings
        if array in hits
    ]


def problem_of(error: Exception) -> str:
    """The reason why a scene has no verdict."""
    if isinstance(error, CallEnded):
        return f"the process that casts and judges ended: {error}"
    if isinstance(error, OutputError):
        return f"cannot be written: {error}"
    if isinstance(error, SceneError):
        return f"cannot be judged: {error}"
    if isinstance(error, MemoryError):
        return f"cannot be judged: not enough memory{f': {error}' if str(error) else ''}"
    if isinstance(error, OSError):
        return f"cannot be judged: {error.filename or 'a file'}: {error.strerror or error}"
    return f"internal error, please report it: {type(error).__name__}: {error}"


class JudgeOptions(NamedTuple):
    """Options of judging a scene."""

    folder: Path | None = None  # for the images of both sides
    timeout: float = DEFAULT_TIMEOUT  # of Mitsuba, seconds
    store: bool = True  # reuse verdicts and responses of Mitsuba that earlier runs stored for equal inputs
    subject: Subject | None = None  # in place of our caster, for entries without their own
    page_of: Callable[[SceneVerdict], Any] | None = None  # makes the report's record of a verdict and its evidence
    threads: int | None = None  # of a worker; None: the default of this process
    film: bool = False  # keep the classes and images of whole films in verdicts
    thorough: bool = False  # make the checks of our caster beyond the films as well


def judge_entry(entry: SceneEntry, options: JudgeOptions) -> SceneVerdict:
    """Load and judge one scene in this process, or find its verdict. Raises what loading and judging raise."""
    if options.threads:
        set_default_threads(options.threads)
    scene = entry.load()
    if entry.inputs and inputs_hash(entry, scene) != entry.inputs:
        raise SceneError(
            f"{entry.path}: the worker on {os.uname().nodename} has another version of the scene or a mesh than this "
            "run: copy the files there"
        )
    folder, foreign = options.folder, entry.subject or options.subject
    # The files of --out and the pages of --html are made of what is seen, which is not stored.
    storable = options.store and not (folder or options.page_of or foreign)
    store = local_store() if storable else None
    about = {"size": entry.size, "options": entry.options, "thorough": options.thorough}
    key = verdict_key(scene, entry.path, **about) if store else ""
    if store and key:
        with suppress(ValidationError):  # there is none
            return replace(TypeAdapter(SceneVerdict).validate_json(store.get(key) or b""), kept=True)
    try:
        verdict = judge_loaded(entry, scene, options)
    except OutputError:
        raise
    except SceneError as error:  # no reference for a shape, or numbers beyond float32
        failed = SceneVerdict(entry.name, entry.path, problem=problem_of(error))
        verdict = _completed(failed, entry, scene, options)
    if store and key and not verdict.problem:
        store.put(key, json.dumps(verdict.to_dict(), allow_nan=False).encode())
    return verdict


def judge_loaded(entry: SceneEntry, scene: Scene, options: JudgeOptions) -> SceneVerdict:
    """The verdict of an entry's loaded scene. Raises SceneError for one that cannot be judged, OutputError."""
    verdict = validate_scene(
        Task(
            scene,
            entry.name,
            entry.path,
            entry.subject or options.subject or OURS,
            entry.rays,
            timeout=options.timeout,
            send=send_stored if options.store else send_request,
            thorough=options.thorough,
        ),
        first_ray=entry.ray_range[0],
        folder=options.folder,
        keep=options.page_of is not None,
        film=options.film,
        bounce=entry.bounce,
    )
    return _completed(verdict, entry, scene, options)


def _completed(verdict: SceneVerdict, entry: SceneEntry, scene: Scene, options: JudgeOptions) -> SceneVerdict:
    """The verdict with everything that a replay and the report need."""
    subject = entry.subject or options.subject or OURS
    found = replace(
        verdict,
        candidate=verdict.candidate or subject.name,
        resized=entry.size is not None and not entry.bounce,  # a bounce has a film of its own
        options=entry.options,
        command=entry.command,
        thorough=options.thorough,
        rays=entry.ray_range,
        composition=scene_statistics(scene),
    )
    return with_replay(replace(found, seen=options.page_of(found) if options.page_of and found.seen else None))


# ---- selection by an expression over names ----

OPERATORS = ("and", "or", "not", "(", ")")


def matching(expression: str | None) -> Callable[[str], bool]:
    """A predicate on names by an expression of parts of names, `and`, `or`, `not` and parentheses.

    Raises SceneError for a malformed expression.
    """
    if expression is None:
        return lambda name: True
    tokens = re.findall(r"[()]|[^\s()]+", expression)
    # Every word becomes a call with a quoted argument, so that nothing but `has` and operators can run.
    source = " ".join(token if token in OPERATORS else f"has({token!r})" for token in tokens)
    try:
        if "( )" in source or ") (" in source:
            raise SyntaxError
        code = compile(source, "-k", "eval")
    except (SyntaxError, MemoryError, RecursionError, ValueError):
        raise SceneError(
            f"-k {expression[:200]!r}: expected parts of names with and, or, not and parentheses"
        ) from None
    return lambda name: bool(eval(code, {"__builtins__": {}, "has": name.__contains__}))
