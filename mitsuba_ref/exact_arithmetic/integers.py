"""From float64 to whole numbers on a common power of two, and vectors of them."""

from collections.abc import Iterable
from typing import NamedTuple

Integers3 = tuple[int, int, int]


class Scaled(NamedTuple):
    """Numbers n[i] 2^-k, exactly."""

    n: tuple[int, ...]
    k: int  # >= 0


class IntegerRay(NamedTuple):
    """The ray o 2^-ko + t d 2^-kd."""

    o: Integers3
    ko: int
    d: Integers3
    kd: int


def scaled(numbers: Iterable[float]) -> Scaled:
    """Finite floats, of any size, denormal or -0.0, on the coarsest power of two <= 1 that holds them all."""
    ratios = [x.as_integer_ratio() for x in numbers]
    k = max(below.bit_length() for _, below in ratios) - 1  # denominators are powers of two
    return Scaled(tuple(above << (k + 1 - below.bit_length()) for above, below in ratios), k)


def integer_ray(o: Iterable[float], d: Iterable[float]) -> IntegerRay:
    (ox, oy, oz), ko = scaled(o)
    (dx, dy, dz), kd = scaled(d)
    return IntegerRay((ox, oy, oz), ko, (dx, dy, dz), kd)


def dot(a: Integers3, b: Integers3) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Integers3, b: Integers3) -> Integers3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def sub(a: Integers3, b: Integers3) -> Integers3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def shifted(a: Integers3, bits: int) -> Integers3:
    """a 2^bits, bits >= 0."""
    return a[0] << bits, a[1] << bits, a[2] << bits
