"""Infinite planes."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from caster.description.fields import Number, Shape, UnitVec3, Vec3, exactly_one
from caster.description.transform import inverse, transform_points, transform_vectors
from caster.geometry.triangle_mesh import normalize_rows
from caster.geometry.world_space import Rounding
from caster.jit.decorators import implement
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import exact_plane
from caster.kernels.math.vec import (
    TINY,
    U,
    all_products_zero,
    certain_in_range,
    cross,
    dot,
    filter_result,
    l1_norm,
    normalize,
    point_at,
    row,
    sub,
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
from caster.kernels.raster.tile import LANE_SETUP, SURFACE_LANES, SURFACES_WITH_UV, get_lane, lane, put_lane

__all__ = ["Plane", "Planes"]


class Planes(NamedTuple):
    """All p with normal . (p - point) = 0."""

    normal: np.ndarray  # (n, 3) float64, of about unit length
    point: np.ndarray  # (n, 3) float64


class Plane(Shape):
    """The plane through `point` with `normal`, or all p with normal . p = `offset` for the unit normal."""

    type: Literal["plane"] = "plane"
    MINIMAL: ClassVar[Mapping[str, Any]] = {"offset": 0.0}
    normal: UnitVec3 = (0.0, 0.0, 1.0)
    offset: Number | None = None  # scene units
    point: Vec3 | None = None  # scene units

    _has_one_place = exactly_one("offset", "point")

    def without_uv(self) -> str:
        return "Mitsuba has no plane to compare it with"

    def pack(self, rounded: Rounding) -> Planes:
        n = np.array([self.normal])
        point = self.offset * n if self.point is None else np.array([self.point])
        world_normal = transform_vectors(inverse(self.matrix[:3, :3]).T, n)
        if not world_normal.any():
            raise np.linalg.LinAlgError("too large to be inverted in float64")
        return Planes(rounded(normalize_rows(world_normal)), rounded(transform_points(self.matrix, point)))


# The error of a dot product is 3 u of its terms' magnitudes, 4 u with the rounding of the difference in it.
PRODUCT_ERROR = 5.0 * U


@implement(load, Planes)
def _load(prims: Any, k: int) -> Any:
    return row(prims.normal, k), row(prims.point, k)


@implement(prepare, Planes)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    n, point = prim
    away = sub(point, o)
    largest = max(abs(n[0]), abs(n[1]), abs(n[2]))
    return n, dot(n, away), PRODUCT_ERROR * largest * l1_norm(away) + TINY, PRODUCT_ERROR * largest


@implement(intersect, Planes)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    n, height, height_off, tilt_off = pre
    slope, slope_off = dot(n, d), tilt_off * l1_norm(d) + TINY
    steep = (abs(slope) > 2.0 * slope_off) & (abs(slope) < math.inf)
    slope = slope if steep else 1.0
    t = height / slope
    error = 2.0 * (height_off + abs(t) * slope_off) / abs(slope) + 2.0 * U * abs(t)
    t, error = certain_in_range(t, error, t_min, t_max)
    return filter_result(steep, all_products_zero(n, d), t, error)  # exactly edge-on


@implement(exact_intersect, Planes)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_plane(row(prims.normal, k), row(prims.point, k), o, d, t_min, t_max)


LANE_NORMAL, LANE_POINT, LANE_RIGHT, LANE_AHEAD = (LANE_SETUP + lane(SURFACE_LANES * field) for field in (0, 3, 6, 9))


@implement(surface_setup, Planes)
def _surface_setup(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    n = normalize(row(prims.normal, k))
    for x in range(start, stop):
        put_lane(scratch, LANE_NORMAL + x, n)
    if wants == SURFACES_WITH_UV:
        point, side = row(prims.point, k), (1.0, 0.0, 0.0) if abs(n[0]) < 0.5 else (0.0, 1.0, 0.0)
        right = normalize(cross(side, n))
        ahead = cross(n, right)
        for x in range(start, stop):
            put_lane(scratch, LANE_POINT + x, point)
            put_lane(scratch, LANE_RIGHT + x, right)
            put_lane(scratch, LANE_AHEAD + x, ahead)


@implement(fast_surface, Planes)
def _fast_surface(prims: Any, scratch: Any, x: Any, o: Any, d: Any, t: float) -> Any:
    n, p = get_lane(scratch, LANE_NORMAL + x), point_at(o, t, d)
    return True, True, p, n, n, p


@implement(fast_uv, Planes)
def _fast_uv(prims: Any, scratch: Any, x: Any, p: Any) -> Any:
    """Distances from `point` along two axes of the plane, in scene units."""
    q = sub(p, get_lane(scratch, LANE_POINT + x))
    return dot(q, get_lane(scratch, LANE_RIGHT + x)), dot(q, get_lane(scratch, LANE_AHEAD + x))


@implement(hull_size, Planes)
def _hull_size(prims: Any) -> int:
    return 0


@implement(hull_point, Planes)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return row(prims.point, k)
