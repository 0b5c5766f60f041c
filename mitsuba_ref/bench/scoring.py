"""A scene of the benchmark on disk, in every form that some contestant reads."""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed, Triangles, pack, primitive_count
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from mitsuba_ref.bench.scenes import BenchScene, rays_of, unit
from mitsuba_ref.bench.work import ANY, DEFAULT, MESH_FILE, RAYS_FILE, ROBUST, SCENE_FILE, SHADING, SHADOW_END
from mitsuba_ref.error_model.bounds import reference_bounds
from mitsuba_ref.error_model.scene_model import SceneModel, model_of
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.reference.rendering import export


@dataclass(frozen=True)
class PreparedScene:
    """What is known of it here."""

    scene: Scene
    packed: Packed
    model: SceneModel
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32

    @property
    def primitives(self) -> int:
        return int(self.packed.first[-1])


def prepare_scene(scene: BenchScene, folder: Path, size: int) -> PreparedScene:
    """Write everything. size: of the film, or the square root of how many rays there are."""
    made = scene.make(folder).with_film(width=size, height=size)
    packed = pack(made, as_float32)
    o, d = rays_of(scene, made)
    rays = SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))
    model = model_of(made, packed, rays)
    (folder / SCENE_FILE).write_bytes(pickle.dumps(made))
    if scene.asks != SHADING:
        for name in (ROBUST, DEFAULT):
            export(made, model, robust=name == ROBUST).write(folder / name)
        np.savez(folder / RAYS_FILE, o=o, d=d)
    if all(isinstance(part, Triangles) for part in packed.parts):
        vertices, faces = merged_triangles(packed.parts)
        np.savez(folder / MESH_FILE, vertices=vertices, faces=faces)
    return PreparedScene(made, packed, model, o, d)


def merged_triangles(parts: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all shapes as one mesh: (n, 3) float32 corners, (m, 3) int32 faces."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    vertices = np.concatenate([part.vertices for part in parts])
    return vertices.astype(np.float32), np.concatenate(faces).astype(np.int32)


# Rays of float32 numbers that are aimed at edges and at silhouettes, from where the picture's rays start.


Rng = np.random.Generator
RayArrays = tuple[np.ndarray, np.ndarray]

EDGE_CANDIDATES = 8  # points tried for each that is kept: of a closed mesh, half of all faces look away


def at_edges(rng: Rng, ready: PreparedScene, rows: np.ndarray) -> RayArrays:
    """One ray for each of these rays of the picture: from where it starts, or, of parallel ones, along it.

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


def features(
    rng: Rng, ready: PreparedScene, sizes: np.ndarray, o: np.ndarray, d: np.ndarray | None
) -> np.ndarray:
    """(n, 3) a place for each ray; primitives are as likely as they are many."""
    which = rng.choice(len(sizes), len(o), p=sizes / sizes.sum())
    places = np.zeros((len(o), 3))
    for shape in np.unique(which):
        rows = np.flatnonzero(which == shape)
        part = ready.packed.parts[shape]
        place = on_edges if hasattr(part, "faces") else points_on_silhouettes
        places[rows] = place(rng, part, o[rows], None if d is None else d[rows])
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


# Who is how wrong: t against exact arithmetic, on rays of the picture and on rays aimed at edges.


EXACT_RAYS_PER_SORT = 2000  # rays of each sort


@dataclass(frozen=True)
class Score:
    """Over the sample of rays of the picture, and over those aimed at edges."""

    rays: int
    ulps: (
        float | None
    )  # largest |t - exact t| in float32 units in the last place of the exact t; None: nothing to compare
    bounds: float | None  # largest in units of the bound of its ray
    masks: int  # rays that hit where there is exactly nothing, or miss where there is something
    beyond: int  # hits whose t is beyond its bound, or not a number: another surface, or none
    edge_rays: int
    edge_masks: int
    edge_beyond: int


class ExactAnswers:
    """Rays and the exact answers about them."""

    def __init__(self, ready: PreparedScene, asks: str, seed: int, sample: int = EXACT_RAYS_PER_SORT) -> None:
        rng = np.random.default_rng([seed, 7])
        some = np.sort(rng.choice(len(ready.o), min(sample, len(ready.o)), replace=False))
        edges = at_edges(rng, ready, some)
        self.pictured = len(some)
        self.o, self.d = (
            np.concatenate(pair) for pair in zip((ready.o[some], ready.d[some]), edges, strict=True)
        )
        self.any = asks == ANY
        o, d = (a.astype(np.float64) for a in (self.o, self.d))
        end = SHADOW_END if self.any else np.inf
        self.answers = tuple(Oracle(ready.packed).first_hits(o, d, t_max=end))
        self.hit = np.array([answer.hit for answer in self.answers], bool)
        self.t = np.array([np.inf if answer.t is None else float(answer.t) for answer in self.answers])
        self.own, self.float32 = bounds(ready, self.answers, self.t, o, d)

    def score(self, t: np.ndarray, *, ours: bool) -> Score:
        """t: (n,) what somebody says about all rays, inf on a miss, NaN counts as a hit."""
        said = ~np.isposinf(t)
        wrong = said != self.hit
        both = np.flatnonzero(said & self.hit) if not self.any else np.zeros(0, int)
        off = np.array([_off(self.answers[i], float(t[i])) for i in both.tolist()])
        allowed = (self.own if ours else self.float32)[both]
        beyond = np.zeros(len(t), bool)
        beyond[both] = ~(off <= allowed)
        pictured = both < self.pictured
        with np.errstate(divide="ignore", invalid="ignore"):
            of_bound = np.where(off > 0.0, off / allowed, 0.0)[pictured]
        ulps = (off / np.spacing(np.abs(self.t[both]).astype(np.float32)).astype(np.float64))[pictured]
        here, there = slice(0, self.pictured), slice(self.pictured, None)
        return Score(
            rays=self.pictured,
            ulps=largest(ulps),
            bounds=largest(of_bound),
            masks=int(wrong[here].sum()),
            beyond=int(beyond[here].sum()),
            edge_rays=len(t) - self.pictured,
            edge_masks=int(wrong[there].sum()),
            edge_beyond=int(beyond[there].sum()),
        )


class TBounds(NamedTuple):
    own: np.ndarray  # (n,) of a float64 caster
    float32: np.ndarray  # (n,)


def bounds(
    ready: PreparedScene, answers: tuple[ExactAnswer, ...], t: np.ndarray, o: np.ndarray, d: np.ndarray
) -> TBounds:
    """How far t may be off at each ray, at the most generous of those that are exactly nearest; inf: no bound."""
    ray = np.repeat(np.arange(len(answers)), [len(answer.ties) for answer in answers])
    prim = np.array([tie.prim for answer in answers for tie in answer.ties], int)
    found = reference_bounds(ready.model, prim, o[ray], d[ray], t[ray])
    out = TBounds(np.zeros(len(answers)), np.zeros(len(answers)))
    for widest, meeting in zip(out, (found.own, found.at), strict=True):
        np.maximum.at(widest, ray, np.where(np.isnan(meeting.t_error), np.inf, meeting.t_error))
    return out


def _off(answer: ExactAnswer, t: float) -> float:
    """|t - exact|, rounded once; NaN for a NaN."""
    return float("nan") if answer.t is None or np.isnan(t) else answer.t.off(t)


def largest(values: np.ndarray) -> float | None:
    """The largest that is a number; None where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None
