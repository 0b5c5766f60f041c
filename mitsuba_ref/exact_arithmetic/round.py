"""Spheres, ellipsoids and cylinders: where a quadratic equation vanishes."""

from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.exact_arithmetic import affine
from mitsuba_ref.exact_arithmetic.affine import Affine, ObjectRay
from mitsuba_ref.exact_arithmetic.integers import IntegerRay, Integers3, dot, scaled, shifted, sub
from mitsuba_ref.exact_arithmetic.kind import NOTHING, ExactKind, Met, Touch, above, below
from mitsuba_ref.exact_arithmetic.root import Root, sign_with_root

WITHOUT_INSIDE = Met((), (Touch("degenerate", None, None),))


class Ball(NamedTuple):
    """All p with |p - center 2^-k| = radius 2^-k."""

    center: Integers3
    radius: int
    k: int


def line_and_ball(o: Integers3, d: Integers3, size: int, e: int) -> list[Root]:
    """All t = s 2^e with |o + s d| = size, ascending: two, one where the line touches, or none. d != 0.

    a s^2 + 2 b s + c = 0 with a = d.d, b = o.d, c = o.o - size^2, so s = (-b -+ sqrt(b^2 - a c)) / a.
    """
    a, b = dot(d, d), dot(o, d)
    inside = b * b - a * (dot(o, o) - size * size)
    if inside < 0:
        return []
    return [Root(-b, side, inside, a, e) for side in ((-1, 1) if inside else (0,))]


def prepare_ball(prims: Any, k: int) -> Ball:
    (x, y, z, radius), scale = scaled([*prims.center[k].tolist(), float(prims.radius[k])])
    return Ball((x, y, z), radius, scale)


def meet_ball(ball: Ball, ray: IntegerRay) -> Met:
    scale = max(ball.k, ray.ko)
    away = sub(shifted(ray.o, scale - ray.ko), shifted(ball.center, scale - ball.k))
    return _closed(line_and_ball(away, ray.d, ball.radius << (scale - ball.k), ray.kd - scale))


def meet_ellipsoid(ellipsoid: Affine, ray: IntegerRay) -> Met:
    if not ellipsoid.determinant:
        return WITHOUT_INSIDE
    return _closed(line_and_ball(*affine.seen(ellipsoid, ray)))


def _closed(roots: list[Root]) -> Met:
    where = "tangent" if len(roots) == 1 else "inside"
    return Met(tuple((root, where) for root in roots))


def meet_tube(tube: Affine, ray: IntegerRay) -> Met:
    """The circle in x and y, and of its roots those with 0 <= z <= size."""
    if not tube.determinant:
        return WITHOUT_INSIDE
    o, d, size, e = rod = affine.seen(tube, ray)
    if not (d[0] or d[1]):
        return _along_a_tube(rod)
    roots = line_and_ball((o[0], o[1], 0), (d[0], d[1], 0), size, e)
    where = "tangent" if len(roots) == 1 else "inside"
    found = []
    for root in roots:
        from_bottom, from_top = height(root, o[2], d[2]), height(root, o[2] - size, d[2])
        if from_bottom >= 0 >= from_top:
            rim = where == "inside" and 0 in (from_bottom, from_top)
            found.append((root, "rim" if rim else where))
    return Met(tuple(found))


def height(root: Root, o: int, d: int) -> int:
    """The sign of o + s d at the root s = (p + q sqrt(r)) / a, a > 0."""
    return sign_with_root(root.s * o + root.p * d, root.q * d, root.r)


def _along_a_tube(ray: ObjectRay) -> Met:
    """Parallel to the axis is a miss; within the wall it runs along it, from one end to the other."""
    (x, y, z), (_, _, slope), size, e = ray
    if x * x + y * y != size * size:
        return NOTHING
    ends = [Root(-z, 0, 0, slope, e), Root(size - z, 0, 0, slope, e)]
    return Met((), (Touch("edge_on", min(ends), max(ends)),))


def ball_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    r = prims.radius[:, None]
    with np.errstate(over="ignore"):
        return below(prims.center - r), above(prims.center + r)


def usable_ball(prims: Any) -> np.ndarray:
    return np.isfinite(prims.center).all(axis=1) & np.isfinite(prims.radius) & (prims.radius >= 0.0)


SPHERES = ExactKind(ball_boxes, prepare_ball, meet_ball, usable=usable_ball)
ELLIPSOIDS = ExactKind(affine.boxes, affine.prepare, meet_ellipsoid, usable=affine.usable)
CYLINDERS = ExactKind(affine.tube_boxes, affine.prepare, meet_tube, usable=affine.usable)
