"""Intersections of rays and primitives in decimals of 60 digits, by textbook formulas over arrays of m pairs.

Nothing is taken from the judge. Products of three float32 numbers take 72 bits, so signs of determinants are exact.
Whoever calls these sets the context: `with localcontext(DIGITS)`.
"""

from collections.abc import Callable
from decimal import Context, Decimal
from typing import Any, NamedTuple

import numpy as np

DIGITS = Context(prec=60)
root = np.frompyfunc(lambda x: x.sqrt() if x > 0 else Decimal(0), 1, 1)


class Met(NamedTuple):
    """One root of m pairs, as decimals."""

    t: np.ndarray  # (m,), of no meaning where there is none
    n: np.ndarray  # (m, 3) unit
    sh_n: np.ndarray  # (m, 3) unit
    hit: np.ndarray  # (m,) bool, wherever along the line


class Quadric(NamedTuple):
    """A ray in the coordinates of a unit shape."""

    o: np.ndarray  # (m, 3)
    d: np.ndarray  # (m, 3)
    inverse: np.ndarray  # (m, 3, 3)


def exactly(numbers: Any) -> np.ndarray:
    """Floats of any shape as decimals, not rounded."""
    return np.array([Decimal(float(x)) for x in np.ravel(numbers)], object).reshape(np.shape(numbers))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def unit(v: np.ndarray) -> np.ndarray:
    return over(v, root(dot(v, v))[..., None])


def over(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, 0 where b is 0."""
    return np.where(b == 0, Decimal(0), a / np.where(b == 0, Decimal(1), b))


def triangle(corners: np.ndarray, d: np.ndarray, normals: np.ndarray) -> tuple[Met, ...]:
    """corners (m, 3, 3) seen from the ray's origin, by Cramer's rule; normals (m, 3, 3) at the corners."""
    a, b, c = (corners[:, j] for j in range(3))
    areas = np.stack([dot(d, cross(c, b)), dot(d, cross(a, c)), dot(d, cross(b, a))], axis=1)
    total = areas.sum(axis=1)
    weights = over(areas, total[:, None])
    n = unit(cross(b - a, c - a))
    sh_n = unit((weights[:, :, None] * normals).sum(axis=1))
    hit = (weights >= 0).all(axis=1) & (total != 0)
    return (Met(over(dot(n, a), dot(n, d)), n, sh_n, hit),)


def plane(n: np.ndarray, point: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[Met, ...]:
    n = unit(n)
    slope = dot(n, d)
    return (Met(over(dot(n, point - o), slope), n, n, slope != 0),)


def ball(o: np.ndarray, d: np.ndarray, r: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """(t, whether it is there) of both roots of |o + t d| = r."""
    a, b, c = dot(d, d), dot(o, d), dot(o, o) - r * r
    inside = b * b - a * c
    return tuple((over(-b + side * root(inside), a), (inside >= 0) & (a != 0)) for side in (-1, 1))


def sphere(center: np.ndarray, r: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[Met, ...]:
    f, found = o - center, []
    for t, hit in ball(f, d, r):
        n = unit(f + t[:, None] * d)
        found.append(Met(t, n, n, hit))
    return tuple(found)


def to_quadric(inverse: np.ndarray, shift: np.ndarray, o: np.ndarray, d: np.ndarray) -> Quadric:
    """inverse (m, 3, 3) takes world to object space, shift (m, 3) is added."""
    return Quadric(dot(inverse, o[:, None, :]) + shift, dot(inverse, d[:, None, :]), inverse)


def outwards(q: Quadric, n: np.ndarray) -> np.ndarray:
    """A normal of the unit shape in the world."""
    return unit(dot(np.swapaxes(q.inverse, 1, 2), n[:, None, :]))


def ellipsoid(q: Quadric) -> tuple[Met, ...]:
    found = []
    for t, hit in ball(q.o, q.d, Decimal(1)):
        n = outwards(q, q.o + t[:, None] * q.d)
        found.append(Met(t, n, n, hit))
    return tuple(found)


def cylinder(q: Quadric) -> tuple[Met, ...]:
    flat, found = exactly([1.0, 1.0, 0.0]), []
    for t, hit in ball(q.o * flat, q.d * flat, Decimal(1)):
        p = q.o + t[:, None] * q.d
        n = outwards(q, p * flat)
        found.append(Met(t, n, n, hit & (p[:, 2] >= 0) & (p[:, 2] <= 1)))
    return tuple(found)


def disk(q: Quadric) -> tuple[Met, ...]:
    t = over(-q.o[:, 2], q.d[:, 2])
    p = q.o + t[:, None] * q.d
    n = outwards(q, np.broadcast_to(exactly([0.0, 0.0, 1.0]), p.shape))
    return (Met(t, n, n, (q.d[:, 2] != 0) & (p[:, 0] ** 2 + p[:, 1] ** 2 <= 1)),)


ROUND: dict[str, Callable[[Quadric], tuple[Met, ...]]] = {"Ellipsoids": ellipsoid, "Cylinders": cylinder, "Disks": disk}
