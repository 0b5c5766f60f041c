"""How far inside or outside a primitive's outline a ray passes, with the exact sign: fractions of whole numbers."""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from caster.kernels.triangles import Triangles
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.sphere import Ellipsoids, Spheres

Vector = Sequence[Fraction]


class EdgeDistance(NamedTuple):
    """One piece of an outline."""

    of: str  # such as "edge 0-1"
    inside: float  # > 0 where the ray passes inside of it, < 0 outside, 0 exactly on it
    unit: str  # "scene units", or "radii" of a primitive that is a stretched unit one


SCENE_UNITS, UNIT_RADII = "scene units", "radii"
EDGE_ON = "edge-on"  # the ray runs along a flat primitive: it has no outline to pass inside of


@singledispatch
def edge_distances(prims: Any, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """Every piece of the outline of primitive k, as the line o + t d passes it; none for a kind without one."""
    return ()


@edge_distances.register(Triangles)
def _of_triangle(prims: Triangles, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """Each edge's distance from the ray, line to line."""
    eye, way = exact(o), exact(d)
    corners = [minus(exact(prims.vertices[i]), eye) for i in prims.faces[k]]
    sides = [minus(corners[(i + 1) % 3], corners[i]) for i in range(3)]
    slope = dot(way, cross(sides[0], minus(corners[2], corners[0])))
    if slope == 0:
        return (EdgeDistance(EDGE_ON, 0.0, SCENE_UNITS),)
    found = []
    for i, side in enumerate(sides):
        j = (i + 1) % 3
        function = dot(way, cross(corners[i], corners[j])) * (1 if slope > 0 else -1)
        found.append(
            EdgeDistance(
                f"edge {i}-{j}",
                nearest_float(function / sqrt_fraction(square(cross(way, side)))),
                SCENE_UNITS,
            )
        )
    return tuple(found)


@edge_distances.register(Spheres)
def _of_sphere(prims: Spheres, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """The radius less the distance of the centre from the ray."""
    way = exact(d)
    away = square(cross(minus(exact(o), exact(prims.center[k])), way)) / square(way)
    return (
        EdgeDistance(
            "silhouette", nearest_float(minus_sqrt(Fraction(float(prims.radius[k])), away)), SCENE_UNITS
        ),
    )


@edge_distances.register(Ellipsoids)
def _of_ellipsoid(prims: Ellipsoids, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    f, e = in_object_space(prims, k, o, d)
    away = square(cross(f, e)) / square(e)
    return (EdgeDistance("silhouette", nearest_float(minus_sqrt(Fraction(1), away)), UNIT_RADII),)


@edge_distances.register(Disks)
def _of_disk(prims: Disks, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    f, e = in_object_space(prims, k, o, d)
    if e[2] == 0:
        return (EdgeDistance(EDGE_ON, 0.0, UNIT_RADII),)
    x, y = (f[i] - f[2] / e[2] * e[i] for i in (0, 1))
    return (EdgeDistance("rim", nearest_float(minus_sqrt(Fraction(1), x * x + y * y)), UNIT_RADII),)


@edge_distances.register(Cylinders)
def _of_cylinder(prims: Cylinders, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """The wall's silhouette. Where its ends cut the ray off is in t alone."""
    f, e = in_object_space(prims, k, o, d)
    across = e[0] * e[0] + e[1] * e[1]
    if across == 0:
        return (EdgeDistance("along the axis", 0.0, UNIT_RADII),)
    away = (f[0] * e[1] - f[1] * e[0]) ** 2 / across
    return (EdgeDistance("silhouette", nearest_float(minus_sqrt(Fraction(1), away)), UNIT_RADII),)


def in_object_space(
    prims: Ellipsoids | Disks | Cylinders, k: int, o: np.ndarray, d: np.ndarray
) -> tuple[Vector, Vector]:
    """(o, d) where the primitive is the unit one, by Cramer's rule on to_world: no rounded inverse."""
    columns = [exact(column) for column in prims.to_world[k].T]
    rows = [cross(columns[1], columns[2]), cross(columns[2], columns[0]), cross(columns[0], columns[1])]
    determinant = dot(columns[0], rows[0])
    away = minus(exact(o), exact(prims.center[k]))
    f, e = ([dot(row, v) / determinant for row in rows] for v in (away, exact(d)))
    return f, e


def exact(v: np.ndarray) -> Vector:
    return [Fraction(x) for x in v.tolist()]


def minus(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def dot(a: Vector, b: Vector) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def square(a: Vector) -> Fraction:
    return dot(a, a)


def cross(a: Vector, b: Vector) -> Vector:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


# Digits of a square root beyond float64's 53, so that its rounding is that of the last step alone.
SQRT_EXTRA_BITS = 64


def sqrt_fraction(x: Fraction) -> Fraction:
    """The square root within 2^-BITS of itself."""
    size = math.isqrt((x.numerator * x.denominator) << (2 * SQRT_EXTRA_BITS))
    return Fraction(size, x.denominator << SQRT_EXTRA_BITS)


def minus_sqrt(a: Fraction, x: Fraction) -> Fraction:
    """a - sqrt(x), a > 0, by (a^2 - x) / (a + sqrt(x)): the sign is exact and no digit is lost."""
    return (a * a - x) / (a + sqrt_fraction(x))


def nearest_float(x: Fraction) -> float:
    """The nearest float64; the largest one, or the smallest, where that would change the sign or be infinite."""
    if x == 0:
        return 0.0
    try:
        near = float(x)
    except OverflowError:
        near = math.inf
    return math.copysign(min(max(abs(near), 5e-324), 1.7976931348623157e308), x)
