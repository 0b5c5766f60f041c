"""Chains of round segments, such as hair: each is the convex hull of two spheres, visible from outside."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.description.fields import Counts, Lengths, Points, Positive, Shape
from caster.description.transform import cross, power, transform_points
from caster.geometry.world_space import Rounding
from caster.jit.decorators import implement, inlined, jit
from caster.kernels.exact.numbers import (
    Integer,
    Root,
    dot_integer,
    integer,
    integers,
    is_within,
    lowest_exponent,
    minus,
    minus3,
    no_root,
    plus,
    sign,
    signed,
    times,
)
from caster.kernels.exact.primitives import exact_quadric_roots, height_sign, is_between_caps, root_in_range
from caster.kernels.math.quadric_roots import QuadricSetup, quadric_roots, quadric_setup
from caster.kernels.math.vec import (
    LARGEST_SQUARE,
    SMALLEST_SQUARE,
    TINY,
    U,
    add,
    certain_in_range,
    cube_corner,
    dot,
    filter_result,
    l1_norm,
    normalize,
    point_at,
    row,
    scaled,
    sub,
)
from caster.kernels.protocol import Vec3, exact_intersect, hull_point, hull_size, intersect, load, prepare, surface

__all__ = ["LinearCurve", "RoundSegments"]


class RoundSegments(NamedTuple):
    """Convex hulls of two spheres: the cone that touches both along a circle, and what is left of the spheres."""

    start: np.ndarray  # (n, 3) float64, centres
    end: np.ndarray  # (n, 3) float64
    radius: np.ndarray  # (n, 2) float64, at start and end

    @property
    def curvature(self) -> np.ndarray:
        """(n,) the largest curvature of each."""
        smallest: np.ndarray = self.radius.min(axis=1)
        return 1.0 / smallest


class LinearCurve(Shape):
    """Curves through `points` with the radius of each, or one `radius`.

    `counts`: how many of the points belong to each curve, all to one by default. Consecutive points make a primitive.
    Rays meet it where they enter it. Radii are scaled by the cube root of the volume's scale of to_world.
    """

    type: Literal["linear_curve"] = "linear_curve"
    MINIMAL: ClassVar[Mapping[str, Any]] = {"points": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
    points: Points
    radii: Lengths | None = None
    radius: Positive | None = None
    counts: Counts | None = None

    @model_validator(mode="after")
    def _has_whole_curves(self) -> "LinearCurve":
        count = len(self.points)
        if self.radii is not None and (self.radius is not None or len(self.radii) != count):
            raise ValueError(
                f"needs either radius, or as many radii as points, got {len(self.radii)} and {count} points"
            )
        _, _, counts = self.curves()
        if counts.min() < 2:
            raise ValueError("needs at least 2 points for each curve")
        if counts.sum() != count:
            raise ValueError(f"needs counts that sum to the number of points, got {counts.sum()} and {count} points")
        return self

    def curves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (n, 3), radii (n,), and the number of points of each curve."""
        points = np.array(self.points)
        radii = np.full(len(points), self.radius or 1.0) if self.radii is None else np.array(self.radii)
        return points, radii, np.array([len(points)] if self.counts is None else self.counts)

    def pack(self, rounded: Rounding) -> RoundSegments:
        points, radii, counts = self.curves()
        linear = self.matrix[:3, :3]
        largest = np.abs(linear).max()  # a factor of two of to_world is one of radii, too
        a, b, c = (linear / largest).tolist()
        determinant = sum(x * y for x, y in zip(a, cross(b, c), strict=True))
        scale = largest * power(abs(determinant), 1.0 / 3.0)
        points, radii = rounded(transform_points(self.matrix, points)), rounded(scale * radii)
        first = np.delete(np.arange(len(points)), np.cumsum(counts) - 1)
        return RoundSegments(points[first], points[first + 1], np.stack([radii[first], radii[first + 1]], axis=1))


@implement(load, RoundSegments)
def _load(prims: Any, k: int) -> Any:
    return row(prims.start, k), row(prims.end, k), prims.radius[k, 0], prims.radius[k, 1]


class PreparedSegment(NamedTuple):
    """A segment relative to the origin of a ray: P = end - start, and dr of the radii, over the size of P.

    So all products are of moderate size, and scale with the scene.
    """

    p: Vec3  # P
    f: Vec3  # the origin, relative to start
    start: QuadricSetup
    end: QuadricSetup
    r: float  # at start
    lift: float  # r dr: a point h from start has the height h.P + r dr above the circle there
    g: float  # P.P - dr^2; the cone is g (h.h - r^2) = height^2
    w: float  # its size: an upper bound of P.P + dr^2
    top: float  # the height of the circle at the end: g times the size
    top_error: float


