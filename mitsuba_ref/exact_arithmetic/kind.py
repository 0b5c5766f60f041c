"""What the oracle has to be told of a kind of primitive."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.exact_arithmetic.integers import IntegerRay
from mitsuba_ref.exact_arithmetic.root import Root


class Touch(NamedTuple):
    """Something on the ray's way that is no hit: `why` is "edge_on", "degenerate" or "dropped"."""

    why: str
    first: Root | None  # the t where the ray comes to it, and where it leaves it; None: within its box
    last: Root | None


class Met(NamedTuple):
    """What one ray has to do with one primitive."""

    roots: tuple[tuple[Root, str], ...] = ()  # (t, where) for any t, ascending, each once
    touched: tuple[Touch, ...] = ()


NOTHING = Met()

# prims -> (simpler primitives, the number (m,) of the one that each of them is a piece of)
Unfold = Callable[[Any], tuple[Any, np.ndarray]]


def count(prims: Any) -> int:
    """How many primitives the arrays hold: as many as faces, or else as rows."""
    return len(prims.faces if hasattr(prims, "faces") else prims[0])


def all_of(prims: Any) -> np.ndarray:
    return np.ones(count(prims), bool)


class ExactKind(NamedTuple):
    """A kind of packed primitives, read by the names of their fields."""

    # prims -> (low, high) corners (n, 3) of boxes that hold every point of each primitive; infinite where none does
    boxes: Callable[[Any], tuple[np.ndarray, np.ndarray]]

    # (prims, k) -> primitive k in whole numbers
    prepare: Callable[[Any, int], Any]

    # (prepared primitive, ray) -> roots and touches
    meet: Callable[[Any, IntegerRay], Met]

    # (prims, k (m,), o (m, 3), d (m, 3)) -> (m,) bool, False only where ray i has nothing to do with primitive k[i]
    may_meet: Callable[[Any, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None

    # prims -> (n,) bool: all but primitives with numbers that mean nothing, so that no ray can be asked about them
    usable: Callable[[Any], np.ndarray] = all_of

    # prims -> (n,) bool: all but primitives that are left out of every scene, as faces with a corner that is nowhere
    present: Callable[[Any], np.ndarray] = all_of


def below(x: np.ndarray) -> np.ndarray:
    """The next float64 down: a result that was rounded to nearest, rounded down."""
    return np.nextafter(x, -np.inf)


def above(x: np.ndarray) -> np.ndarray:
    return np.nextafter(x, np.inf)
