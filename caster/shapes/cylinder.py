"""Cylinder walls without caps."""

import math
from inspect import unwrap
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.description.fields import Flag, Positive, Shape, Vec3
from caster.description.transform import product, transform_points
from caster.geometry.triangle_mesh import normalize_rows
from caster.geometry.world_space import AffineImages, Rounding, affine_arrays, largest_curvature
from caster.jit.decorators import implement, inlined
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import exact_unit_cylinder, ray_in_object_space
from caster.kernels.math.angles import turn_fraction
from caster.kernels.math.quadric_roots import (
    QuadricSetup,
    closest_approach,
    fast_outward_normal,
    first_hit,
    outward_normal,
    quadric_roots,
    quadric_setup,
)
from caster.kernels.math.vec import (
    TINY,
    TO_OBJECT_SPACE_ERROR,
    add,
    all_products_zero,
    certain_in_range,
    fast_normalize,
    filter_result,
    l1_norm,
    mat_vec,
    matrix_rows,
    normalize,
    row,
    row_max_norms,
    rows_times_vec,
    sub,
    to_object_space,
    transposed_mat_vec,
    transposed_rows_times_vec,
)
from caster.kernels.protocol import (
    exact_intersect,
    fast_surface,
    fast_uv,
    hull_point,
    intersect,
    load,
    prepare,
    surely_misses,
    surface,
    surface_setup,
)
from caster.kernels.raster.tile import (
    LANE_CENTER,
    LANE_TO_OBJECT,
    LANE_TO_WORLD,
    get_lane,
    get_matrix,
    put_affine_lanes,
)

__all__ = ["Cylinder", "Cylinders"]


class Cylinders(AffineImages):
    """Images of the unit cylinder x^2 + y^2 = 1, 0 <= z <= 1."""

    curvature = property(largest_curvature)


class Cylinder(Shape):
    """The wall of a cylinder around the axis p0-p1, without caps, visible from inside and outside.

    The normal points away from the axis, or with `flip_normals` towards it.
    """

    type: Literal["cylinder"] = "cylinder"
    p0: Vec3 = (0.0, 0.0, 0.0)  # scene units
    p1: Vec3 = (0.0, 0.0, 1.0)  # scene units
    radius: Positive = 1.0  # scene units
    flip_normals: Flag = False

    @model_validator(mode="after")
    def _has_an_axis(self) -> "Cylinder":
        if self.p0 == self.p1:
            raise ValueError(f"p0 and p1 must be different points, got {list(self.p0)} for both")
        return self

    def pack(self, rounded: Rounding) -> Cylinders:
        center = transform_points(self.matrix, np.array([self.p0]))[0]
        axis = np.subtract(self.p1, self.p0)
        along = normalize_rows(axis[None])[0]
        if along[0] == along[1] == 0.0 and along[2] > 0.0:
            first = np.array([1.0, 0.0, 0.0])
        else:
            first = normalize_rows(np.cross(np.eye(3)[np.argmin(np.abs(along))], along)[None])[0]
        # two radii perpendicular to the axis, and the axis; right-handed
        own = np.column_stack([self.radius * first, self.radius * np.cross(along, first), axis])
        return Cylinders(*affine_arrays(center, product(self.matrix[:3, :3], own), rounded))


@implement(load, Cylinders)
def _load(prims: Any, k: int) -> Any:
    m = matrix_rows(prims.to_object, k)
    x, y, z = row_max_norms(m)
    return row(prims.center, k), m, TO_OBJECT_SPACE_ERROR * (x + y), TO_OBJECT_SPACE_ERROR * z


class PreparedCylinder(NamedTuple):
    """A cylinder as rays from one origin meet it, in object space."""

    to_object: Any  # rows of the matrix
    wall: QuadricSetup
    height: float  # of the origin along the axis
    height_error: float
    across_error: float  # of a direction, per l1 norm, across the axis
    along_error: float  # and along it


@implement(prepare, Cylinders)
def _prepare(prims: Any, prim: Any, o: Any) -> PreparedCylinder:
    center, m, across_off, along_off = prim
    f, error = to_object_space(m, sub(o, center))
    return PreparedCylinder(
        m, quadric_setup((f[0], f[1], 0.0), 1.0, error[0] + error[1]), f[2], error[2], across_off, along_off
    )


