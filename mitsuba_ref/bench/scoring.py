"""Errors of contestants: scenes on disk in every form that some contestant reads, and exact answers to judge t by."""

import pickle
from pathlib import Path

import numpy as np

from caster.geometry.packing import Triangles
from caster.scene.model import Scene
from caster.shapes.sphere import Spheres
from mitsuba_ref.bench.entries import ANY, DEFAULT, MESH_FILE, RAYS_FILE, ROBUST, SCENE_FILE, SHADOW_END
from mitsuba_ref.bench.result import Score
from mitsuba_ref.bench.scenes import BenchScene, Rays, unit
from mitsuba_ref.hard.rays import Targets
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, prepare_scene
from mitsuba_ref.reference.shared_input import export, packed_float32, shared_rays
from mitsuba_ref.report.results import largest
from mitsuba_ref.subjects.subject import scene_as_traced

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
    parts = ready.packed.parts
    if all(isinstance(part, Triangles) for part in parts):
        first = np.cumsum([0, *(len(part.vertices) for part in parts)])
        faces = np.concatenate([part.faces + start for part, start in zip(parts, first, strict=False)])
        vertices = np.concatenate([part.vertices for part in parts])
        np.savez(folder / MESH_FILE, vertices=vertices.astype(np.float32), faces=faces.astype(np.int32))
    return ready


def rays_of(scene: BenchScene, made: Scene) -> Rays:
    """The rays that are handed over, or those of the camera; one for each pixel."""
    if scene.rays:
        return scene.rays(made)
    shared = shared_rays(made)
    real = shared.t_max > 0.0  # a fisheye's image has corners without rays
    return shared.o[real], shared.d[real]


def at_edges(rng: np.random.Generator, ready: PreparedScene, rows: np.ndarray) -> Rays:
    """A ray from where each of these rays starts, of parallel ones along it, to an edge, a rim or a silhouette."""
    o, d = ready.o[rows].astype(np.float64), ready.d[rows].astype(np.float64)
    targets, parallel = Targets(ready.packed), ready.scene.camera.type == "orthographic"
    picks = targets.pick(rng, len(rows))
    p = targets.points(rng, picks, "edge").p
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
    """Where tangents from o touch spheres, or those along d."""
    away = o - center
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    axis = away / distance if d is None else d
    across = unit(np.cross(axis, rng.normal(size=axis.shape)))
    cosine = np.minimum(r / distance, 1.0) if d is None else np.zeros_like(r)  # of the angle at the centre
    points: np.ndarray = center + r * (cosine * axis + np.sqrt(1.0 - cosine**2) * across)
    return points


class ExactAnswers:
    """Rays of the film and rays aimed at edges, with their exact answers."""

    def __init__(self, ready: PreparedScene, workload: str, seed: int, sample: int = EXACT_RAYS_PER_SORT) -> None:
        rng = np.random.default_rng([seed, 7])
        some = np.sort(rng.choice(len(ready.o), min(sample, len(ready.o)), replace=False))
        pairs = zip((ready.o[some], ready.d[some]), at_edges(rng, ready, some), strict=True)
        self.o, self.d = (np.concatenate(pair) for pair in pairs)
        self.film_rays, self.any = len(some), workload == ANY
        self.exact = ExactHits(ready, self.o, self.d, SHADOW_END if self.any else np.inf)

    def score(self, t: np.ndarray, *, ours: bool) -> Score:
        """t: (n,) of a contestant along all rays, inf on a miss; a NaN counts as a hit."""
        hit = ~np.isposinf(t)
        wrong = hit != self.exact.hit
        both = np.flatnonzero(hit & self.exact.hit) if not self.any else np.zeros(0, int)
        errors = self.exact.errors(both, t[both])
        allowed = (self.exact.float64 if ours else self.exact.float32)[both]
        beyond = np.zeros(len(t), bool)
        beyond[both] = ~(errors <= allowed)
        on_film = both < self.film_rays
        with np.errstate(divide="ignore", invalid="ignore"):
            of_bound = np.where(errors > 0.0, errors / allowed, 0.0)[on_film]
        ulps = (errors / np.spacing(np.abs(self.exact.t[both]).astype(np.float32)).astype(np.float64))[on_film]
        film, edges = slice(0, self.film_rays), slice(self.film_rays, None)
        return Score(
            rays=self.film_rays,
            ulps=largest(ulps),
            bounds=largest(of_bound),
            masks=int(wrong[film].sum()),
            beyond=int(beyond[film].sum()),
            edge_rays=len(t) - self.film_rays,
            edge_masks=int(wrong[edges].sum()),
            edge_beyond=int(beyond[edges].sum()),
        )
