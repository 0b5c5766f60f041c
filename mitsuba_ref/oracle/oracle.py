"""Exact oracle: the first hit of a ray, computed in integers without rounding, and the index of primitives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.boxes import BoxTree
from mitsuba_ref.oracle.exact_numbers import IntegerRay, Root, integer_rays
from mitsuba_ref.oracle.interface import (
    EXACT_KINDS,
    STAND_INS,
    Contact,
    ExactAnswer,
    ExactHit,
    ExactKind,
    LineIntersections,
    OutsideDomain,
    check_rays,
    lowest_identical,
)

__all__ = ["EXACT_KINDS", "ExactAnswer", "ExactHit", "Oracle", "OutsideDomain", "Root"]


class Oracle:
    """Exact first hits and roots on the packed primitives of one scene."""

    def __init__(self, packed: Any, stand_ins: Sequence[Any] | None = None) -> None:
        """packed: primitives of a scene, as kinds with `prims` and `ids`, and `first`, which ends with their number.

        stand_ins: the arrays that the reference traces (SceneModel.kinds), in place of those of packed.kinds.

        Raises OutsideDomain for a primitive with a number that is not finite (faces are dropped instead), and
        LookupError for a kind without exact arithmetic.
        """
        arrays = [kind.prims for kind in packed.kinds] if stand_ins is None else stand_ins
        ids = [np.asarray(kind.ids) for kind in packed.kinds]
        self.primitives = PrimitiveIndex([part_of(*pair) for pair in zip(arrays, ids, strict=True)])
        self.count = int(packed.first[-1])
        self._always = frozenset() if self.primitives.present.all() else frozenset({"dropped"})

    def first_hit(
        self, o: Iterable[float], d: Iterable[float], t_min: float = 0.0, t_max: float = math.inf
    ) -> ExactAnswer:
        """The first hit of the ray o + t d at t_min < t <= t_max. o, d: three floats each.

        Raises OutsideDomain for a ray that is not finite or has no direction.
        """
        (answer,) = self.first_hits(np.array([[*o]], np.float64), np.array([[*d]], np.float64), t_min, t_max)
        return answer

    def first_hits(
        self, o: np.ndarray, d: np.ndarray, t_min: np.ndarray | float = 0.0, t_max: np.ndarray | float = math.inf
    ) -> list[ExactAnswer]:
        """First hits of rays o, d (n, 3); t_min, t_max: (n,) or one for all. Faster per ray than first_hit.

        Raises OutsideDomain, naming the first ray that is not finite or has no direction.
        """
        o, d = np.asarray(o, np.float64).reshape(-1, 3), np.asarray(d, np.float64).reshape(-1, 3)
        starts, ends = (np.broadcast_to(np.asarray(t, np.float64), len(o)) for t in (t_min, t_max))
        check_rays(o, d, starts, ends)
        candidates = self.primitives.candidates(o, d, starts, ends)
        rays = zip(integer_rays(o, d), starts.tolist(), ends.tolist(), candidates, strict=True)
        return [self._first(ray, (start, end), near) for ray, start, end, near in rays]

    def _first(
        self, ray: IntegerRay, span: tuple[float, float], candidates: Iterable[CandidatePrimitive]
    ) -> ExactAnswer:
        """The first hit among candidates sorted by a lower bound of t."""
        (start, end), best = span, None
        ties: dict[int, tuple[PrimitiveArray, int, str]] = {}
        contacts: list[Contact] = []
        for part, k, near in candidates:
            if best is not None and best < near:
                break
            crossed = part.intersect(k, ray)
            if crossed.contacts:
                contacts += crossed.contacts
            for root in crossed.roots:
                if root[0] > start:
                    t, where = root
                    break
            else:
                continue
            if end != math.inf and t > end:
                continue
            order = -1 if best is None else t.compare(best)
            if order < 0:
                best, ties = t, {}
            if order <= 0:
                ties.setdefault(int(part.ids[k]), (part, k, where))
        flags = self._always
        if contacts:
            flags |= contacts_before(contacts, span, best)
        if any(where == "tangent" for _, _, where in ties.values()):
            flags |= {"tangent"}
        groups = [(where, part.numbers(k)) for part, k, where in ties.values()]
        return ExactAnswer(best, tuple(groups), flags)

    def roots(self, prim: int, o: Iterable[float], d: Iterable[float]) -> tuple[ExactHit, ...]:
        """All roots of primitive number `prim`, at any t, ascending; none for a dropped face.

        Raises OutsideDomain for a ray that is not finite or has no direction, IndexError for an unknown primitive.
        """
        if not 0 <= prim < self.count:
            raise IndexError(f"the scene has primitives 0 to {self.count - 1}, got {prim}")
        line = np.array([[*o]], np.float64), np.array([[*d]], np.float64)
        check_rays(*line, np.zeros(1), np.zeros(1))
        (ray,) = integer_rays(*line)
        pieces = [part.intersect(k, ray) for part, k in self.primitives.numbered(prim)]
        found = sorted((root for piece in pieces for root in piece.roots), key=lambda root: root[0])
        return tuple(ExactHit(prim, t, where) for i, (t, where) in enumerate(found) if i == 0 or t != found[i - 1][0])


def contacts_before(contacts: Iterable[Contact], span: tuple[float, float], best: Root | None) -> frozenset[str]:
    """Reasons of the contacts after t_min and not after the first hit, or t_max without one."""
    end = span[1] if best is None else best
    return frozenset(
        why for why, first, last in contacts if first is None or last is None or (first <= end and last > span[0])
    )


def part_of(prims: Any, ids: np.ndarray) -> PrimitiveArray:
    """The primitives with their exact arithmetic; stand-ins are expanded into primitives that have one."""
    pieces = type(prims) in STAND_INS
    if pieces:
        prims, owner = STAND_INS[type(prims)](prims)
        ids = ids[owner]
    if type(prims) not in EXACT_KINDS:
        raise LookupError(
            f"{type(prims).__name__} has no exact arithmetic: write an ExactKind (mitsuba_ref/oracle/interface.py) "
            "and name it as `exact` in the ErrorModel of the kind, in mitsuba_ref/shapes, which has to be imported"
        )
    lowest = None if pieces else lowest_identical(prims, shading=False)  # pieces of one stand-in share a number
    order = None if lowest is None else np.lexsort((ids, lowest))
    return PrimitiveArray(EXACT_KINDS[type(prims)], prims, ids, {}, lowest, order)


# ---- the index of primitives ----

# Growth of boxes, as a fraction of |o| + their farthest corner: far beyond the rounding of a test.
BOX_MARGIN = 2.0**-44


class PrimitiveArray(NamedTuple):
    """All primitives of one kind, with their exact arithmetic."""

    kind: ExactKind
    prims: Any
    ids: np.ndarray  # (n,) the number of each in the scene
    ready: dict[int, Any]  # prepared primitives, by row
    lowest: np.ndarray | None  # (n,) the lowest row with the same bits, which is tested in its place; None: all differ
    order: np.ndarray | None  # (n,) rows by their lowest one, and among its rows by their numbers

    def numbers(self, k: int) -> np.ndarray:
        """Ascending numbers of all primitives with the bits of row k, the lowest one."""
        if self.lowest is None or self.order is None:
            return self.ids[k : k + 1]
        start, end = np.searchsorted(self.lowest, (k, k + 1), sorter=self.order)
        return self.ids[self.order[start:end]]

    def intersect(self, k: int, ray: IntegerRay) -> LineIntersections:
        if k not in self.ready:
            self.ready[k] = self.kind.prepare(self.prims, k)
        return self.kind.intersect(self.ready[k], ray)


class CandidatePrimitive(NamedTuple):
    """A primitive that a ray may intersect, at no t < near."""

    part: PrimitiveArray
    k: int
    near: float


class PrimitiveIndex:
    """All primitives of a scene, array after array; an index counts through all of them."""

    def __init__(self, parts: Sequence[PrimitiveArray], margin: float = BOX_MARGIN) -> None:
        """Raises OutsideDomain for primitives with numbers that are outside the domain."""
        for part in parts:
            check_usable(part)
        self.parts = tuple(parts)
        self.first = np.cumsum([0, *(len(part.ids) for part in parts)])
        present = [part.kind.present(part.prims) for part in parts]
        self.present = np.concatenate([np.zeros(0, bool), *present])
        tried = self.present.copy()  # one of identical primitives
        for part, first in zip(parts, self.first.tolist(), strict=False):
            if part.lowest is not None:
                tried[first : first + len(part.ids)] &= part.lowest == np.arange(len(part.ids))
        boxes = [part.kind.boxes(part.prims) for part in parts] or [(np.zeros((0, 3)), np.zeros((0, 3)))]
        low, high = map(np.concatenate, zip(*boxes, strict=True)) if len(boxes) > 1 else boxes[0]
        del boxes
        if not tried.all():
            low, high = low[tried], high[tried]
        self.tree = BoxTree(low, high, margin, np.flatnonzero(tried))

    def numbered(self, prim: int) -> Iterator[tuple[PrimitiveArray, int]]:
        """All pieces of primitive number `prim`, as (array, row); none for a face with a corner that is not finite."""
        for part, first in zip(self.parts, self.first.tolist(), strict=False):
            for k in np.flatnonzero(part.ids == prim).tolist():
                if self.present[first + k]:
                    yield part, k

    def candidates(
        self, o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray
    ) -> Iterator[list[CandidatePrimitive]]:
        """For each ray all primitives that it may intersect at t_min < t <= t_max, sorted by `near`."""
        for batch, *pairs in self.tree.crossings(o, d, t_min, t_max):
            kept = self._may_intersect(o, d, pairs[0], pairs[1])
            ray, index, near = (column[kept] for column in pairs)
            order = np.lexsort([index, near, ray])
            part = np.searchsorted(self.first, index, side="right") - 1
            columns = (column[order].tolist() for column in (part, index - self.first[part], near))
            rows = [CandidatePrimitive(self.parts[part], k, near) for part, k, near in zip(*columns, strict=True)]
            ends = np.searchsorted(ray[order], np.arange(batch.start, batch.stop + 1)).tolist()
            for start, end in pairwise(ends):
                yield rows[start:end]

    def _may_intersect(self, o: np.ndarray, d: np.ndarray, ray: np.ndarray, index: np.ndarray) -> np.ndarray:
        kept = np.ones(len(ray), bool)
        for part, first, end in zip(self.parts, self.first, self.first[1:], strict=False):
            rows = np.flatnonzero((index >= first) & (index < end))
            if part.kind.may_intersect is not None and len(rows):
                pairs = index[rows] - first, o[ray[rows]], d[ray[rows]]
                kept[rows] = part.kind.may_intersect(part.prims, *pairs)
        return kept


def check_usable(part: PrimitiveArray) -> None:
    bad = np.flatnonzero(~part.kind.usable(part.prims))
    if len(bad):
        k = int(bad[0])
        raise OutsideDomain(
            f"primitive {part.ids[k]} (row {k} of {type(part.prims).__name__}) must have finite numbers and no "
            f"radius below 0, got {[a[k].tolist() for a in part.prims]}"
        )
