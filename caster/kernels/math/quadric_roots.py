"""Intersection of a ray with a sphere or cylinder in float64 with error bounds: roots of a t^2 - 2 b t + c = 0."""

import math
from typing import Any, NamedTuple

from caster.jit.decorators import inlined, jit
from caster.kernels.exact.numbers import times_power
from caster.kernels.math.vec import (
    LARGEST_SQUARE,
    SMALLEST_SQUARE,
    TINY,
    U,
    certain_in_range,
    dot,
    filter_result,
    l1_norm,
    max_norm,
    point_at,
    scaled,
    scaled_near_one,
    select,
)
from caster.kernels.protocol import Vec3

# The bounds are of second order in the error of d over d's length, which has to be below 1/32 for them to hold.
MAX_DIRECTION_ERROR_SHARE = 2.0**-10

# 2^MAX_SQUARABLE_EXPONENT has a finite square, and so has the sum of three. Within MIN_RANGE..MAX_RANGE, squares
# neither overflow nor underflow.
MAX_SQUARABLE_EXPONENT = 500
MIN_RANGE, MAX_RANGE = 2.0**-100, 2.0**100


class QuadricSetup(NamedTuple):
    """A sphere or cylinder relative to the origin of a ray. Errors are bounds for an exact d."""

    f: Vec3  # the origin, relative to the centre
    f1: float  # size(f)
    r: float
    over_r: float  # 1 / r
    rr: float  # r^2
    c: float  # f.f - r^2
    c_error: float  # error of c
    b_error: float  # error of -f.d over size(d)
    moved: float  # how far off the point of closest approach may be


class ClosestApproach(NamedTuple):
    """Closest approach of the line through a ray to a sphere's centre."""

    met: bool  # the line certainly meets the sphere
    missed: bool  # it certainly does not
    a: float  # d.d
    over_a: float  # 1 / a
    b: float  # -f.d
    within: float  # the discriminant over a: r^2 less the square of the closest approach
    within_error: float  # its error


class QuadricRoots(NamedTuple):
    """Both roots with error bounds, if they certainly exist."""

    met: bool
    missed: bool
    near: float
    far: float
    near_error: float
    far_error: float


@jit
def quadric_setup(f: Vec3, r: float, f_error: float) -> QuadricSetup:
    """The sphere |p - f| = r; f is off by at most f_error."""
    f1, rr = l1_norm(f), r * r
    c_error = 5.0 * U * (f1 * f1 + rr) + (3.0 * f1 + 2.0 * f_error) * f_error + TINY
    return QuadricSetup(
        f, f1, r, 1.0 / r, rr, dot(f, f) - rr, c_error, 5.0 * U * f1 + 2.0 * f_error, 12.0 * U * f1 + 2.0 * f_error
    )


@inlined
def closest_approach(setup: Any, d: Vec3, d_error: float) -> ClosestApproach:
    """Whether |f + t d| = r has roots; d is off by at most d_error.

    The discriminant is taken at the point of closest approach, f + (b/a) d, where the numbers are as small as
    the sphere: b^2 - a c would cancel for a small sphere far away (Haines et al., Ray Tracing Gems, chapter 7).
    The bounds are derived in docs/method.md, "Exact decisions".
    """
    f, moved, lean = setup.f, setup.moved, 0.0
    a, b = dot(d, d), -dot(f, d)
    steady = (a > SMALLEST_SQUARE) & (a < LARGEST_SQUARE) & (d_error * d_error < MAX_DIRECTION_ERROR_SHARE * a)
    over_a = 1.0 / (a if steady else 1.0)
    s = b * over_a
    if d_error > 0.0:
        moved, lean = moved + 2.0 * abs(s) * d_error, setup.f1 * d_error
        lean = 8.0 * (lean * lean) * over_a
    x, y, z = f[0] + s * d[0], f[1] + s * d[1], f[2] + s * d[2]
    gg = x * x + y * y + z * z
    within = setup.rr - gg
    # 2 g <= g^2 / r + r, with hardly more than equality where it matters, at the rim
    within_error = moved * (gg * setup.over_r + setup.r) + moved * moved + lean + 8.0 * U * (gg + setup.rr) + TINY
    met, missed = steady & (within > 2.0 * within_error), steady & (within < -within_error)
    return ClosestApproach(met, missed, a, over_a, b, within, within_error)


