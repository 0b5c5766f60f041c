"""Vectors of eight float64, since LLVM does not vectorise short loops by itself.

In plain Python a vector is a PlainVector; compiled, each function here, and +, - and * of vectors, is one or a few
instructions (caster/jit/vector_intrinsics.py). A number may stand for a vector of equal ones.
"""

from typing import Any

import numpy as np

from caster.jit.kernel_cache import COMPILED

LANES = 8 if COMPILED else 1
"""The float64 values in a register of AVX-512. Plain Python gains nothing by several at once."""

CHILDREN = 8
"""Boxes of a tree node, which are tested at once."""

ALL_LANES = (1 << LANES) - 1
"""A mask of all lanes."""

Vector = Any


class PlainVector(np.ndarray):
    """A vector in plain Python: float64 numbers that overflow without a warning, as in machine code."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        with np.errstate(all="ignore"):
            return getattr(ufunc, method)(*map(np.asarray, inputs), **options).view(PlainVector)


def load_lanes(a: Any, i: Any) -> Vector:
    """a.reshape(-1)[i:i + LANES] as float64."""
    return _loaded(a, i, LANES)


def load_children(a: Any, i: Any) -> Vector:
    """a.reshape(-1)[i:i + CHILDREN] as float64."""
    return _loaded(a, i, CHILDREN)


def _loaded(a: Any, i: Any, count: int) -> Vector:
    return a.reshape(-1)[int(i) : int(i) + count].astype(np.float64).view(PlainVector)


def store(v: Vector, a: Any, i: Any) -> None:
    """Write a vector to a[i:]."""
    a[int(i) : int(i) + len(v)] = v


def splat(x: float) -> Vector:
    """LANES times x."""
    return np.full(LANES, x).view(PlainVector)


def larger(v: Vector, w: Vector) -> Vector:
    """v where it is greater, else w."""
    return _chosen(v > w, v, w)


def lesser(v: Vector, w: Vector) -> Vector:
    """v where it is less, else w."""
    return _chosen(v < w, v, w)


def bits_below(v: Vector, w: Vector) -> int:
    """Mask of the lanes with v < w; lane 0 is the lowest bit."""
    return _packed(v < w)


def bits_up_to(v: Vector, w: Vector) -> int:
    """Mask of the lanes with v <= w."""
    return _packed(v <= w)


def _packed(flags: Any) -> int:
    return int(np.packbits(flags, bitorder="little")[0])


def select(bits: int, v: Vector, w: Vector) -> Vector:
    """v where the lane's bit is set, else w."""
    return _chosen([bits >> n & 1 for n in range(LANES)], v, w)


def _chosen(flags: Any, v: Vector, w: Vector) -> Vector:
    found: Any = np.where(flags, v, w)
    return found.view(PlainVector)


def least(v: Vector) -> float:
    """The least number of a vector."""
    return float(min(v))


def largest(v: Vector) -> float:
    return float(max(v))


def lowest_bit(mask: int) -> int:
    """The index of the lowest bit that is set in a mask, which is not 0."""
    return (mask & -mask).bit_length() - 1


def prefetch(rows: Any, k: Any) -> None:
    """Load the cache line of row k of an array, if there is one, since it is read soon."""


def gather_corners(rows: Any, faces: Any, lanes: Any, numbers: Any, into: Any, step: Any) -> None:
    """Write the corners of LANES faces (f, 3), rows of `rows` (v, 3), coordinate by coordinate.

    lanes has the numbers of the faces from `numbers` on; coordinate i of corner c goes to `into` + (3 c + i) `step` on.
    """
    for n in range(LANES):
        for c in range(3):
            for i in range(3):
                lanes[into + (3 * c + i) * step + n] = rows[faces[int(lanes[numbers + n]), c], i]
