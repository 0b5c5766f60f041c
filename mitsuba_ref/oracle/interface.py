"""Exact kinds: what a primitive kind supplies to the oracle, and what the oracle returns."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Root


class Contact(NamedTuple):
    """A contact of a ray with a primitive that is no hit: `why` is "edge_on", "degenerate" or "dropped"."""

    why: str
    first: Root | None  # the interval of t; None: anywhere within its box
    last: Root | None


class LineIntersections(NamedTuple):
    """Intersections of one line with one primitive."""

    roots: tuple[tuple[Root, str], ...] = ()  # (t, where) for any t, ascending, each once
    contacts: tuple[Contact, ...] = ()


NO_INTERSECTION = LineIntersections()

# prims -> (simpler primitives, the number (m,) of the one that each of them is a piece of)
ExpandStandIns = Callable[[Any], tuple[Any, np.ndarray]]


def primitive_count(prims: Any) -> int:
    """How many primitives the arrays hold: as many as faces, or else as rows."""
    return len(prims.faces if hasattr(prims, "faces") else prims[0])


def all_true(prims: Any) -> np.ndarray:
    return np.ones(primitive_count(prims), bool)


class ExactKind(NamedTuple):
    """A kind of packed primitives, read by the names of their fields."""

    # prims -> (low, high) corners (n, 3) of boxes that hold every point of each primitive; infinite where none does
    boxes: Callable[[Any], tuple[np.ndarray, np.ndarray]]

    # (prims, k) -> primitive k in whole numbers
    prepare: Callable[[Any, int], Any]

    # (prepared primitive, ray) -> roots and touches
    intersect: Callable[[Any, IntegerRay], LineIntersections]

    # (prims, k (m,), o (m, 3), d (m, 3)) -> (m,) bool, False only where ray i surely misses primitive k[i]
    may_intersect: Callable[[Any, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None

    # prims -> (n,) bool: all but primitives with numbers that mean nothing, which no ray can be intersected with
    usable: Callable[[Any], np.ndarray] = all_true

    # prims -> (n,) bool: all but primitives that are left out of every scene, as faces with a corner that is nowhere
    present: Callable[[Any], np.ndarray] = all_true


EXACT_KINDS: dict[type, ExactKind] = {}  # by the class of their arrays; mitsuba_ref.shapes registers them
STAND_INS: dict[type, ExpandStandIns] = {}  # by the class of the arrays that stand in for a kind


def register_exact(
    arrays: type, exact: ExactKind | None, stand_ins: Mapping[type, ExpandStandIns] | None = None
) -> None:
    """Add the exact arithmetic of a kind, and of arrays that stand in for it."""
    if exact is not None:
        EXACT_KINDS[arrays] = exact
    STAND_INS.update(stand_ins or {})


def next_below(x: np.ndarray) -> np.ndarray:
    """The next float64 down: a result that was rounded to nearest, rounded down."""
    return np.nextafter(x, -np.inf)


def next_above(x: np.ndarray) -> np.ndarray:
    return np.nextafter(x, np.inf)


class OutsideDomain(ValueError):  # noqa: N818 - a state of the input, not a fault of the program
    """A ray or a primitive with a number that is not finite, a direction of no length, a radius below 0."""


@dataclass(frozen=True)
class ExactHit:
    """One root of one primitive."""

    prim: int  # its number in the scene
    t: Root
    where: str  # "inside", "edge", "vertex", "rim" or "tangent"; a tangent at a rim is "tangent"


@dataclass(frozen=True)
class ExactAnswer:
    """The first hit of one ray."""

    t: Root | None  # None: a miss
    ties: tuple[ExactHit, ...]  # all hits with exactly this t, by prim

    # Contacts along the ray, not later than t: "edge_on" (it runs along a flat primitive or a cylinder's wall),
    # "degenerate" (it touches a triangle without area, or the box of a primitive without an inverse), "dropped" (it
    # would have hit a face that is too large; or some face of the scene is nowhere); and "tangent", if a hit is one.
    flags: frozenset[str]

    @property
    def hit(self) -> bool:
        return self.t is not None

    @property
    def prim(self) -> int:
        """The lowest number of a primitive that is hit there, -1 on a miss."""
        return self.ties[0].prim if self.ties else -1


def check_rays(o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
    """Raise OutsideDomain, naming the first of the rays (n, 3), (n, 3), (n,), (n,) that is outside the domain."""
    fits = np.isfinite(o).all(axis=1) & np.isfinite(d).all(axis=1) & (d != 0.0).any(axis=1)
    bad = np.flatnonzero(~fits | np.isnan(t_min) | np.isnan(t_max))
    if len(bad):
        i = int(bad[0])
        line = f"o = {o[i].tolist()}, d = {d[i].tolist()}, t_min = {t_min[i]}, t_max = {t_max[i]}"
        raise OutsideDomain(
            f"ray {i}: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got {line}"
        )