@implement(prepare, RoundSegments)
def _prepare(prims: Any, prim: Any, o: Any) -> PreparedSegment:
    start, end, r0, r1 = prim
    p, f, e = sub(end, start), sub(o, start), sub(o, end)
    size = l1_norm(p)
    over = 1.0 / (size if size > 0.0 else 1.0)
    p, dr = scaled(over, p), over * (r1 - r0)
    g, w = dot(p, p) - dr * dr, 1.0 + dr * dr
    setups = quadric_setup(f, r0, U * l1_norm(f)), quadric_setup(e, r1, U * l1_norm(e))
    return PreparedSegment(p, f, *setups, r0, r0 * dr, g, w, g * size, 2.0 * G_ERROR * w * size)


# Error bounds, for P and dr off by 3 u, W >= |P|^2 + dr^2, |P| <= 1, and a point that is off by e and has the size R
# with r. A height h.P + r dr is off by 7 u (|h| + r |dr|) + e, and |dr| < 1 where there is a cone; g by 10 u W.
# A = g d.d - (d.P)^2 by 28 u W |d|^2; B = g h.d - (d.P) height by (29 u R + 2 e) W |d|; C by (32 u R + 6 e) R W.
HEIGHT_ERROR, G_ERROR, A_ERROR, B_ERROR, C_ERROR = 8.0 * U, 16.0 * U, 40.0 * U, 40.0 * U, 80.0 * U


@implement(intersect, RoundSegments)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    """The hull is convex and entered at most once: on the cone, or beyond its circles on one of the spheres."""
    slope = dot(pre.p, d)
    cone = _cone(pre, d, slope, t_min, t_max)
    first = _cap(pre, quadric_roots(pre.start, d, 0.0), d, slope, (-1.0, 0.0), t_min, t_max)
    last = _cap(pre, quadric_roots(pre.end, d, 0.0), d, slope, (1.0, pre.top), t_min, t_max)
    t, error = min(min(cone[0], first[0]), last[0]), max(max(cone[1], first[1]), last[1])
    return t, error


@inlined
def _cone(pre: Any, d: Any, slope: float, t_min: float, t_max: float) -> tuple[float, float]:
    """The hit between the circles.

    From the closest approach to start, h from it, the line is on the cone where A t^2 + 2 B t + C = 0, and enters it
    where that decreases: at t = (-B - sqrt(B^2 - A C)) / A, for either sign of A. Where dr^2 > P.P, one sphere
    contains the other, and there is no cone.
    """
    a, d1, g, w = dot(d, d), l1_norm(d), pre.g, pre.w
    steady = (a > SMALLEST_SQUARE) & (a < LARGEST_SQUARE)
    s = -dot(pre.f, d) / (a if steady else 1.0)
    h, off = point_at(pre.f, s, d), pre.start.moved
    reach = l1_norm(h) + pre.r + off
    height = dot(pre.p, h) + pre.lift
    qa = g * a - slope * slope
    qb = g * dot(h, d) - slope * height
    qc = g * (dot(h, h) - pre.start.rr) - height * height
    a_error = A_ERROR * w * d1 * d1 + TINY
    b_error = (B_ERROR * reach + 3.0 * off) * w * d1 + TINY
    c_error = (C_ERROR * reach + 6.0 * off) * reach * w + TINY
    within = qb * qb - qa * qc
    size = qb * qb + abs(qa * qc)
    error = (
        (2.0 * abs(qb) + b_error) * b_error + abs(qa) * c_error + a_error * (abs(qc) + c_error) + 4.0 * U * size + TINY
    )
    narrow, none = g > G_ERROR * w + TINY, g < -G_ERROR * w - TINY
    met = steady & narrow & (within > 2.0 * error) & (within > SMALLEST_SQUARE)
    root = math.sqrt(within if met else 1.0)
    late = qb >= 0.0
    q = -qb - root if late else root - qb
    q_error = b_error + error / root + 3.0 * U * abs(q)
    above, below = q if late else qc, qa if late else q
    above_error, below_error = q_error if late else c_error, a_error if late else q_error
    met &= abs(below) > 2.0 * below_error
    below = below if met else 1.0
    t = above / below
    t_error = 2.0 * (above_error + abs(t) * below_error) / abs(below) + 3.0 * U * abs(t)
    y = height + t * slope
    y_error = _height_error(pre, reach + abs(t) * d1, off) + abs(slope) * t_error
    y_error += pre.top_error
    inside = (y > y_error) & (y < pre.top - y_error)
    outside = (y < -y_error) | (y > pre.top + y_error)
    t_error += 2.0 * U * (abs(s) + abs(t))
    found = certain_in_range(s + t, t_error, t_min, t_max)
    inside &= found[0] + found[1] < math.inf
    misses = none | (steady & narrow & (within < -error)) | (met & (outside | (found[0] == math.inf)))
    return filter_result(met & inside, misses, s + t, t_error)


