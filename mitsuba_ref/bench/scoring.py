"""Errors of casters: scenes written in every form that one of them reads, and exact answers."""

import pickle
from pathlib import Path

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.bench.drivers import DEFAULT, RAYS_FILE, ROBUST, SCENE_FILE
from mitsuba_ref.bench.result import Score
from mitsuba_ref.bench.scenes import BenchScene, Rays
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.scene_model import Side
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, prepare_scene
from mitsuba_ref.reference.shared_input import export, packed_float32, shared_rays
from mitsuba_ref.report.results import largest
from mitsuba_ref.subjects.subject import Answer, scene_as_traced

EXACT_RAYS = 2000  # rays of a scene whose exact answers are computed


def write_scene(scene: BenchScene, folder: Path, size: int) -> PreparedScene:
    """Write the scene in every form. size: pixels a side, or the square root of the number of rays."""
    made = scene.make().with_film(width=size, height=size)
    made = scene_as_traced(made, packed_float32(made), folder)
    ready = prepare_scene(made, *rays_of(scene, made))
    (folder / SCENE_FILE).write_bytes(pickle.dumps(made))
    for name in (ROBUST, DEFAULT):
        export(made, ready.model, robust=name == ROBUST).write(folder / name)
    np.savez(folder / RAYS_FILE, o=ready.o, d=ready.d)
    return ready


def rays_of(scene: BenchScene, made: Scene) -> Rays:
    """The scene's own rays, or else its camera's; one for each pixel."""
    if scene.rays:
        return scene.rays(made)
    shared = shared_rays(made)
    real = shared.t_max > 0.0  # a fisheye's image has corners without rays
    return shared.o[real], shared.d[real]


def sampled_rows(count: int) -> Array:
    """Rows of the rays whose exact answers are computed, ascending; the same for the same count."""
    return np.sort(np.random.default_rng(7).choice(count, min(EXACT_RAYS, count), replace=False))


def score(exact: ExactHits, t: Array, precision: str, *, reference: bool = False) -> Score:
    """t: (n,) of a caster along all rays, inf on a miss. reference: by the bounds of Mitsuba's own arithmetic."""
    answer = Answer(t, None, precision, {})
    ratio, hits = exact.ratios(answer, Side(answer.ku, own=not reference)), answer.hit & exact.hit
    spacing = np.spacing(np.abs(exact.t).astype(np.float32)).astype(np.float64)
    return Score(
        rays=len(t),
        ulps=largest(exact.errors(t) / spacing),
        bounds=largest(ratio[hits]),
        masks=int(np.sum(answer.hit != exact.hit)),
        beyond=int(np.sum(hits & ~(ratio <= 1.0))),
    )
