"""One pixel under the lens: its ray, what it meets, and what it would meet of every shape alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from caster.casting import find_nearest
from caster.fields import SceneError
from caster.kernels.nearest import Rays
from caster.packing import Kind, Packed
from caster.rendering import camera_rays, look
from caster.scene import Scene
from caster.tried import Tried, try_each


@dataclass(frozen=True)
class Candidate:
    """The first hit of a ray with one shape, as if that stood alone."""

    t: float
    shape_id: int
    prim_id: int


@dataclass(frozen=True)
class Probe:
    """The ray through a pixel's centre and what it meets. t counts in lengths of d, which is 1."""

    scene: Scene
    x: int
    y: int
    o: np.ndarray  # (3,) float64
    d: np.ndarray  # (3,) float64
    t_min: float
    t_max: float  # < 0: the camera has no ray here
    hit: Candidate | None
    surface: dict[str, np.ndarray]  # p, n, sh_n (3,) and uv (2,); empty on a miss
    candidates: tuple[Candidate, ...]  # one for each shape that is hit, nearest first
    prims: int  # how many primitives were tried
    packed: Packed
    rays: Rays

    @property
    def missed(self) -> int:
        """How many shapes the ray does not meet."""
        return len(self.scene.shapes) - len(self.candidates)

    @cached_property
    def tried(self) -> tuple[Tried, ...]:
        """Each primitive alone, hits by t and then misses by how nearly; of many, the near ones."""
        return try_each(self.packed, self.rays)

    @cached_property
    def pixel(self) -> float | None:
        """How wide a pixel is at the hit, scene units; None on a miss, or on a film of one pixel."""
        return pixel_size(self.scene, self.x, self.y, self.hit.t) if self.hit else None


def probe(scene: Scene, x: int, y: int) -> Probe:
    """Cast the ray of one pixel, once as `render` does and once against each shape with no culling.

    Raises SceneError for a pixel outside the film.
    """
    film = scene.film
    if not (0 <= x < film.width and 0 <= y < film.height):
        inside = f"0 <= x < {film.width} and 0 <= y < {film.height}"
        raise SceneError(f"pixel ({x}, {y}): outside the film, expected {inside}")
    view = look(scene.with_film(crop=(x, y, x + 1, y + 1)), threads=1)
    rays, nearest = view.rays, view.nearest
    hit = Candidate(float(nearest.t[0]), int(view.shape_id[0]), int(view.prim_id[0])) if view.hit[0] else None
    surface = {name: rows[0] for name, rows in view.surfaces._asdict().items()} if hit else {}
    candidates = tuple(sorted(_each_alone(view.packed, rays), key=lambda c: (c.t, c.shape_id)))
    ends = float(rays.t_min[0]), float(rays.t_max[0])
    prims = int(view.packed.first[-1])
    o, d = rays.o[0], rays.d[0]
    return Probe(scene, x, y, o, d, *ends, hit, surface, candidates, prims, view.packed, rays)


def pixel_size(scene: Scene, x: int, y: int, t: float) -> float | None:
    """How far apart the rays of this pixel and of one beside it are at t; None where none is beside it."""
    film = scene.film
    ends = (x, x + 1) if x + 1 < film.width else (x - 1, x)
    if ends[0] < 0:
        return None
    rays = camera_rays(scene.with_film(crop=(ends[0], y, ends[1] + 1, y + 1)))
    if (rays.t_max < 0.0).any():
        return None
    return float(np.linalg.norm((rays.o[1] + t * rays.d[1]) - (rays.o[0] + t * rays.d[0])))


def _each_alone(packed: Packed, rays: Rays) -> Iterator[Candidate]:
    for shape_id, part in enumerate(packed.parts):
        nearest = find_nearest(_only(part, packed, shape_id), rays, "everything", threads=1)
        if nearest.prim[0] >= 0:
            yield Candidate(float(nearest.t[0]), shape_id, int(nearest.prim[0]))


def _only(part: Any, packed: Packed, shape_id: int) -> Packed:
    """A scene of one shape, its primitives numbered from 0."""
    count = int(packed.first[shape_id + 1] - packed.first[shape_id])
    zero = np.zeros(1, np.int64)
    kind = Kind(part, np.arange(count, dtype=np.int32))
    return Packed((kind,), (part,), np.array([0, count], np.int64), zero, zero)
