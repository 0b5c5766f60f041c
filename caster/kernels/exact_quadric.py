"""Exactly where a ray meets a ball or a tube, in integers."""

from typing import Any

import numpy as np

from caster.kernels.exact_root import Root, is_within, no_root, sign_of_surd
from caster.kernels.integers import (
    Integer,
    Integer3,
    inner,
    integer,
    integers,
    lowest_exponent,
    minus,
    minus3,
    outer,
    plus,
    sign,
    signed,
    times,
)
from caster.kernels.jit import jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import vector


@jit
def placed(center: Vec3, m: Any, o: Vec3, d: Vec3) -> tuple[Integer3, Integer3, Integer, int]:
    """(f, e, h, exponent): the ray f + t e among images of unit shapes, which are h > 0 large there.

    The adjugate of m, the matrix's inverse times its determinant, takes the ray to object space without a division.
    t counts in 2^exponent.
    """
    first, second, third = vector(m[0]), vector(m[1]), vector(m[2])
    unit = lowest_exponent(o + center + first + second + third)
    step = lowest_exponent(d)
    x, y, z = integers(first, unit), integers(second, unit), integers(third, unit)
    away, along = minus3(integers(o, unit), integers(center, unit)), integers(d, step)
    columns = outer(y, z), outer(z, x), outer(x, y)  # of the adjugate
    h = inner(x, columns[0])
    s = sign(h)
    return applied(columns, away, s), applied(columns, along, s), signed(s, h), unit - step


@jit
def applied(columns: Any, v: Integer3, s: int) -> Integer3:
    """s times the matrix of these columns, times v."""
    a, b, c = columns
    x = plus(plus(times(a[0], v[0]), times(b[0], v[1])), times(c[0], v[2]))
    y = plus(plus(times(a[1], v[0]), times(b[1], v[1])), times(c[1], v[2]))
    z = plus(plus(times(a[2], v[0]), times(b[2], v[1])), times(c[2], v[2]))
    return signed(s, x), signed(s, y), signed(s, z)


@jit
def exact_ball(f: Integer3, d: Integer3, r: Integer, e: int, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] with |f + t d| = r, t in units of 2^e."""
    near, far = exact_roots(f, d, r, e)
    if near.hit and is_within(near, t_min, t_max):
        return near
    return far if far.hit and is_within(far, t_min, t_max) else no_root()


@jit
def exact_tube(f: Integer3, d: Integer3, h: Integer, e: int, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] with x^2 + y^2 = h^2 and 0 <= z <= h."""
    zero = np.zeros(1, np.int64)
    near, far = exact_roots((f[0], f[1], zero), (d[0], d[1], zero), h, e)
    if near.hit and is_within(near, t_min, t_max) and is_between(near, f[2], d[2], h):
        return near
    if far.hit and is_within(far, t_min, t_max) and is_between(far, f[2], d[2], h):
        return far
    return no_root()


@jit
def is_between(root: Root, f: Integer, d: Integer, h: Integer) -> bool:
    """Whether 0 <= f + t d <= h, e left out: all of f, d, h are in the units that t was found in."""
    z, slope = plus(times(root.q, f), times(root.p, d)), signed(root.s, d)
    if sign_of_surd(z, slope, root.r) < 0:
        return False
    return sign_of_surd(minus(z, times(root.q, h)), slope, root.r) <= 0


@jit
def exact_roots(f: Integer3, d: Integer3, r: Integer, e: int) -> tuple[Root, Root]:
    """(near, far); no hits where the line passes, or where d is zero; twice the same where it touches."""
    a, b = inner(d, d), signed(-1, inner(f, d))
    within = minus(times(b, b), times(a, minus(inner(f, f), times(r, r))))
    if sign(a) == 0 or sign(within) < 0:
        return no_root(), no_root()
    s = sign(within)
    return Root(True, b, within, a, -s, e), Root(True, b, within, a, s, e)


@jit
def exact_sphere(center: Vec3, r: float, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] at which o + t d lies on a sphere."""
    unit, step = lowest_exponent(o + center + (r,)), lowest_exponent(d)
    f = minus3(integers(o, unit), integers(center, unit))
    return exact_ball(f, integers(d, step), integer(r, unit), unit - step, t_min, t_max)
