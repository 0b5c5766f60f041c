"""Pairs of a primitive and a ray that is aimed at it, with the exact answer, of the numbers or of numbers nearby."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import decimal_intersections as exact
import numpy as np
from aimed_rays import Rng, Setting, rays_at, scene_of
from decimal_intersections import Met, exactly

from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.shapes import kind_of, reference_of

Off = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Pairs:
    """m pairs of one kind."""

    prims: Any  # float32 values
    k: np.ndarray  # (m,)
    o: np.ndarray  # (m, 3) float32 values
    d: np.ndarray  # (m, 3)
    model: Any  # ErrorModel
    seen: Any  # what the model reads in place of prims, where that is another thing

    @property
    def name(self) -> str:
        return type(self.prims).__name__

    def intersect(self, ku: float, *, ours: bool = False) -> tuple[Intersections, ...]:
        intersect = (ours and self.model.intersect_ours) or self.model.intersect
        return intersect(self.seen, self.k, self.o, self.d, ku)

    def solve(self, off: Off = lambda numbers: numbers) -> tuple[Met, ...]:
        """Exactly; `off` moves every number that an error model takes for rounded."""
        prims, k = self.prims, self.k
        o, d = exactly(self.o), off(exactly(self.d))
        if self.name == "Triangles":
            return self._solve_triangles(off, o, d)
        if self.name == "Planes":
            return exact.plane(off(exactly(prims.normal[k])), off(exactly(prims.point[k])), off(o), d)
        if self.name == "Spheres":
            return exact.sphere(off(exactly(prims.center[k])), off(exactly(prims.radius[k])), off(o), d)
        inverse = inverses(exactly(prims.to_world))[k]
        shift = -exact.dot(inverse, exactly(prims.center[k])[:, None, :])
        return exact.ROUND[self.name](exact.to_quadric(off(inverse), off(shift), off(o), d))

    def _solve_triangles(self, off: Off, o: np.ndarray, d: np.ndarray) -> tuple[Met, ...]:
        """Differences of corners and origin are what is rounded; the normal is made of differences of corners."""
        corners, normals = (exactly(a[self.prims.faces[self.k]]) for a in (self.prims.vertices, self.prims.normals))
        (met,) = exact.triangle(off(corners - o[:, None, :]), d, off(normals))
        n = exact.unit(exact.cross(*(off(corners[:, j] - corners[:, 0]) for j in (1, 2))))
        sh_n = np.where(self.prims.smooth[self.k][:, None], met.sh_n, n)
        return (met._replace(n=n, sh_n=sh_n),)


def inverses(m: np.ndarray) -> np.ndarray:
    """Of matrices (m, 3, 3), by Cramer's rule."""
    a, b, c = (m[:, j] for j in range(3))
    rows = np.stack([exact.cross(b, c), exact.cross(c, a), exact.cross(a, b)], axis=2)
    return rows / exact.dot(a, exact.cross(b, c))[:, None, None]


def pose(kind: str, setting: Setting, seed: list[int], count: int = 300, shapes: int = 10) -> Pairs:
    """`count` pairs; each shape is one primitive."""
    rng = np.random.default_rng(seed)
    scene = scene_of(kind, rng, setting, shapes)
    packed, (o, d) = pack(scene, as_float32), rays_at(scene, rng, setting, count)
    reference, prims = reference_of(scene.shapes[0]), packed.kinds[0].prims
    k = np.repeat(np.arange(shapes), -(-count // shapes))[:count]
    return Pairs(prims, k, o, d, kind_of(prims).model, reference.stand_in(prims, o, d))


def rounding(rng: Rng, u: float) -> Off:
    """Moves each number by u of itself, up or down, or by some share of that."""

    def off(numbers: np.ndarray) -> np.ndarray:
        share = np.clip(rng.uniform(-2.0, 2.0, numbers.shape), -1.0, 1.0)
        return numbers * (1 + exactly(u * share))

    return off
