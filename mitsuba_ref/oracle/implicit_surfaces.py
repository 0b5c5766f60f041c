"""Surfaces as zeros of polynomials, in exact numbers or in float64 with running error bounds, by the same formulas."""

from __future__ import annotations

from fractions import Fraction
from functools import reduce
from operator import add, mul
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import dot, sub

UNIT_ROUNDOFF, SMALLEST = 2.0**-53, 2.0**-1074

# An error bound is itself rounded, once for each of its operations: fewer than 2^12 in any formula here, each by 2^-53.
BOUND_ROUNDING = 1.0 + 2.0**-40


class Approximate:
    """Numbers (m,) of float64 with bounds on their errors; every operation adds its rounding to the bounds.

    Source: running error analysis, in Higham, Accuracy and Stability of Numerical Algorithms, section 3.3.
    """

    __slots__ = ("error", "value")

    def __init__(self, value: np.ndarray, error: np.ndarray | float = 0.0) -> None:
        self.value, self.error = value, error

    def __add__(self, other: Approximate) -> Approximate:
        return rounded(self.value + other.value, self.error + other.error)

    def __sub__(self, other: Approximate) -> Approximate:
        return rounded(self.value - other.value, self.error + other.error)

    def __mul__(self, other: Approximate) -> Approximate:
        error = np.abs(self.value) * other.error + self.error * (np.abs(other.value) + other.error)
        return rounded(self.value * other.value, error)

    def sign(self) -> np.ndarray:
        """(m,) 1 or -1 where the exact number has that sign for certain, else 0."""
        bound = self.error * BOUND_ROUNDING
        return (self.value > bound).astype(np.int8) - (self.value < -bound)


def rounded(value: np.ndarray, error: np.ndarray | float) -> Approximate:
    return Approximate(value, error + (UNIT_ROUNDOFF * np.abs(value) + SMALLEST))


Vector = tuple[Any, ...]  # of three numbers that can be added, subtracted and multiplied


def approximate_vector(columns: np.ndarray) -> Vector:
    """The columns of (m, c)."""
    return tuple(map(Approximate, np.ascontiguousarray(columns.T)))


def exact_vector(numbers: np.ndarray) -> Vector:
    return tuple(map(Fraction, numbers.tolist()))


class ImplicitSurface(NamedTuple):
    """With linear forms y_i(x) = rows_i . (x - origin): flat, y_0 = 0; or curved, sum y_i^2 = size^2, and convex."""

    origin: Vector
    rows: tuple[Vector, ...] = ()  # none: the coordinates themselves
    size: Any = None  # None: flat
    corners: tuple[Vector, ...] = ()  # of a triangle

    @property
    def curved(self) -> bool:
        return self.size is not None

    def value(self, x: Vector) -> Any:
        """Positive on one side of the surface, outside of a curved one, and negative on the other."""
        y = self._forms(sub(x, self.origin))
        return _inner(y, y) - self.size * self.size if self.curved else y[0]

    def slope(self, x: Vector, d: Vector) -> Any:
        """Half of the derivative of `value` at x along d; all of it if flat."""
        z = self._forms(d)
        return _inner(self._forms(sub(x, self.origin)), z) if self.curved else z[0]

    def _forms(self, v: Vector) -> Vector:
        return tuple(dot(row, v) for row in self.rows) or v


def _inner(a: Vector, b: Vector) -> Any:
    return reduce(add, map(mul, a, b))