@inlined
def quadric_roots(setup: Any, d: Vec3, d_error: float) -> QuadricRoots:
    """The roots, if the discriminant is known to within half of itself.

    The root of larger magnitude adds numbers of one sign; the other follows from the roots' product, c / a.
    """
    met, missed, a, over_a, b, within, within_error = closest_approach(setup, d, d_error)
    met &= a * within > SMALLEST_SQUARE
    d1, root = l1_norm(d), math.sqrt(a * within if met else 1.0)
    a_share, b_error = 5.0 * U, setup.b_error * d1 + TINY
    if d_error > 0.0:
        a_share, b_error = a_share + 3.0 * d1 * d_error * over_a, b_error + 2.0 * setup.f1 * d_error
    q = b + root if b >= 0.0 else b - root
    # the root of a number that is off by a share < 1/2 of itself is off by no more than that share
    q_error = b_error + root * a_share + a * within_error / root + 5.0 * U * abs(q)
    met &= 2.0 * q_error < abs(q)
    over_q = 1.0 / (q if met else 1.0)
    large, small = q * over_a, setup.c * over_q
    large_error = 2.0 * (q_error * over_a + abs(large) * a_share) + 3.0 * U * abs(large)
    small_error = 2.0 * (setup.c_error + abs(small) * q_error) * abs(over_q) + 3.0 * U * abs(small)
    first = b >= 0.0
    near, far = small if first else large, large if first else small
    near_error, far_error = small_error if first else large_error, large_error if first else small_error
    return QuadricRoots(met, missed, near, far, near_error, far_error)


@jit
def outward_normal(f: Vec3, d: Vec3, along_d: Vec3, t: float, r: float) -> Vec3:
    """The unit vector from the centre of |p| = r to where f + t d meets it; along_d: d at length 1."""
    reach = t * dot(d, along_d)
    if not _is_in_range(f, r):
        e = min(
            -math.frexp(r)[1], MAX_SQUARABLE_EXPONENT - math.frexp(max_norm(f))[1]
        )  # so that all squares are numbers
        f, r = (times_power(f[0], e), times_power(f[1], e), times_power(f[2], e)), math.ldexp(r, e)
        reach = times_power(reach, e)
        return normalize_in_range(scaled_near_one(radial_vector(f, along_d, reach, r)))
    return normalize_in_range(radial_vector(f, along_d, reach, r))


@inlined
def normalize_in_range(v: Vec3) -> Vec3:
    """v at length 1, for a v whose square is a number."""
    return scaled(1.0 / math.sqrt(dot(v, v)), v)


@inlined
def fast_outward_normal(f: Vec3, d: Vec3, unit: tuple[bool, Vec3], t: float, r: float) -> tuple[bool, Vec3]:
    """(whether this is `outward_normal`, that normal), without a branch; unit: (whether along_d is known, along_d)."""
    long, along_d = unit
    known = _is_in_range(f, r) & long
    reach = t * dot(d, along_d) if known else 0.0
    f, along_d = select(known, f, (0.0, 0.0, 0.0)), select(known, along_d, (0.0, 0.0, 1.0))
    return known, normalize_in_range(radial_vector(f, along_d, reach, r if known else 1.0))


@inlined
def _is_in_range(f: Vec3, r: float) -> bool:
    return (r > MIN_RANGE) & (max(r, max_norm(f)) < MAX_RANGE)


@inlined
def radial_vector(f: Vec3, d: Vec3, t: float, r: float) -> Vec3:
    """From the centre of |p| = r to f + t d, d being of length 1: about r long.

    From the closest approach, g off the centre, and half the chord h: by that a sphere that is smaller than the
    rounding of t keeps its shape. h^2 = r^2 - g^2 is off by u / h, so where h < g, t has it more accurately.
    """
    s = -dot(f, d)
    closest = point_at(f, s, d)
    gg, beyond = dot(closest, closest), t - s
    h = math.sqrt(max(r * r - gg, 0.0))
    half_chord = min(abs(beyond), r) if h * h < gg else h
    # where t cannot separate the two ends, the near one is what a ray from outside meets
    side = 1.0 if beyond > (4.0 * U * abs(s) if dot(f, f) > r * r else 0.0) else -1.0
    out = point_at(closest, side * half_chord, d)
    there = l1_norm(out) > 0.0  # else r has no square, and the ray passes through the centre
    return select(there, out, scaled(side, d))


@inlined
def first_hit(near: tuple[float, float], far: tuple[float, float]) -> tuple[float, float]:
    """The near result, unless it is MISS."""
    behind = near[0] == math.inf
    return far[0] if behind else near[0], far[1] if behind else near[1]


@inlined
def first_root(roots: QuadricRoots, t_min: float, t_max: float) -> tuple[float, float]:
    """The first root in (t_min, t_max], as a result of `intersect`."""
    near = certain_in_range(roots.near, roots.near_error, t_min, t_max)
    t, error = first_hit(near, certain_in_range(roots.far, roots.far_error, t_min, t_max))
    return filter_result(roots.met, roots.missed, t, error)
