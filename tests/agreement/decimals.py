"""Vectors of decimals: slow, and good to 80 digits."""

from decimal import Context, Decimal
from typing import Any

import numpy as np

DIGITS = Context(prec=80)


def exactly(numbers: Any) -> Any:
    """Floats of any shape as decimals, not rounded."""
    return np.array([Decimal(float(x)) for x in np.ravel(numbers)]).reshape(np.shape(numbers))


def dot(a: Any, b: Any) -> Decimal:
    return sum((x * y for x, y in zip(a, b, strict=True)), Decimal(0))


def norm(a: Any) -> Decimal:
    return dot(np.ravel(a), np.ravel(a)).sqrt()


def size(*vectors: Any) -> Decimal:
    """The largest component; as good as a length where a small factor does not matter."""
    return max(abs(x) for vector in vectors for x in vector)


def cross(a: Any, b: Any) -> Any:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def determinant(a: Any, b: Any, c: Any) -> Decimal:
    return dot(a, cross(b, c))


def inverse(m: Any) -> Any:
    """Of a 3x3 matrix, by Cramer's rule."""
    a, b, c = m
    return np.array([cross(b, c), cross(c, a), cross(a, b)]).T / determinant(a, b, c)
