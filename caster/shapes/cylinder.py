"""An open tube."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.fields import Positive, Shape, Vec3
from caster.kernels.exact_quadric import exact_tube, placed
from caster.kernels.exact_root import Root
from caster.kernels.jit import implement, inlined
from caster.kernels.protocol import (
    facing,
    hull_point,
    hull_size,
    intersect,
    normal,
    numbers,
    passes,
    plain_normal,
    prepare,
    root,
    same,
    surface,
)
from caster.kernels.roots import approach, ball_at, chord, earlier, is_plain_through, plain_way_out, way_out
from caster.kernels.vec import (
    SEEN_ERROR,
    TINY,
    add,
    angle_fraction,
    answer,
    by_columns,
    by_rows,
    no_terms,
    row,
    row_sizes,
    rows_of,
    seen,
    size,
    sub,
    sure_within,
    turned,
    turned_back,
    unit,
)
from caster.placing import Rounding, affine_arrays


class Cylinders(NamedTuple):
    """Images of the unit tube x^2 + y^2 = 1, 0 <= z <= 1 under p -> center + to_world p."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


class Cylinder(Shape):
    """The wall of a cylinder around the axis p0-p1, without caps, visible from inside and outside.

    The normal points away from the axis.
    """

    type: Literal["cylinder"] = "cylinder"
    p0: Vec3 = (0.0, 0.0, 0.0)
    p1: Vec3 = (0.0, 0.0, 1.0)
    radius: Positive = 1.0

    @model_validator(mode="after")
    def _has_an_axis(self) -> "Cylinder":
        if self.p0 == self.p1:
            raise ValueError(f"p0 and p1 must be different points, got {list(self.p0)} for both")
        return self

    def pack(self, rounded: Rounding) -> Cylinders:
        linear = self.matrix[:3, :3]
        center = linear @ np.array(self.p0) + self.matrix[:3, 3]
        return Cylinders(*affine_arrays(center, linear @ self._own_axes(), rounded))

    def _own_axes(self) -> np.ndarray:
        """Columns: two radii across the axis, and the axis; right-handed."""
        axis = np.array(self.p1) - np.array(self.p0)
        along = axis / np.linalg.norm(axis)
        if along[0] == along[1] == 0.0 and along[2] > 0.0:
            first = np.array([1.0, 0.0, 0.0])
        else:
            first = np.cross(np.eye(3)[np.argmin(np.abs(along))], along)
            first /= np.linalg.norm(first)
        return np.column_stack([self.radius * first, self.radius * np.cross(along, first), axis])


@implement(numbers, Cylinders)
def _numbers(prims: Any, k: int) -> Any:
    m = rows_of(prims.to_object, k)
    x, y, z = row_sizes(m)
    return row(prims.center, k), m, SEEN_ERROR * (x + y), SEEN_ERROR * z


@implement(prepare, Cylinders)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    """(to_object, the wall there, the origin's height and its error, by how much d is off there over its size)."""
    center, m, across_off, along_off = prim
    f, off = seen(m, sub(o, center))
    return m, ball_at((f[0], f[1], 0.0), 1.0, off[0] + off[1]), f[2], off[2], across_off, along_off


@implement(intersect, Cylinders)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    m, wall, height, height_off, across_off, along_off = pre
    e, d1 = by_rows(m, d), size(d)
    roots = chord(wall, (e[0], e[1], 0.0), across_off * d1)
    axis = height, height_off, e[2], along_off * d1
    near = between_ends(sure_within(roots.near, roots.near_off, t_min, t_max), axis)
    far = between_ends(sure_within(roots.far, roots.far_off, t_min, t_max), axis)
    t, off = earlier(near, far)
    along_axis = no_terms(m[0], d) & no_terms(m[1], d)  # exactly so
    return answer(roots.met, roots.missed | along_axis, t, off)


@implement(passes, Cylinders)
def _passes(prims: Any, pre: Any, d: Any) -> bool:
    e = by_rows(pre[0], d)
    return approach(pre[1], (e[0], e[1], 0.0), pre[4] * size(d)).missed


@inlined
def between_ends(hit: tuple[float, float], axis: tuple[float, float, float, float]) -> tuple[float, float]:
    """The hit if z = f + t e is sure to be in [0, 1], MISS if sure not to be; axis: f, its error, e, its error."""
    there = hit[0] < math.inf
    t, off = hit[0] if there else 0.0, hit[1]
    f, f_off, e, e_off = axis
    z = f + t * e
    # t e, its rounding and that of the sum are within 3 u of what SEEN_ERROR is taken of
    z_off = 2.0 * (f_off + abs(t) * e_off + abs(e) * off) + TINY
    inside = there & (z > z_off) & (z < 1.0 - z_off)
    return answer(inside, (z < -z_off) | (z > 1.0 + z_off) | (not there), t, off)


@implement(same, Cylinders)
def _same(prims: Any, k: int, j: int) -> bool:
    return False


@implement(root, Cylinders)
def _root(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    f, e, h, unit = placed(row(prims.center, k), prims.to_world[k], o, d)
    return exact_tube(f, e, h, unit, t_min, t_max)


@implement(normal, Cylinders)
def _normal(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    e = turned(prims.to_object, k, d)
    x, y, _ = way_out((f[0], f[1], 0.0), (e[0], e[1], 0.0), t, 1.0)
    return unit(turned_back(prims.to_object, k, (x, y, 0.0)))


@implement(facing, Cylinders)
def _facing(prims: Any, k: int, reach: float) -> Any:
    center, m = row(prims.center, k), rows_of(prims.to_object, k)
    return is_plain_through(m, center, reach), center, m


@implement(plain_normal, Cylinders)
def _plain_normal(prims: Any, face: Any, o: Any, d: Any, t: float) -> Any:
    _, center, m = face
    f, e = by_rows(m, sub(o, center)), by_rows(m, d)
    x, y, _ = plain_way_out((f[0], f[1], 0.0), (e[0], e[1], 0.0), t, 1.0)
    return unit(by_columns(m, (x, y, 0.0)))


@implement(surface, Cylinders)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    """u is the angle as a fraction of a turn, v the height along the axis from 0 to 1."""
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    e = turned(prims.to_object, k, d)
    x, y, _ = way_out((f[0], f[1], 0.0), (e[0], e[1], 0.0), t, 1.0)
    z = f[2] + t * e[2]
    n = unit(turned_back(prims.to_object, k, (x, y, 0.0)))
    p = add(row(prims.center, k), turned(prims.to_world, k, (x, y, z)))
    return p, n, n, angle_fraction(y, x) if wants_uv else 0.0, z


@implement(hull_size, Cylinders)
def _hull_size(prims: Any) -> int:
    return 8


@implement(hull_point, Cylinders)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    corner = (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.25 * (j & 4))
    return add(row(prims.center, k), turned(prims.to_world, k, corner))
