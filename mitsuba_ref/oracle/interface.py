"""Exact kinds: what a primitive kind supplies to the oracle, and what the oracle returns."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, overload

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


class TieSet(Sequence[ExactHit]):
    """All hits of one ray at exactly one t, by prim; of identical primitives, each is made when it is asked for."""

    __slots__ = ("_groups", "_t")

    def __init__(self, t: Root, groups: Sequence[tuple[str, np.ndarray]]) -> None:
        """groups: (where, their numbers, ascending) of identical primitives; no number stands in two of them."""
        self._t, self._groups = t, groups

    @property
    def prims(self) -> np.ndarray:
        """(m,) ascending."""
        return np.sort(np.concatenate([prims for _, prims in self._groups]))

    @overload
    def __getitem__(self, place: int) -> ExactHit: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[ExactHit]: ...
    def __getitem__(self, place: int | slice) -> ExactHit | Sequence[ExactHit]:
        if place == 0:
            where, prims = min(self._groups, key=lambda group: int(group[1][0]))
            return ExactHit(int(prims[0]), self._t, where)
        found = sorted((int(prim), where) for where, prims in self._groups for prim in prims)
        if isinstance(place, slice):
            return tuple(ExactHit(prim, self._t, where) for prim, where in found[place])
        return ExactHit(found[place][0], self._t, found[place][1])

    def __iter__(self) -> Iterator[ExactHit]:
        return iter(self[:])

    def __len__(self) -> int:
        return sum(len(prims) for _, prims in self._groups)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))


def tied_prims(answer: "ExactAnswer") -> np.ndarray:
    """(m,) numbers of all primitives that are hit first, ascending."""
    ties = answer.ties
    return ties.prims if isinstance(ties, TieSet) else np.array([hit.prim for hit in ties], np.int64)


@dataclass(frozen=True)
class ExactAnswer:
    """The first hit of one ray."""

    t: Root | None  # None: a miss
    ties: Sequence[ExactHit]  # all hits with exactly this t, by prim

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
    fits = np.logical_and.reduce(np.isfinite([*o.T, *d.T])) & np.logical_or.reduce([*(d != 0.0).T])
    bad = np.flatnonzero(~fits | np.isnan(t_min) | np.isnan(t_max))
    if len(bad):
        i = int(bad[0])
        line = f"o = {o[i].tolist()}, d = {d[i].tolist()}, t_min = {t_min[i]}, t_max = {t_max[i]}"
        raise OutsideDomain(
            f"ray {i}: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got {line}"
        )


# ---- identical primitives: the same bits in every array

HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # odd: the product is a permutation of all 64-bit numbers
HASH_SHIFT = np.uint64(29)


def lowest_identical(prims: Any, more: Sequence[np.ndarray] = (), *, shading: bool) -> np.ndarray | None:
    """(n,) of each primitive the lowest row with the same bits, and the same in the arrays `more`; None if all differ.

    shading: arrays of vertices other than their positions count, and those of faces. Numbers that are equal without
    having the same bits, and corners in another order, make another primitive.
    """
    found = _arrays_of(prims, shading)
    if found is None:
        return None
    corners, rows = found[0], [*found[1], *more]
    code = np.zeros(primitive_count(prims), np.uint64)
    for array in corners:
        of_vertex = _mixed(np.zeros(len(array), np.uint64), array)
        for corner in prims.faces.T:
            code = _mixed(code, of_vertex[corner])
    for array in rows:
        code = _mixed(code, array)
    ordered = np.sort(code)
    again = ordered[1:][ordered[1:] == ordered[:-1]]
    if not len(again):
        return None
    lowest = np.arange(len(code))
    some = np.flatnonzero(np.isin(code, again))  # the only ones that may be identical: all bits decide
    bits = [_bits(array)[prims.faces[some]].reshape(len(some), -1) for array in corners]
    bits += [_bits(array[some]) for array in rows]
    whole = np.ascontiguousarray(np.hstack([column.astype(np.uint64) for column in bits]))
    _, first, member = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    lowest[some] = some[first[member.ravel()]]
    return lowest if (lowest != np.arange(len(lowest))).any() else None


def _arrays_of(prims: Any, shading: bool) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """(arrays of vertices, arrays of primitives), None where some array is of neither.

    Where a mesh has as many vertices as faces, an array counts as both.
    """
    if not hasattr(prims, "faces"):
        arrays, count = list(prims), primitive_count(prims)
        return ([], arrays) if all(len(array) == count for array in arrays) else None
    if not shading:
        return [prims.vertices], []
    arrays = [array for name, array in prims._asdict().items() if name != "faces"]
    of_vertices = [array for array in arrays if len(array) == len(prims.vertices)]
    of_faces = [array for array in arrays if len(array) == len(prims.faces)]
    known = {len(prims.vertices), len(prims.faces)}
    return (of_vertices, of_faces) if all(len(array) in known for array in arrays) else None


def _bits(array: np.ndarray) -> np.ndarray:
    """(n, c) whole numbers of the same bits."""
    flat = np.ascontiguousarray(array).reshape(len(array), int(np.prod(array.shape[1:])))
    return flat.view(f"u{flat.dtype.itemsize}")


def _mixed(code: np.ndarray, array: np.ndarray) -> np.ndarray:
    """(n,) a hash of a hash and each row of an array; wraps around."""
    for column in _bits(array).T:
        code = (code ^ column) * HASH_FACTOR
        code ^= code >> HASH_SHIFT
    return code
