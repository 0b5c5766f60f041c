"""Interface of the oracle: exact arithmetic of a primitive kind, and exact answers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Root


class Contact(NamedTuple):
    """A contact of a ray with a primitive that is not a hit. why: "edge_on", "degenerate" or "dropped"."""

    why: str
    first: Root | None  # the interval of t; None: anywhere within the primitive's box
    last: Root | None


class LineIntersections(NamedTuple):
    """Intersections of one line with one primitive."""

    roots: tuple[tuple[Root, str], ...] = ()  # (t, where) for any t, ascending, without repetition
    contacts: tuple[Contact, ...] = ()


NO_INTERSECTION = LineIntersections()

# prims -> (primitives with exact arithmetic, the row (m,) of prims that each of them is a piece of)
ExpandStandIns = Callable[[Any], tuple[Any, np.ndarray]]


def primitive_count(prims: Any) -> int:
    """Number of primitives in the arrays: of faces, or else of rows."""
    return len(prims.faces if hasattr(prims, "faces") else prims[0])


def all_true(prims: Any) -> np.ndarray:
    return np.ones(primitive_count(prims), bool)


class ExactKind(NamedTuple):
    """Exact arithmetic of a kind of packed primitives."""

    # prims -> (low, high) corners (n, 3) of boxes around each primitive; infinite if it has no bounds
    boxes: Callable[[Any], tuple[np.ndarray, np.ndarray]]

    # (prims, k) -> primitive k in integers
    prepare: Callable[[Any, int], Any]

    # (prepared primitive, ray) -> roots and contacts
    intersect: Callable[[Any, IntegerRay], LineIntersections]

    # (prims, k (m,), o (m, 3), d (m, 3)) -> (m,) bool, False only if ray i certainly misses primitive k[i]
    may_intersect: Callable[[Any, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None

    # prims -> (n,) bool: False for primitives with invalid numbers, for which the oracle raises OutsideDomain
    usable: Callable[[Any], np.ndarray] = all_true

    # prims -> (n,) bool: False for primitives that are never hit, such as faces with a corner that is not finite
    present: Callable[[Any], np.ndarray] = all_true

    # (prims, k, AsVector) -> the ImplicitSurface that primitive k lies in; None: which side a point is on is not known
    surface: Callable[[Any, Any, Any], Any] | None = None


EXACT_KINDS: dict[type, ExactKind] = {}  # by the class of the arrays; filled by mitsuba_ref.shapes
STAND_INS: dict[type, ExpandStandIns] = {}  # by the class of the stand-in's arrays


def register_exact(
    arrays: type, exact: ExactKind | None, stand_ins: Mapping[type, ExpandStandIns] | None = None
) -> None:
    """Add the exact arithmetic of a kind, and functions that expand its stand-ins."""
    if exact is not None:
        EXACT_KINDS[arrays] = exact
    STAND_INS.update(stand_ins or {})


def next_below(x: np.ndarray) -> np.ndarray:
    """The next float64 down: a lower bound of the exact value that was rounded to x."""
    return np.nextafter(x, -np.inf)


def next_above(x: np.ndarray) -> np.ndarray:
    return np.nextafter(x, np.inf)


class OutsideDomain(ValueError):  # noqa: N818 - a state of the input, not a fault of the program
    """A ray or a primitive with a number that is not finite, a zero direction, or a negative radius."""


@dataclass(frozen=True)
class ExactHit:
    """A hit of one primitive."""

    prim: int  # its number in the scene
    t: Root
    where: str  # "inside", "edge", "vertex", "rim" or "tangent" (also for a tangent at a rim)


@dataclass(frozen=True, eq=False)
class ExactAnswer:
    """The first hit of one ray."""

    t: Root | None  # None: a miss

    # (where, ascending numbers) of the primitives that are hit at exactly this t, together if they are identical
    groups: tuple[tuple[str, np.ndarray], ...]

    # Contacts along the ray up to t: "edge_on" (within a flat primitive or a cylinder's wall), "degenerate" (a triangle
    # without area, or the box of a primitive whose matrix is singular), "dropped" (a face that is too large; or some
    # face of the scene has a corner that is not finite); and "tangent", if a hit is one.
    flags: frozenset[str]

    @property
    def hit(self) -> bool:
        return self.t is not None

    @property
    def prims(self) -> np.ndarray:
        """(m,) numbers of all primitives that are hit at exactly t, ascending."""
        return np.sort(np.concatenate([np.zeros(0, np.int64), *(prims for _, prims in self.groups)]))

    @property
    def prim(self) -> int:
        """The lowest of these numbers, -1 on a miss."""
        return min((int(prims[0]) for _, prims in self.groups), default=-1)

    @property
    def where(self) -> str:
        """Where the lowest of them is hit, "" on a miss."""
        return min(self.groups, key=lambda group: int(group[1][0]), default=("", None))[0]

    @property
    def ties(self) -> list[ExactHit]:
        """All hits at exactly t, by prim."""
        assert self.t is not None or not self.groups
        found = sorted((int(prim), where) for where, prims in self.groups for prim in prims)
        return [ExactHit(prim, self.t, where) for prim, where in found if self.t is not None]


def check_rays(o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
    """Raise OutsideDomain, naming the first invalid ray. o, d: (n, 3); t_min, t_max: (n,)."""
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
    """(n,) lowest row with the same bits as each primitive, also in the arrays `more`; None if all differ.

    shading: compare all arrays of vertices and faces, not only positions. Equal numbers with different bits, or corners
    in another order, make a different primitive.
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
    some = np.flatnonzero(np.isin(code, again))  # rows with equal hashes, whose bits are compared
    bits = [_bits(array)[prims.faces[some]].reshape(len(some), -1) for array in corners]
    bits += [_bits(array[some]) for array in rows]
    whole = np.ascontiguousarray(np.hstack([column.astype(np.uint64) for column in bits]))
    _, first, member = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    lowest[some] = some[first[member.ravel()]]
    return lowest if (lowest != np.arange(len(lowest))).any() else None


def _arrays_of(prims: Any, shading: bool) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """(arrays of vertices, arrays of primitives); None if some array is neither.

    If a mesh has as many vertices as faces, arrays count as both.
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
    """(n, c) unsigned integers with the same bits."""
    flat = np.ascontiguousarray(array).reshape(len(array), int(np.prod(array.shape[1:])))
    return flat.view(f"u{flat.dtype.itemsize}")


def _mixed(code: np.ndarray, array: np.ndarray) -> np.ndarray:
    """(n,) hashes of `code` (n,) and the rows of an array."""
    for column in _bits(array).T:
        code = (code ^ column) * HASH_FACTOR
        code ^= code >> HASH_SHIFT
    return code
