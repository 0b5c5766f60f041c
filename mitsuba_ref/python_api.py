"""The functions of `import mitsuba_ref`, which do what the commands do, by the same code."""

import os
from collections.abc import Callable, Mapping, Sequence
from operator import index
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from caster.cli.shared_arguments import display_names, scene_files
from caster.scene.model import Scene
from mitsuba_ref.judge.checks import run_checks
from mitsuba_ref.probe.pixel import probe_with_evidence
from mitsuba_ref.probe.verdict import PixelVerdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.shared_input import export_scene
from mitsuba_ref.report import builtin_scenes
from mitsuba_ref.report.validation import Validation
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, entries_of_hits, judge_loaded
from mitsuba_ref.subjects.function import function_subject
from mitsuba_ref.subjects.ray_files import RayList, checked_rays, read_arrays, read_rays
from mitsuba_ref.subjects.requests import parse_candidate
from mitsuba_ref.subjects.subject import Subject

ScenePath: TypeAlias = str | os.PathLike[str]  # of a scene or mesh file, or builtin:NAME
Candidate: TypeAlias = str | Callable[..., Any]


def validate(
    scene: Scene | ScenePath | Sequence[Scene | ScenePath] | None = None,
    *,
    candidate: Candidate | None = None,
    size: tuple[int, int] | None = None,
    precision: str | None = None,
    builtin: str | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> Validation:
    """Compare our caster, or a candidate in its place, with Mitsuba.

    - scene: a Scene, the path of a scene or mesh file, of a folder of them, builtin:NAME, or several of these.
    - candidate: a function(scene, o, d) -> (t, n), or text as for --candidate (docs/candidates.md).
    - size: (width, height) of the film in pixels, in place of the scenes' own.
    - precision: "float32" or "float64", the candidate's arithmetic; default: the type of its arrays.
    - builtin: a set of built-in scenes: "triangles", "spheres", "others" or "all".
    - timeout: seconds that Mitsuba may take for a scene.

    Faults of the candidate and a crash of Mitsuba are in the verdict. Raises SceneError for a scene that is not valid,
    a candidate that cannot be used, or where Mitsuba is not installed; FileMissing; MissingReferenceError for a shape
    without a reference.
    """
    if scene is None and builtin is None:
        raise TypeError("validate: expected a scene, or builtin='triangles'")
    given: list[Scene | ScenePath] = [*builtin_scenes.folders_of(builtin)]
    given += [] if scene is None else [scene] if isinstance(scene, Scene | str | os.PathLike) else scene
    sources: list[Scene | str] = []
    for each in given:
        path = each if isinstance(each, Scene) else builtin_scenes.scene_path(os.fspath(each))
        sources += [path] if isinstance(path, Scene) else scene_files([path])
    names = display_names([f"{i}/scene" if isinstance(each, Scene) else each for i, each in enumerate(sources)])
    entries = [_entry(name, each, size) for name, each in zip(names, sources, strict=True)]
    return _judged(entries, JudgeOptions(subject=_subject(candidate, precision), timeout=timeout))


def judge_hits(
    scene: Scene | ScenePath,
    rays: np.ndarray | ScenePath,
    hits: Mapping[str, np.ndarray] | ScenePath,
    *,
    precision: str | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> Validation:
    """Judge the hits of any rays, as `mitsuba-ref judge` does.

    - rays: (n, 8) float32 or float64: o, d, t_min, t_max; or a .npz file of them.
    - hits: (n,) arrays by name: t, and where they are given n (n, 3), shape_id, prim_id, any_hit; or a file of them.
    - precision: the arithmetic of the hits; default: the type of t and n.

    Raises SceneError, FileMissing.
    """
    found: RayList = checked_rays(rays, "rays") if isinstance(rays, np.ndarray) else read_rays(os.fspath(rays))
    given = hits if isinstance(hits, Mapping) else read_arrays(os.fspath(hits))
    arrays = {array: np.asarray(values) for array, values in given.items()}
    entry = _entry("scene" if isinstance(scene, Scene) else Path(scene).stem, scene)
    entries = entries_of_hits(entry.name, entry.path, entry.load(), found, arrays, "hits", precision)
    return _judged(entries, JudgeOptions(timeout=timeout))


def probe_pixel(
    scene: Scene | ScenePath,
    x: int,
    y: int,
    *,
    candidate: Candidate | None = None,
    size: tuple[int, int] | None = None,
    precision: str | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> PixelVerdict:
    """Explain one pixel, as `mitsuba-ref probe` does; str() of the verdict is its text. Arguments as for `validate`.

    Raises SceneError, also for a pixel outside the film, and FileMissing.
    """
    variants.require_variants()
    return probe_with_evidence(
        _entry("", scene, size).load(), index(x), index(y), _subject(candidate, precision), timeout
    )[0]


def export_xml(scene: Scene | ScenePath, folder: ScenePath) -> Path:
    """Write a scene as Mitsuba XML, with its meshes as PLY, for plain Mitsuba; returns the path of the XML.

    Raises OutputError, and what loading a scene raises.
    """
    return export_scene(_entry("", scene).load()).write(Path(folder))


def _entry(name: str, scene: Scene | ScenePath, size: tuple[int, int] | None = None) -> SceneEntry:
    if size is not None and np.shape(size) != (2,):
        raise TypeError(f"size: expected (width, height), got {size!r}")
    if isinstance(scene, Scene):
        return SceneEntry(name, "", size, given=scene)
    return SceneEntry(name, builtin_scenes.scene_path(os.fspath(scene)), size)


def _subject(candidate: Candidate | None, precision: str | None) -> Subject | None:
    """The candidate, None for our caster. Raises SceneError, TypeError."""
    if isinstance(candidate, str):
        return parse_candidate(candidate, precision)
    if callable(candidate):
        return function_subject(candidate, precision=precision)
    if candidate is not None:
        raise TypeError(f"candidate: expected a function(scene, o, d) -> (t, n), or text, got {candidate!r}")
    if precision is not None:
        raise TypeError("precision: expected a candidate beside it, whose arithmetic it is")
    return None


def _judged(entries: Sequence[SceneEntry], options: JudgeOptions) -> Validation:
    """The verdict of all entries with its evidence. Raises for a scene that has no verdict."""
    variants.require_variants()
    options = options._replace(page_of=lambda verdict: verdict.seen, film=True)
    verdicts = tuple(judge_loaded(entry, entry.load(), options) for entry in entries)
    names = tuple(entry.name for entry in entries)
    return Validation(verdicts, len(entries), names, checks=run_checks(options.subject))
