"""Exactly where a ray meets a triangle, a plane or a disk, in integers."""

from typing import Any

from caster.kernels.exact_quadric import placed
from caster.kernels.exact_root import Root, is_within, no_root, ratio
from caster.kernels.integers import (
    inner,
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


@jit
def kept(root: Root, t_min: float, t_max: float) -> Root:
    """root, if it is in (t_min, t_max]."""
    return root if is_within(root, t_min, t_max) else no_root()


@jit
def exact_triangle(corners: Any, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the closed triangle; a miss where it is edge-on or has no area."""
    unit, step = lowest_exponent(o + corners[0] + corners[1] + corners[2]), lowest_exponent(d)
    eye, along = integers(o, unit), integers(d, step)
    a, b = minus3(integers(corners[0], unit), eye), minus3(integers(corners[1], unit), eye)
    c = minus3(integers(corners[2], unit), eye)
    across = outer(b, c)
    u, v = inner(along, across), inner(along, outer(c, a))
    if sign(u) * sign(v) < 0:
        return no_root()
    w = inner(along, outer(a, b))
    if sign(u) * sign(w) < 0 or sign(v) * sign(w) < 0:
        return no_root()
    area = plus(plus(u, v), w)
    if sign(area) == 0:
        return no_root()
    return kept(ratio(inner(a, across), area, unit - step), t_min, t_max)


@jit
def exact_plane(n: Vec3, point: Vec3, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the plane; a miss where it is edge-on."""
    unit, step, tilt = lowest_exponent(o + point), lowest_exponent(d), lowest_exponent(n)
    normal = integers(n, tilt)
    slope = inner(normal, integers(d, step))
    if sign(slope) == 0:
        return no_root()
    height = inner(normal, minus3(integers(point, unit), integers(o, unit)))
    return kept(ratio(height, slope, unit - step), t_min, t_max)


@jit
def exact_disk(center: Vec3, m: Any, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the image of the closed unit disk; a miss where it is edge-on."""
    f, e, h, unit = placed(center, m, o, d)
    if sign(e[2]) == 0:
        return no_root()
    x = minus(times(f[0], e[2]), times(f[2], e[0]))
    y = minus(times(f[1], e[2]), times(f[2], e[1]))
    rim = times(h, e[2])
    if sign(minus(plus(times(x, x), times(y, y)), times(rim, rim))) > 0:
        return no_root()
    return kept(ratio(signed(-1, f[2]), e[2], unit), t_min, t_max)
