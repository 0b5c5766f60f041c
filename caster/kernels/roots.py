"""Roots of a t^2 - 2 b t + c = 0, the way a ray meets a quadric."""

import math

from caster.kernels.jit import jit


@jit
def both_roots(a: float, b: float, c: float, discriminant: float) -> tuple[float, float]:
    """(near, far) for a > 0 and discriminant = b^2 - a c >= 0, without cancellation.

    The root of larger magnitude adds numbers of one sign; the other follows from the roots' product, c / a.
    """
    s = math.sqrt(discriminant)
    if b >= 0.0:
        q = b + s
        near = c / q if q > 0.0 else 0.0  # q = 0: both roots are 0, the origin touches
        return near, q / a
    q = b - s
    return q / a, c / q


@jit
def ball_roots(
    f: tuple[float, float, float], d: tuple[float, float, float], c: float, r: float
) -> tuple[float, float, bool]:
    """(near, far, hit) of |f + t d| = r, where f is the origin seen from the centre and c = f.f - r^2.

    The discriminant is taken at the point of closest approach, f + (b/a) d, where the numbers are as small as
    the ball: b^2 - a c would cancel for a small ball far away (Haines et al., Ray Tracing Gems, chapter 7).
    """
    a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if a == 0.0:
        return math.inf, math.inf, False
    b = -(f[0] * d[0] + f[1] * d[1] + f[2] * d[2])
    s = b / a
    x, y, z = f[0] + s * d[0], f[1] + s * d[1], f[2] + s * d[2]
    within = r * r - (x * x + y * y + z * z)
    if not within >= 0.0:
        return math.inf, math.inf, False
    near, far = both_roots(a, b, c, a * within)
    return near, far, True


@jit
def first_beyond(t_min: float, near: float, far: float) -> float:
    """The smaller of two ordered roots that is > t_min, or inf."""
    if near > t_min:
        return near
    if far > t_min:
        return far
    return math.inf
