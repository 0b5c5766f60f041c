"""Disks; with a non-uniform to_world, ellipses."""

import math
from typing import Any, Literal

from caster.description.fields import Shape
from caster.geometry.world_space import AffineImages, Rounding, affine_arrays
from caster.jit.decorators import implement
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import exact_disk
from caster.kernels.math.angles import turn_fraction
from caster.kernels.math.vec import (
    TINY,
    TO_OBJECT_SPACE_ERROR,
    U,
    add,
    all_products_zero,
    certain_in_range,
    filter_result,
    hypotenuse,
    l1_norm,
    mat_vec,
    matrix_rows,
    normalize,
    row,
    row_max_norms,
    rows_times_vec,
    scaled,
    sub,
    to_object_space,
    transposed_mat_vec,
)
from caster.kernels.protocol import (
    exact_intersect,
    fast_surface,
    fast_uv,
    hull_point,
    hull_size,
    intersect,
    load,
    prepare,
    surface_setup,
)
from caster.kernels.raster.tile import (
    LANE_CENTER,
    LANE_MORE,
    LANE_TO_OBJECT,
    LANE_TO_WORLD,
    NORMALS,
    get_lane,
    get_matrix,
    put_affine_lanes,
    put_lane,
)

__all__ = ["Disk", "Disks"]


class Disks(AffineImages):
    """Images of the unit disk z = 0."""


class Disk(Shape):
    """The unit disk in the plane z = 0 with normal +z, visible from both sides."""

    type: Literal["disk"] = "disk"

    def pack(self, rounded: Rounding) -> Disks:
        return Disks(*affine_arrays(self.matrix[:3, 3], self.matrix[:3, :3], rounded))


@implement(load, Disks)
def _load(prims: Any, k: int) -> Any:
    m = matrix_rows(prims.to_object, k)
    return row(prims.center, k), m, scaled(TO_OBJECT_SPACE_ERROR, row_max_norms(m))


@implement(prepare, Disks)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    """(to_object, o in object space, its error, error of d there per l1 norm)."""
    center, m, e_off = prim
    f, error = to_object_space(m, sub(o, center))
    return m, f, error, e_off


@implement(intersect, Disks)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    """Intersection with z = 0; inside or outside is certain if x^2 + y^2 differs from 1 by more than its error."""
    m, f, f_error, e_off = pre
    e, d1 = rows_times_vec(m, d), l1_norm(d)
    slope_off = e_off[2] * d1 + TINY
    steep = (abs(e[2]) > 2.0 * slope_off) & (abs(e[2]) < math.inf)
    over = 1.0 / (e[2] if steep else 1.0)
    t = -f[2] * over
    error = 2.0 * (f_error[2] + TINY + abs(t) * slope_off) * abs(over) + 3.0 * U * abs(t)
    x, y = f[0] + t * e[0], f[1] + t * e[1]
    # t e, its rounding and that of the sum are within 3 u of what TO_OBJECT_SPACE_ERROR is taken of
    x_off = 2.0 * (f_error[0] + abs(t) * e_off[0] * d1 + abs(e[0]) * error)
    y_off = 2.0 * (f_error[1] + abs(t) * e_off[1] * d1 + abs(e[1]) * error)
    beyond = x * x + y * y - 1.0
    beyond_off = (2.0 * abs(x) + x_off) * x_off + (2.0 * abs(y) + y_off) * y_off + 4.0 * U * (x * x + y * y + 1.0)
    t, error = certain_in_range(t, error, t_min, t_max)
    edge_on = all_products_zero(m[2], d)
    return filter_result(steep & (beyond < -beyond_off), edge_on | (steep & (beyond > beyond_off)), t, error)


@implement(exact_intersect, Disks)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_disk(row(prims.center, k), prims.to_world[k], o, d, t_min, t_max)


@implement(surface_setup, Disks)
def _surface_setup(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    n = normalize(transposed_mat_vec(prims.to_object, k, (0.0, 0.0, 1.0)))
    for x in range(start, stop):
        put_lane(scratch, LANE_MORE + x, n)
    if wants != NORMALS:
        put_affine_lanes(prims, k, start, stop, scratch, wants)


@implement(fast_surface, Disks)
def _fast_surface(prims: Any, scratch: Any, x: Any, o: Any, d: Any, t: float) -> Any:
    center, m = get_lane(scratch, LANE_CENTER + x), get_matrix(scratch, LANE_TO_OBJECT + x)
    f, e = rows_times_vec(m, sub(o, center)), rows_times_vec(m, d)
    q = f[0] + t * e[0], f[1] + t * e[1], 0.0
    p, n = add(center, rows_times_vec(get_matrix(scratch, LANE_TO_WORLD + x), q)), get_lane(scratch, LANE_MORE + x)
    return True, True, p, n, n, q


@implement(fast_uv, Disks)
def _fast_uv(prims: Any, scratch: Any, x: Any, q: Any) -> Any:
    """u is the distance from the centre, v the angle as a fraction of a turn."""
    return hypotenuse(q[0], q[1]), turn_fraction(q[1], q[0])


@implement(hull_size, Disks)
def _hull_size(prims: Any) -> int:
    return 4


@implement(hull_point, Disks)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return add(row(prims.center, k), mat_vec(prims.to_world, k, (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.0)))
