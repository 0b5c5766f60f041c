"""Errors of casters: scenes written in every form that one of them reads, and exact answers."""

import pickle
from pathlib import Path

import numpy as np

from caster.scene.model import Scene
from caster.shapes.sphere import Spheres
from mitsuba_ref.bench.drivers import ANY, DEFAULT, RAYS_FILE, ROBUST, SCENE_FILE, SHADOW_END
from mitsuba_ref.bench.result import Score
from mitsuba_ref.bench.scenes import BenchScene, Rays
from mitsuba_ref.hard.rays import Targets
from mitsuba_ref.hard.swept_families import unit
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, prepare_scene
from mitsuba_ref.reference.shared_input import export, packed_float32, shared_rays
from mitsuba_ref.report.results import largest
from mitsuba_ref.subjects.subject import Answer, scene_as_traced

EXACT_RAYS_PER_SORT = 2000  # rays of the film, and as many aimed at edges


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


def at_edges(rng: np.random.Generator, ready: PreparedScene, rows: np.ndarray) -> Rays:
    """Rays aimed at edges, rims and silhouettes, from the origins of these rays, or parallel to them."""
    o, d = ready.o[rows].astype(np.float64), ready.d[rows].astype(np.float64)
    targets, parallel = Targets(ready.packed, rng), ready.scene.camera.type == "orthographic"
    picks = targets.pick(len(rows))
    p = targets.points(picks, "edge").p
    for shape, part in enumerate(ready.packed.parts):
        if isinstance(part, Spheres):
            of, k = np.flatnonzero(picks.shape == shape), picks.k[picks.shape == shape]
            p[of] = on_silhouettes(rng, part.center[k], part.radius[k][:, None], o[of], d[of] if parallel else None)
    if parallel:
        return (p - 4.0 * d).astype(np.float32), ready.d[rows]
    # Of length 1, as renderers make them: Mitsuba's LLVM variant is farther off on spheres along longer ones.
    return ready.o[rows], unit(p - o).astype(np.float32)


def on_silhouettes(
    rng: np.random.Generator, center: np.ndarray, r: np.ndarray, o: np.ndarray, d: np.ndarray | None
) -> np.ndarray:
    """Points in which tangents from o, or along d, touch spheres."""
    away = o - center
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    axis = away / distance if d is None else d
    across = unit(np.cross(axis, rng.normal(size=axis.shape)))
    cosine = np.minimum(r / distance, 1.0) if d is None else np.zeros_like(r)  # of the angle at the centre
    points: np.ndarray = center + r * (cosine * axis + np.sqrt(1.0 - cosine**2) * across)
    return points


class ExactAnswers:
    """Sampled rays of the film and rays aimed at edges, with their exact answers."""

    def __init__(self, ready: PreparedScene, workload: str, seed: int, sample: int = EXACT_RAYS_PER_SORT) -> None:
        rng = np.random.default_rng([seed, 7])
        some = np.sort(rng.choice(len(ready.o), min(sample, len(ready.o)), replace=False))
        pairs = zip((ready.o[some], ready.d[some]), at_edges(rng, ready, some), strict=True)
        self.o, self.d = (np.concatenate(pair) for pair in pairs)
        self.film_rays, self.any = len(some), workload == ANY
        self.exact = ExactHits(ready, self.o, self.d, SHADOW_END if self.any else np.inf)

    def score(self, t: np.ndarray, precision: str, *, reference: bool = False) -> Score:
        """t: (n,) of a caster along all rays, inf on a miss. reference: by the bounds of Mitsuba's own arithmetic."""
        answer = Answer(t, None, precision, {}, hits_only=self.any)
        ratio, hits = self.exact.ratios(answer, ours=not reference), answer.hit & self.exact.hit
        masks, beyond = answer.hit != self.exact.hit, hits & ~(ratio <= 1.0)
        compared = np.zeros_like(hits) if self.any else hits
        errors = np.where(compared, self.exact.errors(t), np.nan)
        spacing = np.spacing(np.abs(self.exact.t).astype(np.float32)).astype(np.float64)
        film, edges = slice(self.film_rays), slice(self.film_rays, None)
        return Score(
            rays=self.film_rays,
            ulps=largest((errors / spacing)[film]),
            bounds=largest(ratio[film][compared[film]]),
            masks=int(masks[film].sum()),
            beyond=int(beyond[film].sum()),
            edge_rays=len(t) - self.film_rays,
            edge_masks=int(masks[edges].sum()),
            edge_beyond=int(beyond[edges].sum()),
        )
