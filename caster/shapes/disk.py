"""A filled circle; under a to_world that stretches it, a filled ellipse."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from caster.fields import Shape
from caster.kernels.exact_planar import exact_disk
from caster.kernels.exact_root import Root
from caster.kernels.jit import implement
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
from caster.kernels.vec import (
    SEEN_ERROR,
    TINY,
    U,
    add,
    angle_fraction,
    answer,
    by_rows,
    no_terms,
    row,
    row_sizes,
    rows_of,
    scaled,
    seen,
    size,
    sub,
    sure_within,
    turned,
    turned_back,
    unit,
)
from caster.placing import Rounding, affine_arrays


class Disks(NamedTuple):
    """Images of the unit disk z = 0 under p -> center + to_world p."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


class Disk(Shape):
    """The unit disk in the plane z = 0, facing +z, visible from both sides; placed by to_world."""

    type: Literal["disk"] = "disk"

    def pack(self, rounded: Rounding) -> Disks:
        return Disks(*affine_arrays(self.matrix[:3, 3], self.matrix[:3, :3], rounded))


@implement(numbers, Disks)
def _numbers(prims: Any, k: int) -> Any:
    m = rows_of(prims.to_object, k)
    return row(prims.center, k), m, scaled(SEEN_ERROR, row_sizes(m))


@implement(prepare, Disks)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    """(to_object, o in object space, how far off that is, by how much d is off there over its size)."""
    center, m, e_off = prim
    f, off = seen(m, sub(o, center))
    return m, f, off, e_off


@implement(intersect, Disks)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    """Where z = 0; sure of being within the rim where x^2 + y^2 differs from 1 by more than its error."""
    m, f, f_off, e_off = pre
    e, d1 = by_rows(m, d), size(d)
    slope_off = e_off[2] * d1 + TINY
    steep = (abs(e[2]) > 2.0 * slope_off) & (abs(e[2]) < math.inf)
    over = 1.0 / (e[2] if steep else 1.0)
    t = -f[2] * over
    off = 2.0 * (f_off[2] + TINY + abs(t) * slope_off) * abs(over) + 3.0 * U * abs(t)
    x, y = f[0] + t * e[0], f[1] + t * e[1]
    # t e, its rounding and that of the sum are within 3 u of what SEEN_ERROR is taken of
    x_off = 2.0 * (f_off[0] + abs(t) * e_off[0] * d1 + abs(e[0]) * off)
    y_off = 2.0 * (f_off[1] + abs(t) * e_off[1] * d1 + abs(e[1]) * off)
    beyond = x * x + y * y - 1.0
    beyond_off = (
        (2.0 * abs(x) + x_off) * x_off + (2.0 * abs(y) + y_off) * y_off + 4.0 * U * (x * x + y * y + 1.0)
    )
    t, off = sure_within(t, off, t_min, t_max)
    edge_on = no_terms(m[2], d)
    return answer(steep & (beyond < -beyond_off), edge_on | (steep & (beyond > beyond_off)), t, off)


@implement(passes, Disks)
def _passes(prims: Any, pre: Any, d: Any) -> bool:
    return False  # to know it takes nearly all of `intersect`


@implement(same, Disks)
def _same(prims: Any, k: int, j: int) -> bool:
    return False


@implement(root, Disks)
def _root(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_disk(row(prims.center, k), prims.to_world[k], o, d, t_min, t_max)


@implement(normal, Disks)
def _normal(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    return unit(turned_back(prims.to_object, k, (0.0, 0.0, 1.0)))


@implement(facing, Disks)
def _facing(prims: Any, k: int, reach: float) -> Any:
    return True, unit(turned_back(prims.to_object, k, (0.0, 0.0, 1.0)))


@implement(plain_normal, Disks)
def _plain_normal(prims: Any, face: Any, o: Any, d: Any, t: float) -> Any:
    return face[1]


@implement(surface, Disks)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    """u is the distance from the centre, v the angle as a fraction of a turn."""
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    e = turned(prims.to_object, k, d)
    x, y = f[0] + t * e[0], f[1] + t * e[1]
    n = normal(prims, k, o, d, t)
    p = add(row(prims.center, k), turned(prims.to_world, k, (x, y, 0.0)))
    return p, n, n, math.sqrt(x * x + y * y), angle_fraction(y, x) if wants_uv else 0.0


@implement(hull_size, Disks)
def _hull_size(prims: Any) -> int:
    return 4


@implement(hull_point, Disks)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return add(row(prims.center, k), turned(prims.to_world, k, (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.0)))
