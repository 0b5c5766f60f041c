"""Vectors as tuples of three floats."""

import math
from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import Vec3

MISS = math.inf


@jit
def row(a: Any, k: int) -> Vec3:
    return a[k, 0], a[k, 1], a[k, 2]


@jit
def vector(a: Any) -> Vec3:
    return a[0], a[1], a[2]


@jit
def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def add(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@jit
def sub(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit
def along(o: Vec3, t: float, d: Vec3) -> Vec3:
    return o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]


@jit
def scaled(s: float, a: Vec3) -> Vec3:
    return s * a[0], s * a[1], s * a[2]


@jit
def cross(a: Vec3, b: Vec3) -> Vec3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


# Between these no square has lost bits to underflow and no sum of squares overflows. A power of two, which is
# exact, brings all other vectors there: from below 2^-450, down to the smallest number, or from above 2^499.
SMALLEST_SQUARE, LARGEST_SQUARE = 2.0**-900, 2.0**1000
UP, DOWN = 2.0**600, 2.0**-600


@jit
def unit(a: Vec3) -> Vec3:
    """a / |a|, or a itself where it is zero."""
    square = dot(a, a)
    if square < SMALLEST_SQUARE or square > LARGEST_SQUARE:
        a = scaled(UP if square < SMALLEST_SQUARE else DOWN, a)
        square = dot(a, a)
    if square == 0.0:
        return a
    length = math.sqrt(square)
    return a[0] / length, a[1] / length, a[2] / length


@jit
def turned(m: Any, k: int, v: Vec3) -> Vec3:
    """The 3x3 matrix m[k] times v."""
    return (
        m[k, 0, 0] * v[0] + m[k, 0, 1] * v[1] + m[k, 0, 2] * v[2],
        m[k, 1, 0] * v[0] + m[k, 1, 1] * v[1] + m[k, 1, 2] * v[2],
        m[k, 2, 0] * v[0] + m[k, 2, 1] * v[1] + m[k, 2, 2] * v[2],
    )


@jit
def turned_back(m: Any, k: int, v: Vec3) -> Vec3:
    """The transpose of m[k] times v: how a normal travels the way that m undoes."""
    return (
        m[k, 0, 0] * v[0] + m[k, 1, 0] * v[1] + m[k, 2, 0] * v[2],
        m[k, 0, 1] * v[0] + m[k, 1, 1] * v[1] + m[k, 2, 1] * v[2],
        m[k, 0, 2] * v[0] + m[k, 1, 2] * v[1] + m[k, 2, 2] * v[2],
    )


@jit
def angle_fraction(y: float, x: float) -> float:
    """atan2(y, x) as a fraction of a turn in [0, 1)."""
    turn = math.atan2(y, x) / (2.0 * math.pi)
    return turn + 1.0 if turn < 0.0 else turn
