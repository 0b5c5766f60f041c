"""The kind `Triangles`: what triangle, mesh, rectangle, cube and every generated mesh are made of."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import implement, inlined, jit
from caster.jit.simd import LANES, gather_corners, prefetch
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import exact_triangle
from caster.kernels.math.vec import (
    TINY,
    U,
    abs_dot,
    add,
    certain_in_range,
    component_max,
    cross,
    cross_of_edges,
    dot,
    fast_normalize,
    filter_result,
    l1_norm,
    max_norm,
    normalize,
    permanent,
    row,
    scaled,
    scaled_near_one,
    select,
    sub,
)
from caster.kernels.protocol import (
    Vec3,
    exact_intersect,
    fast_surface,
    fast_uv,
    hull_point,
    hull_size,
    intersect,
    load,
    prefetch_numbers,
    prepare,
    same_geometry,
    setup_lanes,
    surely_misses,
    surface,
    surface_setup,
    t_lower_bound,
)
from caster.kernels.raster.tile import (
    LANE_NUMBER,
    LANE_SETUP,
    NEXT,
    NORMALS,
    SURFACE_LANES,
    SURFACES_WITH_UV,
    get_lane,
    lane,
    put_lane,
)


class Triangles(NamedTuple):
    """Indexed triangles in world space."""

    vertices: np.ndarray  # (v, 3) float64
    faces: np.ndarray  # (n, 3) int32
    normals: np.ndarray  # (v, 3) float64, used where smooth
    uv: np.ndarray  # (v, 2) float64, used where textured
    smooth: np.ndarray  # (n,) bool: shading normal from the vertex normals
    textured: np.ndarray  # (n,) bool: uv from the vertices, else the barycentrics b1, b2


# The edge function d . (b x c) of corners b, c relative to the origin, magnitudes at most m:
# a difference b is off by u of itself; a component of b x c by (2 u + u) 2 m^2 for its factors and products, and by
# u 2 m^2 for the subtraction, 8 u m^2 together; the dot product by |d|_1 times that, and 3 u |d|_1 2 m^2 for its own
# roundings: 14 u m^2 |d|_1. The rest of 16 is for terms in u^2 and for the rounding of the bound itself.
EDGE_ERROR = 16.0 * U

# Across: n = (b - a) x (c - a) is off by 4 u Q, Q the permanent of the two (4 = 2 for the edges' rounding, 1 for the
# products, 1 for the subtraction). With that, n . a is off by 8 u sum |a| Q and n . d by 7 u sum |d| Q, since Q >= |n|.
PLANE_ERROR, SLOPE_ERROR = 9.0 * U, 8.0 * U

# The error of an edge function up to which nothing here has overflowed, for corners no farther than
# world_space.LARGEST_COORDINATE: no number is more than 2^60 times as large.
MAX_EDGE_ERROR = 2.0**900


@inlined
def corners_of(rows: Any, faces: Any, k: int) -> tuple[Vec3, Vec3, Vec3]:
    """The rows of a triangle's three vertices."""
    return row(rows, faces[k, 0]), row(rows, faces[k, 1]), row(rows, faces[k, 2])


@implement(load, Triangles)
def _load(prims: Any, k: int) -> Any:
    """(corners, n, Q)."""
    p, q, r = corners_of(prims.vertices, prims.faces, k)
    e1, e2 = sub(q, p), sub(r, p)
    return p, q, r, cross(e1, e2), permanent(e1, e2)


@implement(prefetch_numbers, Triangles)
def _prefetch_numbers(prims: Any, k: int, referred: bool) -> None:
    if referred:
        for j in range(3):
            prefetch(prims.vertices, prims.faces[k, j])
    else:
        prefetch(prims.faces, k)


class PreparedTriangle(NamedTuple):
    """A triangle as rays from one origin meet it; a, b, c are its corners relative to the origin."""

    bc: Vec3  # b x c
    ca: Vec3  # c x a
    ab: Vec3  # a x b
    n: Vec3  # (b - a) x (c - a)
    height: float  # n . a
    edge_share: float  # error of the edge functions over |d|_1
    slope_share: Vec3  # error of n . d over |d|, component by component
    height_error: float  # of n . a


