"""Errors of contestants: scenes on disk in every form that some contestant reads, and exact answers to judge t by."""

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.geometry.packing import Triangles, primitive_count
from caster.shapes.sphere import Spheres
from mitsuba_ref.bench.entries import (
    ANY,
    DEFAULT,
    MESH_FILE,
    RAYS_FILE,
    ROBUST,
    SCENE_FILE,
    SHADING,
    SHADOW_END,
    VALIDATION,
)
from mitsuba_ref.bench.result import Score
from mitsuba_ref.bench.scenes import BenchScene, rays_of, unit
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, prepare_scene
from mitsuba_ref.reference.shared_input import export
from mitsuba_ref.report.results import largest
from mitsuba_ref.shapes import kind_of

Rng = np.random.Generator
RayArrays = tuple[np.ndarray, np.ndarray]

EXACT_RAYS_PER_SORT = 2000  # rays of the film, and as many aimed at edges
EDGE_CANDIDATES = 8  # points tried for each that is kept: of a closed mesh, half of all faces look away


def write_scene(scene: BenchScene, folder: Path, size: int) -> PreparedScene:
    """Write the scene in every form. size: pixels a side, or the square root of the number of rays."""
    made = scene.make(folder).with_film(width=size, height=size)
    ready = prepare_scene(made, *rays_of(scene, made))
    (folder / SCENE_FILE).write_bytes(pickle.dumps(made))
    if scene.workload not in (SHADING, VALIDATION):
        for name in (ROBUST, DEFAULT):
            export(made, ready.model, robust=name == ROBUST).write(folder / name)
        np.savez(folder / RAYS_FILE, o=ready.o, d=ready.d)
    if all(isinstance(part, Triangles) for part in ready.packed.parts):
        vertices, faces = merged_triangles(ready.packed.parts)
        np.savez(folder / MESH_FILE, vertices=vertices, faces=faces)
    return ready


def merged_triangles(parts: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all shapes as one mesh: (n, 3) float32 corners, (m, 3) int32 faces."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    vertices = np.concatenate([part.vertices for part in parts])
    return vertices.astype(np.float32), np.concatenate(faces).astype(np.int32)


def at_edges(rng: Rng, ready: PreparedScene, rows: np.ndarray) -> RayArrays:
    """One ray for each of these rays of the film: from where it starts, or, of parallel ones, along it.

    At a point of a triangle's edge whose face looks that way, or past a sphere's silhouette by nothing.
    """
    o = ready.o[rows].astype(np.float64)
    sizes = np.array([primitive_count(part) for part in ready.packed.parts])
    if ready.scene.camera.type == "orthographic":
        d = ready.d[rows].astype(np.float64)
        p = features(rng, ready, sizes, o, d)
        start = (p - 4.0 * d).astype(np.float32)
        return start, d.astype(np.float32)
    p = features(rng, ready, sizes, o, None)
    # Of length 1, as renderers make them: Mitsuba's LLVM variant is farther off on spheres along longer ones.
    return o.astype(np.float32), unit(p - o).astype(np.float32)


def features(rng: Rng, ready: PreparedScene, sizes: np.ndarray, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """(n, 3) a place for each ray; primitives are as likely as they are many."""
    which = rng.choice(len(sizes), len(o), p=sizes / sizes.sum())
    places = np.zeros((len(o), 3))
    for shape in np.unique(which):
        rows = np.flatnonzero(which == shape)
        part = ready.packed.parts[shape]
        along = None if d is None else d[rows]
        if isinstance(part, Triangles):
            places[rows] = on_edges(rng, part, o[rows], along)
        elif isinstance(part, Spheres):
            places[rows] = points_on_silhouettes(rng, part, o[rows], along)
        else:
            k = rng.integers(primitive_count(part), size=len(rows))
            places[rows] = kind_of(part).surface_points(part, k, rng, "edge").p
    return places


def on_edges(rng: Rng, part: Any, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """Places between the ends of edges, float64; of some that are tried, one of a face that looks at the ray."""
    k = rng.integers(len(part.faces), size=(EDGE_CANDIDATES, len(o)))
    corners = part.vertices[part.faces[k]]  # (turns, n, 3 corners, 3)
    n = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    way = corners[..., 0, :] - o if d is None else np.broadcast_to(d, n.shape)
    facing = np.einsum("...i,...i", n, way) < 0.0
    turn = np.argmax(facing, axis=0)  # the first, or 0 where none does
    kept = corners[turn, np.arange(len(o))]
    first = rng.integers(3, size=len(o))
    a, b = (kept[np.arange(len(o)), (first + step) % 3] for step in (0, 1))
    places: np.ndarray = a + rng.random((len(o), 1)) * (b - a)
    return places


def points_on_silhouettes(rng: Rng, part: Any, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """Where the tangents from o touch spheres, or those along d."""
    k = rng.integers(len(part.radius), size=len(o))
    center, r = part.center[k], part.radius[k][:, None]
    away = o - center
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    axis = away / distance if d is None else d
    across = np.cross(axis, rng.normal(size=axis.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cosine = np.minimum(r / distance, 1.0) if d is None else np.zeros_like(r)  # of the angle at the centre
    places: np.ndarray = center + r * (cosine * axis + np.sqrt(1.0 - cosine**2) * across)
    return places


class ExactAnswers:
    """Rays of the film and rays aimed at edges, with their exact answers."""

    def __init__(self, ready: PreparedScene, workload: str, seed: int, sample: int = EXACT_RAYS_PER_SORT) -> None:
        rng = np.random.default_rng([seed, 7])
        some = np.sort(rng.choice(len(ready.o), min(sample, len(ready.o)), replace=False))
        edges = at_edges(rng, ready, some)
        self.film_rays = len(some)
        pairs = zip((ready.o[some], ready.d[some]), edges, strict=True)
        self.o, self.d = (np.concatenate(pair) for pair in pairs)
        self.any = workload == ANY
        self.exact = ExactHits(ready, self.o, self.d, SHADOW_END if self.any else np.inf)

    @property
    def hit(self) -> np.ndarray:
        return self.exact.hit

    @property
    def t(self) -> np.ndarray:
        """(n,) to the nearest float64, inf on a miss."""
        return self.exact.t

    def score(self, t: np.ndarray, *, ours: bool) -> Score:
        """t: (n,) of a contestant along all rays, inf on a miss; a NaN counts as a hit."""
        hit = ~np.isposinf(t)
        wrong = hit != self.hit
        both = np.flatnonzero(hit & self.hit) if not self.any else np.zeros(0, int)
        errors = self.exact.errors(both, t[both])
        allowed = (self.exact.float64 if ours else self.exact.float32)[both]
        beyond = np.zeros(len(t), bool)
        beyond[both] = ~(errors <= allowed)
        on_film = both < self.film_rays
        with np.errstate(divide="ignore", invalid="ignore"):
            of_bound = np.where(errors > 0.0, errors / allowed, 0.0)[on_film]
        ulps = (errors / np.spacing(np.abs(self.t[both]).astype(np.float32)).astype(np.float64))[on_film]
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
