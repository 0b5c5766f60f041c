"""Exact numbers: integers scaled by a common power of two, and roots of linear and quadratic equations."""

import math
from collections.abc import Iterator
from fractions import Fraction
from functools import total_ordering
from typing import NamedTuple, Union

import numpy as np

Integers3 = tuple[int, int, int]


class IntegerRay(NamedTuple):
    """The ray o 2^-ko + t d 2^-kd."""

    o: Integers3
    ko: int
    d: Integers3
    kd: int

    @property
    def e(self) -> int:
        """t is s 2^e at the point o + s d, in units of 2^-ko."""
        return self.kd - self.ko


class IntegerVectors(NamedTuple):
    """The vectors v[i] 2^-k."""

    v: list[Integers3]
    k: int  # >= 0


def scaled_vectors(rows: np.ndarray) -> IntegerVectors:
    """Finite vectors (n, 3) or (3,) as integers times the largest power of two <= 1 for which all are integers."""
    ratios = [x.as_integer_ratio() for x in rows.ravel().tolist()]
    k = max(below.bit_length() for _, below in ratios) - 1  # denominators are powers of two
    n = [above << (k + 1 - below.bit_length()) for above, below in ratios]
    return IntegerVectors(list(zip(n[::3], n[1::3], n[2::3], strict=True)), k)


def integer_rays(o: np.ndarray, d: np.ndarray) -> Iterator[IntegerRay]:
    """The rays o, d (n, 3), finite, in integers."""
    for origin, direction in zip(o, d, strict=True):
        (x,), ko = scaled_vectors(origin)
        (y,), kd = scaled_vectors(direction)
        yield IntegerRay(x, ko, y, kd)


def dot(a: Integers3, b: Integers3) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Integers3, b: Integers3) -> Integers3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def sub(a: Integers3, b: Integers3) -> Integers3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def shifted(a: Integers3, bits: int) -> Integers3:
    """a 2^bits, bits >= 0."""
    return a[0] << bits, a[1] << bits, a[2] << bits


Number = Union["Root", int, float, Fraction]

FIRST_BITS = 64  # fractional bits of a square root; doubled until both ends round to the same float


def sign(x: int | Fraction) -> int:
    return (x > 0) - (x < 0)


def sign_with_root(a: int, b: int, r: int) -> int:
    """Sign of a + b sqrt(r), r >= 0: if the terms have opposite signs, the larger square decides."""
    first, second = sign(a), sign(b) * (r > 0)
    if first * second >= 0:
        return first or second
    return first * sign(a * a - b * b * r)


def sign_with_roots(a: int, b: int, r: int, c: int, s: int) -> int:
    """Sign of a + b sqrt(r) + c sqrt(s); r, s >= 0.

    Where a and the roots have opposite signs, the larger square decides: that of the roots contains only sqrt(r s).
    """
    sign_of_roots = sign(b * abs(b) * r + c * abs(c) * s)  # from signed squares
    sign_of_a = sign(a)
    if sign_of_a * sign_of_roots >= 0:
        return sign_of_a or sign_of_roots
    # a^2 - (b sqrt(r) + c sqrt(s))^2
    return sign_of_a * sign_with_root(a * a - b * b * r - c * c * s, -2 * b * c, r * s)


@total_ordering
class Root:
    """The real number 2^e (p + q sqrt(r)) / s. Compares exactly with Root, int, float and Fraction."""

    __slots__ = ("e", "p", "q", "r", "s")

    def __init__(self, p: int, q: int = 0, r: int = 0, s: int = 1, e: int = 0) -> None:
        """r >= 0 and s != 0."""
        if s < 0:
            p, q, s = -p, -q, -s
        self.p, self.q, self.r, self.s, self.e = p, (q if r else 0), (r if q else 0), s, e

    @classmethod
    def of(cls, x: int | float | Fraction) -> "Root":
        """A finite number, exactly."""
        above, below = x.as_integer_ratio()
        return cls(above, 0, 0, below)

    def sign(self) -> int:
        """-1, 0 or 1."""
        return sign_with_root(self.p, self.q, self.r)

    def compare(self, other: Number) -> int:
        """The sign of self - other; other may be infinite. Raises ValueError for a NaN."""
        if isinstance(other, float) and math.isinf(other):
            return -1 if other > 0.0 else 1
        if not isinstance(other, Root):
            if not other:
                return self.sign()
            other = Root.of(other)
        e = min(self.e, other.e)
        here, there = other.s << (self.e - e), self.s << (other.e - e)
        p = self.p * here - other.p * there
        if self.r == other.r:
            return sign_with_root(p, self.q * here - other.q * there, self.r)
        return sign_with_roots(p, self.q * here, self.r, -other.q * there, other.r)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Root | int | float | Fraction):
            return NotImplemented
        return self.compare(other) == 0

    def __lt__(self, other: Number) -> bool:
        return self.compare(other) < 0

    def __repr__(self) -> str:
        return f"Root({float(self)!r})"

    def numerators(self, bits: int) -> tuple[int, int]:
        """Integers below and above (p + q sqrt(r)) 2^bits, equal or 1 apart."""
        square = (self.q * self.q * self.r) << (2 * bits)
        w = math.isqrt(square)
        rest = int(w * w != square)
        low = (self.p << bits) + (w if self.q > 0 else -w - rest)
        return low, low + rest

    def __float__(self) -> float:
        """The nearest float64, ties to even; infinite beyond the largest."""
        bits = FIRST_BITS if self.q else 0
        while True:
            low, high = (quotient(n, self.s, self.e - bits) for n in self.numerators(bits))
            if low == high:
                return low + 0.0  # never -0.0
            bits *= 2  # an irrational number is no midpoint of two floats, so this ends

    def off(self, x: float) -> float:
        """|x - self|, rounded once, but at least the smallest float64 unless they are equal.

        inf for an infinite x, NaN for NaN.
        """
        if not math.isfinite(x):
            return abs(x)
        above, below = x.as_integer_ratio()
        e = min(self.e, 0)
        here, there = below << (self.e - e), self.s << -e
        apart = Root(self.p * here - above * there, self.q * here, self.r, self.s * below, e)
        return max(abs(float(apart)), math.ulp(0.0)) if apart.sign() else 0.0


def quotient(above: int, below: int, e: int) -> float:
    """above / below 2^e to the nearest float64; infinite beyond the largest. below > 0."""
    try:
        return (above << e) / below if e >= 0 else above / (below << -e)
    except OverflowError:
        return math.inf if above > 0 else -math.inf
