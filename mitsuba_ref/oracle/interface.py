"""Interface of the oracle: exact arithmetic of a primitive kind, and exact answers."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root
from mitsuba_ref.oracle.implicit_surfaces import ImplicitSurface, Vector

Roots = tuple[tuple[Root, str], ...]  # (t, where) of a line and a primitive: any t, ascending, without repetition


class ExactKind(NamedTuple):
    """Exact arithmetic of a kind of packed primitives."""

    # prims -> (low, high) corners (n, 3) of boxes around each primitive; infinite if it has no bounds
    boxes: Callable[[Any], tuple[np.ndarray, np.ndarray]]

    # (prims, k) -> (..., v, 3) all numbers of primitive k, or of several, as v vectors
    vectors: Callable[[Any, Any], np.ndarray]

    # (these vectors in integers, bits that shift them into the units of the ray's origin, ray) -> roots
    intersect: Callable[[Sequence[Integers3], int, IntegerRay], Roots]

    # prims -> (n,) bool: False for primitives that are never hit, such as faces with a corner that is not finite; None:
    # all numbers have to be finite, and radii not negative, else OutsideDomain is raised
    present: Callable[[Any], np.ndarray] | None = None

    # these vectors, in any numbers -> the surface that they lie in; None: which side a point is on is not known
    surface: Callable[[Sequence[Vector]], ImplicitSurface] | None = None


EXACT_KINDS: dict[type, ExactKind] = {}  # by the class of the arrays; filled by mitsuba_ref.shapes


def boxes_around(center: np.ndarray, reach: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) corners center -+ reach, rounded outwards."""
    with np.errstate(over="ignore"):
        return np.nextafter(center - reach, -np.inf), np.nextafter(center + reach, np.inf)


class OutsideDomain(ValueError):  # noqa: N818 - a state of the input, not a fault of the program
    """A ray or a primitive with a number that is not finite, a zero direction, or a negative radius."""


class ExactHit(NamedTuple):
    """A primitive that a ray hits first."""

    prim: int  # its number in the scene
    where: str  # "inside", "edge", "vertex", "rim" or "tangent" (also for a tangent at a rim)


class ExactAnswer(NamedTuple):
    """The first hit of one ray."""

    t: Root | None  # None: a miss
    ties: tuple[ExactHit, ...]  # all primitives that are hit at exactly this t, in the order of their numbers

    @property
    def hit(self) -> bool:
        return self.t is not None

    @property
    def distance(self) -> float:
        """t, rounded; inf on a miss."""
        return np.inf if self.t is None else float(self.t)

    @property
    def prims(self) -> np.ndarray:
        """(m,) numbers of all primitives that are hit at exactly t, ascending."""
        return np.array([hit.prim for hit in self.ties], np.int64)

    @property
    def prim(self) -> int:
        """The lowest of these numbers, -1 on a miss."""
        return self.ties[0].prim if self.ties else -1

    @property
    def where(self) -> str:
        """Where the lowest of them is hit, "" on a miss."""
        return self.ties[0].where if self.ties else ""


def check_rays(o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
    """Raise OutsideDomain, naming the first invalid ray. o, d: (n, 3); t_min, t_max: (n,)."""
    fits = np.isfinite(o).all(axis=1) & np.isfinite(d).all(axis=1) & d.any(axis=1)
    bad = np.flatnonzero(~fits | np.isnan(t_min) | np.isnan(t_max))
    if len(bad):
        i = int(bad[0])
        line = f"o = {o[i].tolist()}, d = {d[i].tolist()}, t_min = {t_min[i]}, t_max = {t_max[i]}"
        raise OutsideDomain(
            f"ray {i}: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got {line}"
        )
