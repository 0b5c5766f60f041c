"""Where a ray meets a ball or a tube, in float64 with bounds: roots of a t^2 - 2 b t + c = 0."""

import math
from typing import Any, NamedTuple

from caster.kernels.exact_root import times_power
from caster.kernels.jit import inlined, jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import MISS, TINY, UNDECIDED, U, along, dot, size, sure_within, unit

# The discriminant's error has a term 2 p q; for any LOOSE it is at most p^2 / LOOSE + q^2 LOOSE, which takes no root.
# By that most rays are seen to miss, or to hit so well that the discriminant is known to SHARE of itself.
LOOSE, SHARE = 2.0**-40, 2.0**-26

# The bounds are of second order in the error of d over d's length, which has to be below 1/32 for them to hold.
STEADY = 2.0**-10


class Ball(NamedTuple):
    """A ball, or a tube, as seen from the origin of a ray."""

    f: Vec3  # the origin, seen from the centre
    f_off: float  # how far off that is at most
    f1: float  # size(f)
    rr: float  # r^2
    c: float  # f.f - r^2
    c_off: float  # how far off that is at most
    moved: float  # how far the point of closest approach may be off, but for what the error of d adds


class Chord(NamedTuple):
    """Both roots, near first, and how far off each may be; `sure` is 1: they exist, -1: they do not, 0: who knows."""

    sure: int
    near: float
    far: float
    near_off: float
    far_off: float


@jit
def ball_at(f: Vec3, r: float, f_off: float) -> Ball:
    """|p - f| = r, for an f that is off by no more than f_off."""
    f1, rr = size(f), r * r
    c_off = 5.0 * U * (f1 * f1 + rr) + (3.0 * f1 + 2.0 * f_off) * f_off + TINY
    return Ball(f, f_off, f1, rr, dot(f, f) - rr, c_off, 12.0 * U * f1 + 2.0 * f_off)


@jit
def unknown(sure: int) -> Chord:
    return Chord(sure, 0.0, 0.0, math.inf, math.inf)


@inlined
def chord(ball: Any, d: Vec3, d_off: float) -> Chord:
    """|f + t d| = r, for a d that is off by no more than d_off.

    The discriminant is taken at the point of closest approach, f + (b/a) d, where the numbers are as small as
    the ball: b^2 - a c would cancel for a small ball far away (Haines et al., Ray Tracing Gems, chapter 7).
    The bounds are worked out in docs/method.md, "Exact decisions".
    """
    f = ball.f
    a, b = dot(d, d), -dot(f, d)
    if not d_off * d_off < STEADY * a:
        return unknown(0)
    over_a = 1.0 / a
    s = b * over_a
    x, y, z = f[0] + s * d[0], f[1] + s * d[1], f[2] + s * d[2]
    gg = x * x + y * y + z * z
    within = ball.rr - gg
    moved, lean = ball.moved + 2.0 * abs(s) * d_off, ball.f1 * d_off
    bar = moved * moved / LOOSE + 8.0 * U * ball.rr + 8.0 * (lean * lean) * over_a + TINY
    if within < -(2.0 * LOOSE * gg + bar):
        return unknown(-1)
    if within > (2.0 * LOOSE * gg + bar) / SHARE:
        return both_roots(ball, (a, over_a, b, size(d)), d_off, within, SHARE)
    within_off = moved_within(gg, ball.rr, moved, lean, over_a)
    if within < -within_off:
        return unknown(-1)
    return both_roots(
        ball, (a, over_a, b, size(d)), d_off, within, within_off / within if within > 0.0 else math.inf
    )


@jit
def moved_within(gg: float, rr: float, moved: float, lean: float, over_a: float) -> float:
    """How far off the discriminant r^2 - g^2 may be, g the closest approach."""
    return (
        2.0 * moved * math.sqrt(gg) + moved * moved + 8.0 * lean * lean * over_a + 8.0 * U * (gg + rr) + TINY
    )


@inlined
def both_roots(
    ball: Any, line: tuple[float, float, float, float], d_off: float, within: float, share: float
) -> Chord:
    """The roots, for a discriminant that may be off by a share of itself; unknown where that is more than half.

    The root of larger magnitude adds numbers of one sign; the other follows from the roots' product, c / a.
    """
    a, over_a, b, d1 = line
    if not share < 0.5:
        return unknown(0)
    root = math.sqrt(a * within)
    a_off = 4.0 * U * a + 3.0 * d1 * d_off + TINY
    b_off = 5.0 * U * ball.f1 * d1 + 2.0 * (ball.f_off * d1 + ball.f1 * d_off) + TINY
    q = b + root if b >= 0.0 else b - root
    q_off = b_off + root * (a_off * over_a + share) + 5.0 * U * abs(q)
    if not (2.0 * q_off < abs(q) and 4.0 * a_off < a):
        return unknown(0)
    over_q = 1.0 / q
    large, small = q * over_a, ball.c * over_q
    large_off = 2.0 * (q_off + abs(large) * a_off) * over_a + 3.0 * U * abs(large)
    small_off = 2.0 * (ball.c_off + abs(small) * q_off) * abs(over_q) + 3.0 * U * abs(small)
    if b >= 0.0:
        return Chord(1, small, large, small_off, large_off)
    return Chord(1, large, small, large_off, small_off)


@jit
def way_out(f: Vec3, d: Vec3, t: float, r: float) -> Vec3:
    """The unit vector from the centre of |p| = r to where f + t d meets it.

    From the closest approach and half the chord, by which a ball that is smaller than the rounding of t keeps its
    shape; or what t says of the chord, if that is less: by which a ball that is hardly touched has no chord.
    """
    e = -math.frexp(r)[1]  # r^2 has to be a number
    f, r = (times_power(f[0], e), times_power(f[1], e), times_power(f[2], e)), math.ldexp(r, e)
    along_d = unit(d)
    s = -dot(f, along_d)
    closest = along(f, s, along_d)
    half, beyond = math.sqrt(max(r * r - dot(closest, closest), 0.0)), times_power(t * dot(d, along_d), e) - s
    side = math.copysign(1.0, beyond)
    out = along(closest, side * min(half, abs(beyond)), along_d)
    return unit(out if size(out) > 0.0 else along(closest, side * half, along_d))


@inlined
def first_root(roots: Chord, t_min: float, t_max: float) -> tuple[float, float]:
    """The first root in (t_min, t_max], as `intersect` answers."""
    if roots.sure != 1:
        return MISS if roots.sure < 0 else UNDECIDED
    near = sure_within(roots.near, roots.near_off, t_min, t_max)
    if near[0] != math.inf:
        return near
    return sure_within(roots.far, roots.far_off, t_min, t_max)
