"""Signed distances between a ray and the outline of a primitive, by exact rational arithmetic.

Each kind that has an outline registers a function with `edge_distances` in its own file (caster/shapes).
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from caster.description.transform import cross, subtract

Vector = Sequence[Fraction]


class EdgeDistance(NamedTuple):
    """Distance of a ray from one piece of an outline."""

    of: str  # such as "edge 0-1"
    inside: float  # > 0 where the ray passes inside of it, < 0 outside, 0 exactly on it
    unit: str  # SCENE_UNITS, or UNIT_RADII for the image of a unit shape


SCENE_UNITS, UNIT_RADII = "scene units", "radii"
EDGE_ON = "edge-on"  # the ray is parallel to a flat primitive, whose outline is then a line


@singledispatch
def edge_distances(prims: Any, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """Distances of the line o + t d from each piece of the outline of primitive k; none without an outline."""
    return ()


def signed_distance(of: str, radius: Fraction, squared: Fraction, unit: str) -> EdgeDistance:
    """The radius minus the square root of a squared distance, rounded once.

    By (r^2 - x) / (r + sqrt(x)): the sign is exact and no digit is lost.
    """
    return EdgeDistance(of, nearest_float((radius * radius - squared) / (radius + sqrt_fraction(squared))), unit)


def exact_object_space_ray(prims: Any, k: int, o: np.ndarray, d: np.ndarray) -> tuple[Vector, Vector]:
    """(o, d) in the space where an image of a unit shape is that shape, by Cramer's rule on to_world."""
    columns = [exact(column) for column in prims.to_world[k].T]
    rows = [cross(columns[1], columns[2]), cross(columns[2], columns[0]), cross(columns[0], columns[1])]
    determinant = dot(columns[0], rows[0])
    away = subtract(exact(o), exact(prims.center[k]))
    f, e = ([dot(row, v) / determinant for row in rows] for v in (away, exact(d)))
    return f, e


def exact(v: np.ndarray) -> Vector:
    """The components as fractions."""
    return [Fraction(x) for x in v.tolist()]


def dot(a: Vector, b: Vector) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def square(a: Vector) -> Fraction:
    return dot(a, a)


# Bits of a square root beyond those of its argument: only the final conversion to float64 rounds noticeably.
SQRT_EXTRA_BITS = 64


def sqrt_fraction(x: Fraction) -> Fraction:
    """The square root within a factor of 1 + 2^-64."""
    size = math.isqrt((x.numerator * x.denominator) << (2 * SQRT_EXTRA_BITS))
    return Fraction(size, x.denominator << SQRT_EXTRA_BITS)


def nearest_float(x: Fraction) -> float:
    """The nearest float64 with the sign of x: never infinite, and 0 only for 0."""
    if x == 0:
        return 0.0
    try:
        near = float(x)
    except OverflowError:
        near = math.inf
    return math.copysign(min(max(abs(near), 5e-324), 1.7976931348623157e308), -1 if x < 0 else 1)