@implement(prepare, Triangles)
def _prepare(prims: Any, prim: Any, o: Vec3) -> PreparedTriangle:
    p, q, r, n, spread = prim
    a, b, c = sub(p, o), sub(q, o), sub(r, o)
    m = max(max_norm(a), max_norm(b), max_norm(c))
    height_error = PLANE_ERROR * (abs(a[0]) * spread[0] + (abs(a[1]) * spread[1] + abs(a[2]) * spread[2])) + TINY
    return PreparedTriangle(
        cross(b, c),
        cross(c, a),
        cross(a, b),
        n,
        dot(n, a),
        EDGE_ERROR * (m * m) + TINY,
        scaled(SLOPE_ERROR, spread),
        height_error,
    )


@implement(intersect, Triangles)
def _intersect(prims: Any, pre: Any, d: Vec3, t_min: float, t_max: float) -> tuple[float, float]:
    """Inside where all three edge functions have one sign; sure of it where they exceed their error."""
    height, height_error = pre.height, pre.height_error
    inside, outside, bounded = _sides(pre, d)
    slope, slope_error = dot(pre.n, d), abs_dot(pre.slope_share, d) + TINY
    steep = (abs(slope) > 2.0 * slope_error) & bounded
    over = 1.0 / (slope if steep else 1.0)
    t = height * over
    # (h + e) / (s + f) - h / s = (e - t f) / (s + f), and |s + f| > |s| / 2; 3 u |t| for 1 / s and the product
    error = 2.0 * (height_error + abs(t) * slope_error) * abs(over) + 3.0 * U * abs(t)
    t, error = certain_in_range(t, error, t_min, t_max)
    return filter_result(inside & steep, outside, t, error)


@implement(surely_misses, Triangles)
def _surely_misses(prims: Any, pre: Any, d: Vec3) -> bool:
    return _sides(pre, d)[1]


@inlined
def _sides(pre: Any, d: Vec3) -> tuple[bool, bool, bool]:
    """Whether all edge functions are sure to have one sign, some sure to have another, and none to have overflowed."""
    u, v, w = dot(d, pre.bc), dot(d, pre.ca), dot(d, pre.ab)
    error = pre.edge_share * l1_norm(d) + TINY
    least, most, bounded = min(min(u, v), w), max(max(u, v), w), error < MAX_EDGE_ERROR
    return (least > error) | (most < -error), (most > error) & (least < -error) & bounded, bounded


@implement(t_lower_bound, Triangles)
def _t_lower_bound(prims: Any, pre: Any, low: Vec3, high: Vec3) -> float:
    """Where t > 0, the edge functions have the sign of n . a, as n . d has.

    The bounds of `_intersect` hold for what is added up here, since it is the same for one of the box's corners.
    """
    height, height_error = pre.height, pre.height_error
    most = component_max(scaled(-1.0, low), high)  # no component of d is larger
    side, error = math.copysign(1.0, height), pre.edge_share * l1_norm(most) + TINY
    if not (height_error < abs(height) and error < MAX_EDGE_ERROR):
        return 0.0
    for edge in (pre.bc, pre.ca, pre.ab):
        if max_dot_over_box(side, edge, low, high) < -error:
            return math.inf
    steepest = max_dot_over_box(side, pre.n, low, high) + dot(pre.slope_share, most) + TINY
    if not steepest > 0.0:
        return math.inf
    return max((abs(height) - height_error) / steepest * T_LOWER_BOUND_ROUNDING, 0.0)


# For the rounding of a difference, a sum and a quotient.
T_LOWER_BOUND_ROUNDING = 1.0 - 2.0**-50


@inlined
def max_dot_over_box(side: float, a: Vec3, low: Vec3, high: Vec3) -> float:
    """The largest of side * a . d for d from low to high."""
    x = max(side * a[0] * low[0], side * a[0] * high[0])
    y = max(side * a[1] * low[1], side * a[1] * high[1])
    return x + y + max(side * a[2] * low[2], side * a[2] * high[2])


