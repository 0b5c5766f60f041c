"""Images of unit shapes under p -> center + to_world p, by the exact inverse of to_world."""

from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.exact_arithmetic.integers import (
    IntegerRay,
    Integers3,
    cross,
    dot,
    scaled,
    shifted,
    sub,
)
from mitsuba_ref.exact_arithmetic.kind import above, below


class Affine(NamedTuple):
    """Centre 2^-k and the rows of adj(to_world 2^k), signs turned so that the determinant is >= 0."""

    center: Integers3
    adjugate: tuple[Integers3, Integers3, Integers3]
    determinant: int
    k: int


class ObjectRay(NamedTuple):
    """A ray seen by a unit shape, magnified: (o + s d) / size, where t = s 2^e."""

    o: Integers3
    d: Integers3
    size: int  # > 0
    e: int


def prepare(prims: Any, k: int) -> Affine:
    numbers = [*prims.center[k].tolist(), *prims.to_world[k].T.ravel().tolist()]
    (x, y, z, ax, ay, az, bx, by, bz, cx, cy, cz), scale = scaled(numbers)
    a, b, c = (ax, ay, az), (bx, by, bz), (cx, cy, cz)  # columns
    rows = cross(b, c), cross(c, a), cross(a, b)
    determinant = dot(a, rows[0])
    if determinant < 0:
        rows = (sub((0, 0, 0), rows[0]), sub((0, 0, 0), rows[1]), sub((0, 0, 0), rows[2]))
    return Affine((x, y, z), rows, abs(determinant), scale)


def seen(by: Affine, ray: IntegerRay) -> ObjectRay:
    """inverse = adjugate 2^k / determinant, so that adjugate (o - center) has the unit determinant 2^(scale - k)."""
    scale = max(by.k, ray.ko)
    away = sub(shifted(ray.o, scale - ray.ko), shifted(by.center, scale - by.k))
    x, y, z = by.adjugate
    o, d = (dot(x, away), dot(y, away), dot(z, away)), (dot(x, ray.d), dot(y, ray.d), dot(z, ray.d))
    return ObjectRay(o, d, by.determinant << (scale - by.k), ray.kd - scale)


# A sum of three magnitudes and this product pass three roundings, each down by at most 2^-53 of it.
ROUNDED_UP = 1.0 + 8 * 2.0**-53


def boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Around the image of the cube from -1 to 1."""
    with np.errstate(over="ignore"):
        reach = np.abs(prims.to_world).sum(axis=2) * ROUNDED_UP
        return below(prims.center - reach), above(prims.center + reach)


def flat_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Around the image of the square from -1 to 1 at z = 0."""
    with np.errstate(over="ignore"):
        reach = np.abs(prims.to_world[:, :, :2]).sum(axis=2) * ROUNDED_UP
        return below(prims.center - reach), above(prims.center + reach)


def tube_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Around that square as it moves from z = 0 to z = 1."""
    axis = prims.to_world[:, :, 2]
    with np.errstate(over="ignore"):
        reach = np.abs(prims.to_world[:, :, :2]).sum(axis=2) * ROUNDED_UP
        low, high = below(prims.center + np.minimum(axis, 0.0)), above(prims.center + np.maximum(axis, 0.0))
        return below(low - reach), above(high + reach)


def usable(prims: Any) -> np.ndarray:
    return np.isfinite(prims.center).all(axis=1) & np.isfinite(prims.to_world).all(axis=(1, 2))