@inlined
def _cap(
    pre: Any, roots: Any, d: Any, slope: float, beyond: tuple[float, float], t_min: float, t_max: float
) -> tuple[float, float]:
    """The hit on a sphere, if it is beyond a circle: (side, its height), side -1 for below and 1 for above."""
    side, circle = beyond
    t, error = roots.near, roots.near_error
    y = (dot(pre.p, pre.f) + pre.lift + t * slope - circle) * side
    y_error = _height_error(pre, pre.start.f1 + pre.r + abs(t) * l1_norm(d), pre.start.moved)
    y_error += abs(slope) * error + pre.top_error + TINY
    found = certain_in_range(t, error, t_min, t_max)
    misses = roots.missed | (roots.met & ((y < -y_error) | (found[0] == math.inf)))
    return filter_result(roots.met & (y > y_error) & (found[0] + found[1] < math.inf), misses, t, error)


@inlined
def _height_error(pre: Any, reach: float, off: float) -> float:
    return HEIGHT_ERROR * (reach + abs(pre.lift)) + 2.0 * off + TINY


@implement(exact_intersect, RoundSegments)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    start, end, r0, r1 = load(prims, k)
    unit, step = lowest_exponent(o + start + end + (r0, r1)), lowest_exponent(d)
    a, along, r = integers(start, unit), integers(d, step), integer(r0, unit)
    p, f = minus3(integers(end, unit), a), minus3(integers(o, unit), a)
    dr = minus(integer(r1, unit), r)
    g, slope = minus(dot_integer(p, p), times(dr, dr)), dot_integer(along, p)
    height = plus(dot_integer(f, p), times(r, dr))
    first = exact_quadric_roots(f, along, r, unit - step)[0]
    if first.hit and height_sign(first, height, slope) < 0 and is_within(first, t_min, t_max):
        return first
    last = exact_quadric_roots(minus3(f, p), along, plus(r, dr), unit - step)[0]
    if last.hit and height_sign(last, minus(height, g), slope) > 0 and is_within(last, t_min, t_max):
        return last
    if sign(g) <= 0:
        return no_root()
    qa = minus(times(g, dot_integer(along, along)), times(slope, slope))
    qb = minus(times(g, dot_integer(f, along)), times(slope, height))
    qc = minus(times(g, minus(dot_integer(f, f), times(r, r))), times(height, height))
    entry = entering_root(qa, qb, qc, unit - step)
    return root_in_range(entry, t_min, t_max) if is_between_caps(entry, height, slope, g) else no_root()


@jit
def entering_root(a: Integer, b: Integer, c: Integer, e: int) -> Root:
    """The t, in units of 2^e, at which a t^2 + 2 b t + c is 0 and does not increase."""
    zero = np.zeros(1, np.int64)
    within, s = minus(times(b, b), times(a, c)), sign(a)
    if s == 0:
        return Root(sign(b) < 0, c, zero, minus(zero, plus(b, b)), 0, e)
    return Root(sign(within) >= 0, signed(-s, b), within, signed(s, a), -s if sign(within) > 0 else 0, e)


@implement(surface, RoundSegments)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    """u is 0, v the height between the circles from 0 to 1."""
    start, end, r0, r1 = load(prims, k)
    p, dr = sub(end, start), r1 - r0
    h = point_at(sub(o, start), t, d)
    g = dot(p, p) - dr * dr
    v = min(max((dot(h, p) + r0 * dr) / g, 0.0), 1.0) if g > 0.0 else (1.0 if dr > 0.0 else 0.0)
    n = normalize(sub(h, scaled(v, p)))
    center = add(start, scaled(v, p))
    return point_at(center, r0 + v * dr, n), n, n, 0.0, v


@implement(hull_size, RoundSegments)
def _hull_size(prims: Any) -> int:
    return 16


@implement(hull_point, RoundSegments)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    center = row(prims.start, k) if j < 8 else row(prims.end, k)
    return point_at(center, prims.radius[k, j // 8], cube_corner(j))