# A sheared coordinate is off by 3 u (|p d| + |p d|) <= 6 u m |d|, m the largest coordinate of a corner; a product of
# two that are at most s, off by r each, by 2 s r + r^2 and its rounding. Six products and their sum are off by
# 12 s r + 6 r^2 + 15 u s^2.
SHEAR_ERROR = 6.0 * U


@jit
def barycentrics_edge_on(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Vec3:
    """Barycentrics of the point p, projected along an axis: for rays that run along the triangle."""
    e1, e2, q = sub(b, a), sub(c, a), sub(p, a)
    axis = dominant_axis(cross(scaled_near_one(e1), scaled_near_one(e2)))
    e1, e2, q = dominant_last(axis, e1), dominant_last(axis, e2), dominant_last(axis, q)
    area = e1[0] * e2[1] - e1[1] * e2[0]
    if area == 0.0:
        return 1.0, 0.0, 0.0
    b1 = min(max((q[0] * e2[1] - q[1] * e2[0]) / area, 0.0), 1.0)
    b2 = min(max((e1[0] * q[1] - e1[1] * q[0]) / area, 0.0), 1.0)
    together = max(b1 + b2, 1.0)
    b1, b2 = b1 / together, b2 / together
    return max(1.0 - (b1 + b2), 0.0), b1, b2


@implement(same_geometry, Triangles)
def _same_geometry(prims: Any, k: int, j: int) -> bool:
    return corners_of(prims.vertices, prims.faces, k) == corners_of(prims.vertices, prims.faces, j)


@implement(exact_intersect, Triangles)
def _exact_intersect(prims: Any, k: int, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    return exact_triangle(corners_of(prims.vertices, prims.faces, k), o, d, t_min, t_max)


# Where fewer than half of its bits are known, a normal is computed with twice as many.
MIN_SIN_SQUARED = 2.0**-52  # |n|^2 over |permanent|^2, about the squared sine between the edges


@inlined
def triangle_normal(a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    """The unit normal of a triangle, however small, large or thin it is."""
    known, n = fast_triangle_normal(a, b, c)
    return n if known else triangle_normal_slow(a, b, c)


@inlined
def fast_triangle_normal(a: Vec3, b: Vec3, c: Vec3) -> tuple[bool, Vec3]:
    """(whether this is the unit normal, it), without a branch."""
    e1, e2 = sub(b, a), sub(c, a)
    n, spread = cross(e1, e2), permanent(e1, e2)
    known, unit = fast_normalize(n)
    return known & (dot(n, n) > MIN_SIN_SQUARED * dot(spread, spread)), unit


@inlined
def interpolated(weights: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    """The point or normal between those of three vertices."""
    return add(scaled(weights[0], a), add(scaled(weights[1], b), scaled(weights[2], c)))


@jit
def triangle_normal_slow(a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    """The unit normal where `fast_triangle_normal` does not know it: from edges scaled to about 1, or twice the bits.

    Collinear corners have a unit vector perpendicular to their line, coincident ones 0.
    """
    e1, e2 = scaled_near_one(sub(b, a)), scaled_near_one(sub(c, a))
    n, spread = cross(e1, e2), permanent(e1, e2)
    if dot(n, n) > MIN_SIN_SQUARED * dot(spread, spread):
        return normalize(n)
    n = cross_of_edges(a, b, c)  # with twice the bits
    if l1_norm(n) > 0.0:
        return normalize(n)
    along = scaled_near_one(sub(b, a) if l1_norm(sub(b, a)) >= l1_norm(sub(c, a)) else sub(c, a))
    x, y, z = abs(along[0]), abs(along[1]), abs(along[2])  # the cross product with the axis of the least of them
    if x <= y and x <= z:
        return normalize((0.0, along[2], -along[1]))
    return normalize((-along[2], 0.0, along[0]) if y <= z else (along[1], -along[0], 0.0))


@implement(surface, Triangles)
def _surface(prims: Any, k: int, o: Vec3, d: Vec3, t: float, wants_uv: bool) -> Any:
    a, b, c = corners_of(prims.vertices, prims.faces, k)
    corners = sub(a, o), sub(b, o), sub(c, o)
    known, weights = fast_barycentrics(*corners, d)
    weights = weights if known else barycentrics_edge_on(*corners, scaled(t, d))
    n = sh_n = triangle_normal(a, b, c)
    if prims.smooth[k]:
        sh_n = normalize(interpolated(weights, *corners_of(prims.normals, prims.faces, k)))
    s, r = weights[1], weights[2]  # where the vertices have no uv
    if wants_uv and prims.textured[k]:
        s, r = interpolated_uv(weights, *uv_of(prims, k))
    return interpolated(weights, a, b, c), n, sh_n, s, r


UV = tuple[float, float]


@inlined
def uv_of(prims: Any, k: int) -> tuple[UV, UV, UV]:
    """uv of a triangle's three vertices."""
    i, j, h = prims.faces[k, 0], prims.faces[k, 1], prims.faces[k, 2]
    uv = prims.uv
    return (uv[i, 0], uv[i, 1]), (uv[j, 0], uv[j, 1]), (uv[h, 0], uv[h, 1])


@inlined
def interpolated_uv(weights: Vec3, a: UV, b: UV, c: UV) -> UV:
    """Between those of three vertices."""
    return (
        weights[0] * a[0] + (weights[1] * b[0] + weights[2] * c[0]),
        weights[0] * a[1] + (weights[1] * b[1] + weights[2] * c[1]),
    )


# Fields of a lane: corners, vertex normals, whether they are used; uv of the vertices, whether they are used.
LANE_A, LANE_B, LANE_C, LANE_NA, LANE_NB, LANE_NC, LANE_SMOOTH, LANE_US, LANE_VS, LANE_TEXTURED = (
    LANE_SETUP + lane(SURFACE_LANES * field) for field in (0, 3, 6, 9, 12, 15, 18, 19, 22, 25)
)


@implement(surface_setup, Triangles)
def _surface_setup(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    a, b, c = corners_of(prims.vertices, prims.faces, k)
    smooth = prims.smooth[k]
    for x in range(start, stop):
        put_lane(scratch, LANE_A + x, a)
        put_lane(scratch, LANE_B + x, b)
        put_lane(scratch, LANE_C + x, c)
        scratch[LANE_SMOOTH + x] = 1.0 if smooth else 0.0
    if smooth and wants != NORMALS:
        n0, n1, n2 = corners_of(prims.normals, prims.faces, k)
        for x in range(start, stop):
            put_lane(scratch, LANE_NA + x, n0)
            put_lane(scratch, LANE_NB + x, n1)
            put_lane(scratch, LANE_NC + x, n2)
    if wants == SURFACES_WITH_UV:
        _setup_uv(prims, k, start, stop, scratch)


@inlined
def _setup_uv(prims: Any, k: int, start: Any, stop: Any, scratch: Any) -> None:
    textured, (a, b, c) = prims.textured[k], uv_of(prims, k)
    for x in range(start, stop):
        put_lane(scratch, LANE_US + x, (a[0], b[0], c[0]))
        put_lane(scratch, LANE_VS + x, (a[1], b[1], c[1]))
        scratch[LANE_TEXTURED + x] = 1.0 if textured else 0.0


@implement(setup_lanes, Triangles)
def _setup_lanes(prims: Any, scratch: Any, wants: int) -> None:
    """Corners and vertex normals, whether these are used or not, several lanes at a time; uv one by one."""
    for x in range(lane(0), lane(SURFACE_LANES), lane(LANES)):
        gather_corners(prims.vertices, prims.faces, scratch, LANE_NUMBER + x, LANE_A + x, NEXT)
    if wants != NORMALS:
        for x in range(lane(0), lane(SURFACE_LANES), lane(LANES)):
            gather_corners(prims.normals, prims.faces, scratch, LANE_NUMBER + x, LANE_NA + x, NEXT)
        for x in range(lane(SURFACE_LANES)):
            scratch[LANE_SMOOTH + x] = 1.0 if prims.smooth[int(scratch[LANE_NUMBER + x])] else 0.0
    if wants == SURFACES_WITH_UV:
        for x in range(lane(SURFACE_LANES)):
            k = int(scratch[LANE_NUMBER + x])
            _setup_uv(prims, k, x, x + lane(1), scratch)


@inlined
def dominant_axis(d: Vec3) -> tuple[bool, bool]:
    """(whether the component of largest magnitude, the lowest on a tie, is 0; whether it is 1 if not)."""
    x, y, z = abs(d[0]), abs(d[1]), abs(d[2])
    return (x >= y) & (x >= z), y >= z


@inlined
def dominant_last(axis: tuple[bool, bool], v: Vec3) -> Vec3:
    """v turned so that this axis is last."""
    return select(axis[0], (v[1], v[2], v[0]), select(axis[1], (v[2], v[0], v[1]), v))


@inlined
def sheared_last(p: Vec3, d: Vec3) -> tuple[float, float]:
    """p sheared along d onto the plane across the last axis, times d[2], which is the dominant component of d."""
    return p[0] * d[2] - d[0] * p[2], p[1] * d[2] - d[1] * p[2]


@implement(fast_surface, Triangles)
def _fast_surface(prims: Any, scratch: Any, x: Any, o: Vec3, d: Vec3, t: float) -> Any:
    a, b, c = get_lane(scratch, LANE_A + x), get_lane(scratch, LANE_B + x), get_lane(scratch, LANE_C + x)
    known, weights = fast_barycentrics(sub(a, o), sub(b, o), sub(c, o), d)
    p = interpolated(weights, a, b, c)
    wide, n = fast_triangle_normal(a, b, c)
    n0, n1, n2 = get_lane(scratch, LANE_NA + x), get_lane(scratch, LANE_NB + x), get_lane(scratch, LANE_NC + x)
    long, between = fast_normalize(interpolated(weights, n0, n1, n2))
    smooth = scratch[LANE_SMOOTH + x] != 0.0
    return wide, known & wide & (long | (not smooth)), p, n, select(smooth, between, n), weights


@implement(fast_uv, Triangles)
def _fast_uv(prims: Any, scratch: Any, x: Any, weights: Vec3) -> UV:
    u, v = get_lane(scratch, LANE_US + x), get_lane(scratch, LANE_VS + x)
    textured = scratch[LANE_TEXTURED + x] != 0.0
    s, r = interpolated_uv(weights, (u[0], v[0]), (u[1], v[1]), (u[2], v[2]))
    return s if textured else weights[1], r if textured else weights[2]


@inlined
def fast_barycentrics(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> tuple[bool, Vec3]:
    """(known, barycentrics) of the point t d, where a ray from 0 meets the triangle, without a branch.

    From the corners sheared along d, so near to 0 that little cancels (Woop, Benthin, Wald 2013); their division by
    the dominant component of d is left out, since it scales all three alike. What belongs to the second and third
    corner is added up first, here and in `surface`: a mirrored shape swaps the two, and so no bit changes.
    """
    axis = dominant_axis(d)
    along = dominant_last(axis, d)
    p, q = sheared_last(dominant_last(axis, a), along), sheared_last(dominant_last(axis, b), along)
    r = sheared_last(dominant_last(axis, c), along)
    u = r[0] * q[1] - r[1] * q[0]
    v = p[0] * r[1] - p[1] * r[0]
    w = q[0] * p[1] - q[1] * p[0]
    area = u + (v + w)
    widest = max(max(max(abs(p[0]), abs(p[1])), max(abs(q[0]), abs(q[1]))), max(abs(r[0]), abs(r[1])))
    error = SHEAR_ERROR * max(max(max_norm(a), max_norm(b)), max_norm(c)) * abs(along[2])
    known = abs(area) > 2.0 * (12.0 * widest * error + 6.0 * error * error + 15.0 * U * widest * widest)
    divisor = area if known else 1.0
    return known, (u / divisor, v / divisor, w / divisor)


@implement(hull_size, Triangles)
def _hull_size(prims: Any) -> int:
    return 3


@implement(hull_point, Triangles)
def _hull_point(prims: Any, k: int, j: int) -> Vec3:
    return row(prims.vertices, prims.faces[k, j])