@implement(intersect, Cylinders)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    m = pre.to_object
    e, d1 = rows_times_vec(m, d), l1_norm(d)
    roots = quadric_roots(pre.wall, (e[0], e[1], 0.0), pre.across_error * d1)
    axis = pre.height, pre.height_error, e[2], pre.along_error * d1
    near = clip_to_height(certain_in_range(roots.near, roots.near_error, t_min, t_max), axis)
    far = clip_to_height(certain_in_range(roots.far, roots.far_error, t_min, t_max), axis)
    t, error = first_hit(near, far)
    parallel = all_products_zero(m[0], d) & all_products_zero(m[1], d)  # to the axis, exactly so
    return filter_result(roots.met, roots.missed | parallel, t, error)


@implement(surely_misses, Cylinders)
def _surely_misses(prims: Any, pre: Any, d: Any) -> bool:
    e = rows_times_vec(pre.to_object, d)
    return closest_approach(pre.wall, (e[0], e[1], 0.0), pre.across_error * l1_norm(d)).missed


@inlined
def clip_to_height(hit: tuple[float, float], axis: tuple[float, float, float, float]) -> tuple[float, float]:
    """The hit if z = f + t e certainly is in [0, 1], MISS if it certainly is not; axis: f, its error, e, its error."""
    there = hit[0] < math.inf
    t, error = hit[0] if there else 0.0, hit[1]
    f, f_error, e, e_off = axis
    z = f + t * e
    # t e, its rounding and that of the sum are within 3 u of what TO_OBJECT_SPACE_ERROR is taken of
    z_off = 2.0 * (f_error + abs(t) * e_off + (abs(e) + TINY) * error) + TINY  # error may be inf, and e zero
    inside = there & (z > z_off) & (z < 1.0 - z_off)
    return filter_result(inside, (z < -z_off) | (z > 1.0 + z_off) | (not there), t, error)


@implement(exact_intersect, Cylinders)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_unit_cylinder(*ray_in_object_space(row(prims.center, k), prims.to_world[k], o, d), t_min, t_max)


@implement(surface, Cylinders)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    """u is the angle as a fraction of a turn, v the height along the axis from 0 to 1."""
    f = mat_vec(prims.to_object, k, sub(o, row(prims.center, k)))
    e = mat_vec(prims.to_object, k, d)
    across = e[0], e[1], 0.0
    x, y, _ = outward_normal((f[0], f[1], 0.0), across, normalize(across), t, 1.0)
    z = f[2] + t * e[2]
    n = normalize(transposed_mat_vec(prims.to_object, k, (x, y, 0.0)))
    p = add(row(prims.center, k), mat_vec(prims.to_world, k, (x, y, z)))
    return p, n, n, turn_fraction(y, x) if wants_uv else 0.0, z


implement(surface_setup, Cylinders)(unwrap(put_affine_lanes))


@implement(fast_surface, Cylinders)
def _fast_surface(prims: Any, scratch: Any, x: Any, o: Any, d: Any, t: float) -> Any:
    center, m = get_lane(scratch, LANE_CENTER + x), get_matrix(scratch, LANE_TO_OBJECT + x)
    f, e = rows_times_vec(m, sub(o, center)), rows_times_vec(m, d)
    across = e[0], e[1], 0.0
    known, q = fast_outward_normal((f[0], f[1], 0.0), across, fast_normalize(across), t, 1.0)
    long, n = fast_normalize(transposed_rows_times_vec(m, (q[0], q[1], 0.0)))
    q = q[0], q[1], f[2] + t * e[2]
    p = add(center, rows_times_vec(get_matrix(scratch, LANE_TO_WORLD + x), q))
    return known & long, known & long, p, n, n, q


@implement(fast_uv, Cylinders)
def _fast_uv(prims: Any, scratch: Any, x: Any, q: Any) -> Any:
    return turn_fraction(q[1], q[0]), q[2]


@implement(hull_point, Cylinders)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    corner = (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.25 * (j & 4))
    return add(row(prims.center, k), mat_vec(prims.to_world, k, corner))
