"""Exact intersections of a ray with spheres, cylinders, triangles, planes and disks, in integers."""

from typing import Any

import numpy as np

from caster.jit.decorators import jit
from caster.kernels.exact.numbers import (
    Integer,
    Integer3,
    Root,
    cross_integer,
    dot_integer,
    integer,
    integers,
    is_within,
    lowest_exponent,
    minus,
    minus3,
    no_root,
    plus,
    ratio,
    sign,
    sign_of_surd,
    signed,
    times,
)
from caster.kernels.math.vec import row
from caster.kernels.protocol import Vec3


@jit
def ray_in_object_space(center: Vec3, m: Any, o: Vec3, d: Vec3) -> tuple[Integer3, Integer3, Integer, int]:
    """(f, e, h, exponent): the ray f + t e among images of unit shapes, which are h > 0 large there.

    The adjugate of m, the matrix's inverse times its determinant, takes the ray to object space without a division.
    t counts in 2^exponent.
    """
    first, second, third = row(m, 0), row(m, 1), row(m, 2)
    unit = lowest_exponent(o + center + first + second + third)
    step = lowest_exponent(d)
    x, y, z = integers(first, unit), integers(second, unit), integers(third, unit)
    away, along = minus3(integers(o, unit), integers(center, unit)), integers(d, step)
    columns = cross_integer(y, z), cross_integer(z, x), cross_integer(x, y)  # of the adjugate
    h = dot_integer(x, columns[0])
    s = sign(h)
    return signed_mat_vec(columns, away, s), signed_mat_vec(columns, along, s), signed(s, h), unit - step


@jit
def signed_mat_vec(columns: Any, v: Integer3, s: int) -> Integer3:
    """s times the matrix of these columns, times v."""
    a, b, c = columns
    x, y = dot_integer((a[0], b[0], c[0]), v), dot_integer((a[1], b[1], c[1]), v)
    return signed(s, x), signed(s, y), signed(s, dot_integer((a[2], b[2], c[2]), v))


@jit
def exact_unit_sphere(f: Integer3, d: Integer3, r: Integer, e: int, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] with |f + t d| = r, t in units of 2^e."""
    for root in exact_quadric_roots(f, d, r, e):
        if root.hit and is_within(root, t_min, t_max):
            return root
    return no_root()


@jit
def exact_unit_cylinder(f: Integer3, d: Integer3, h: Integer, e: int, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] with x^2 + y^2 = h^2 and 0 <= z <= h."""
    zero = np.zeros(1, np.int64)
    for root in exact_quadric_roots((f[0], f[1], zero), (d[0], d[1], zero), h, e):
        if root.hit and is_within(root, t_min, t_max) and is_between_caps(root, f[2], d[2], h):
            return root
    return no_root()


@jit
def is_between_caps(root: Root, f: Integer, d: Integer, h: Integer) -> bool:
    """Whether 0 <= f + t d <= h, e left out: all of f, d, h are in the units that t was found in."""
    return height_sign(root, f, d) >= 0 and height_sign(root, minus(f, h), d) <= 0


@jit
def height_sign(root: Root, f: Integer, d: Integer) -> int:
    """The sign of f + t d at a root t, in its units."""
    return sign_of_surd(plus(times(root.q, f), times(root.p, d)), signed(root.s, d), root.r)


@jit
def exact_quadric_roots(f: Integer3, d: Integer3, r: Integer, e: int) -> tuple[Root, Root]:
    """(near, far); no hits where the line passes, or where d is zero; twice the same where it touches."""
    a, b = dot_integer(d, d), signed(-1, dot_integer(f, d))
    within = minus(times(b, b), times(a, minus(dot_integer(f, f), times(r, r))))
    if sign(a) == 0 or sign(within) < 0:
        return no_root(), no_root()
    s = sign(within)
    return Root(True, b, within, a, -s, e), Root(True, b, within, a, s, e)


@jit
def exact_sphere(center: Vec3, r: float, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """The first t in (t_min, t_max] at which o + t d lies on a sphere."""
    unit, step = lowest_exponent(o + center + (r,)), lowest_exponent(d)
    f = minus3(integers(o, unit), integers(center, unit))
    return exact_unit_sphere(f, integers(d, step), integer(r, unit), unit - step, t_min, t_max)


@jit
def root_in_range(root: Root, t_min: float, t_max: float) -> Root:
    """root, if it is in (t_min, t_max]."""
    return root if is_within(root, t_min, t_max) else no_root()


@jit
def exact_triangle(corners: Any, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the closed triangle; a miss where it is edge-on or has no area."""
    unit, step = lowest_exponent(o + corners[0] + corners[1] + corners[2]), lowest_exponent(d)
    eye, along = integers(o, unit), integers(d, step)
    a, b = minus3(integers(corners[0], unit), eye), minus3(integers(corners[1], unit), eye)
    c = minus3(integers(corners[2], unit), eye)
    across = cross_integer(b, c)
    u, v = dot_integer(along, across), dot_integer(along, cross_integer(c, a))
    if sign(u) * sign(v) < 0:
        return no_root()
    w = dot_integer(along, cross_integer(a, b))
    if sign(u) * sign(w) < 0 or sign(v) * sign(w) < 0:
        return no_root()
    area = plus(plus(u, v), w)
    if sign(area) == 0:
        return no_root()
    return root_in_range(ratio(dot_integer(a, across), area, unit - step), t_min, t_max)


@jit
def exact_plane(n: Vec3, point: Vec3, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the plane; a miss where it is edge-on."""
    unit, step, tilt = lowest_exponent(o + point), lowest_exponent(d), lowest_exponent(n)
    normal = integers(n, tilt)
    slope = dot_integer(normal, integers(d, step))
    if sign(slope) == 0:
        return no_root()
    height = dot_integer(normal, minus3(integers(point, unit), integers(o, unit)))
    return root_in_range(ratio(height, slope, unit - step), t_min, t_max)


@jit
def exact_disk(center: Vec3, m: Any, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Root:
    """t in (t_min, t_max] at which o + t d lies in the image of the closed unit disk; a miss where it is edge-on."""
    f, e, h, unit = ray_in_object_space(center, m, o, d)
    if sign(e[2]) == 0:
        return no_root()
    x = minus(times(f[0], e[2]), times(f[2], e[0]))
    y = minus(times(f[1], e[2]), times(f[2], e[1]))
    rim = times(h, e[2])
    if sign(minus(plus(times(x, x), times(y, y)), times(rim, rim))) > 0:
        return no_root()
    return root_in_range(ratio(signed(-1, f[2]), e[2], unit), t_min, t_max)
