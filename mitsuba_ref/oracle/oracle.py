"""Exact oracle: the first hit of a ray, computed in integers without rounding."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mitsuba_ref.oracle.boxes import BoxTree
from mitsuba_ref.oracle.exact_numbers import IntegerRay, IntegerVectors, Root, integer_rays, scaled_vectors, shifted
from mitsuba_ref.oracle.interface import EXACT_KINDS, ExactAnswer, ExactHit, ExactKind, OutsideDomain, Roots, check_rays

__all__ = ["EXACT_KINDS", "ExactAnswer", "ExactHit", "Oracle", "OutsideDomain", "Root"]


# Growth of boxes, as a fraction of |o| + their farthest corner: far beyond the rounding of a test, and enough for lines
# from points that float64 rounded (spawned_origins.py).
BOX_MARGIN = 2.0**-36


class PrimitiveArray(NamedTuple):
    """All primitives of one kind, with their exact arithmetic."""

    kind: ExactKind
    prims: Any
    ids: np.ndarray  # (n,) the number of each in the scene
    ready: dict[int, IntegerVectors]  # primitives in integers, by row

    def intersect(self, k: int, ray: IntegerRay) -> Roots:
        if k not in self.ready:
            self.ready[k] = scaled_vectors(self.kind.vectors(self.prims, k))
        vectors, unit = self.ready[k]
        ko = max(unit, ray.ko)  # units no larger than those of either
        return self.kind.intersect(vectors, ko - unit, ray._replace(o=shifted(ray.o, ko - ray.ko), ko=ko))


class CandidatePrimitive(NamedTuple):
    """A primitive that a ray may intersect, at no t < near."""

    part: PrimitiveArray
    k: int
    near: float


class Oracle:
    """Exact first hits and roots on the packed primitives of one scene: all of them, array after array.

    The index of a primitive counts through all arrays.
    """

    def __init__(self, packed: Any) -> None:
        """packed: primitives of a scene, as kinds with `prims` and `ids`.

        Raises OutsideDomain for a primitive with a number that is not finite (faces are dropped instead), and
        LookupError for a kind without exact arithmetic.
        """
        self.packed, parts = packed, []
        for arrays in packed.kinds:
            name, kind = type(arrays.prims).__name__, EXACT_KINDS.get(type(arrays.prims))
            if kind is None:
                raise LookupError(
                    f"{name} has no exact arithmetic: write an ExactKind (mitsuba_ref/oracle/interface.py) and name it "
                    "as `exact` in the ErrorModel of the kind, in mitsuba_ref/shapes, which has to be imported"
                )
            parts.append(PrimitiveArray(kind, arrays.prims, np.asarray(arrays.ids), {}))
            check_usable(parts[-1])
        self.parts = tuple(parts)
        self.first = np.cumsum([0, *(len(part.ids) for part in parts)])
        present = np.ones(self.first[-1], bool)
        for part, first, end in zip(parts, self.first, self.first[1:], strict=False):
            if part.kind.present is not None:
                present[first:end] = part.kind.present(part.prims)
        boxes = [part.kind.boxes(part.prims) for part in parts] or [(np.zeros((0, 3)), np.zeros((0, 3)))]
        low, high = map(np.concatenate, zip(*boxes, strict=True)) if len(boxes) > 1 else boxes[0]
        del boxes
        if not present.all():
            low, high = low[present], high[present]
        self.tree = BoxTree(low, high, BOX_MARGIN, np.flatnonzero(present))

    def first_hit(self, o: ArrayLike, d: ArrayLike, t_min: float = 0.0, t_max: float = math.inf) -> ExactAnswer:
        """The first hit of the ray o + t d at t_min < t <= t_max. o, d: three floats each.

        Raises OutsideDomain for a ray that is not finite or has no direction.
        """
        (answer,) = self.first_hits(o, d, t_min, t_max)
        return answer

    def first_hits(
        self, o: ArrayLike, d: ArrayLike, t_min: np.ndarray | float = 0.0, t_max: np.ndarray | float = math.inf
    ) -> list[ExactAnswer]:
        """First hits of rays o, d (n, 3); t_min, t_max: (n,) or one for all. Faster per ray than first_hit.

        Raises OutsideDomain, naming the first ray that is not finite or has no direction.
        """
        o, d = np.asarray(o, np.float64).reshape(-1, 3), np.asarray(d, np.float64).reshape(-1, 3)
        starts, ends = (np.broadcast_to(np.asarray(t, np.float64), len(o)) for t in (t_min, t_max))
        check_rays(o, d, starts, ends)
        candidates = self.candidates(o, d, starts, ends)
        rays = zip(integer_rays(o, d), starts.tolist(), ends.tolist(), candidates, strict=True)
        return [self._first(ray, (start, end), near) for ray, start, end, near in rays]

    def _first(
        self, ray: IntegerRay, span: tuple[float, float], candidates: Iterable[CandidatePrimitive]
    ) -> ExactAnswer:
        """The first hit among candidates sorted by a lower bound of t."""
        (start, end), best = span, None
        ties: dict[int, str] = {}
        for part, k, near in candidates:
            if best is not None and best < near:
                break
            first = next((root for root in part.intersect(k, ray) if root[0] > start), None)
            if first is None or first[0] > end:
                continue
            t, where = first
            order = -1 if best is None else t.compare(best)
            if order < 0:
                best, ties = t, {}
            if order <= 0:
                ties.setdefault(int(part.ids[k]), where)
        return ExactAnswer(best, tuple(ExactHit(*tie) for tie in sorted(ties.items())))

    def by_part(self, index: np.ndarray) -> Iterator[tuple[PrimitiveArray, np.ndarray, np.ndarray]]:
        """(array, positions in `index` of its primitives, their rows in the array) for each array that has some."""
        for part, first, end in zip(self.parts, self.first, self.first[1:], strict=False):
            places = np.flatnonzero((index >= first) & (index < end))
            if len(places):
                yield part, places, index[places] - first

    def candidates(
        self, o: np.ndarray, d: np.ndarray, t_min: np.ndarray | float, t_max: np.ndarray | float
    ) -> Iterator[list[CandidatePrimitive]]:
        """For each ray all primitives that it may intersect at t_min < t <= t_max, sorted by `near`."""
        for batch, ray, index, near in self.tree.crossings(o, d, t_min, t_max):
            order = np.lexsort([index, near, ray])
            part = np.searchsorted(self.first, index, side="right") - 1
            columns = (column[order].tolist() for column in (part, index - self.first[part], near))
            rows = [CandidatePrimitive(self.parts[part], k, near) for part, k, near in zip(*columns, strict=True)]
            ends = np.searchsorted(ray[order], np.arange(batch.start, batch.stop + 1)).tolist()
            for start, end in pairwise(ends):
                yield rows[start:end]


def check_usable(part: PrimitiveArray) -> None:
    """Raise OutsideDomain for primitives with a number that is not finite, or a negative radius."""
    if part.kind.present is not None:
        return
    finite = np.isfinite(part.kind.vectors(part.prims, slice(None))).all(axis=(1, 2))
    radii = getattr(part.prims, "radius", np.zeros(len(finite))).reshape(len(finite), -1)
    bad = np.flatnonzero(~finite | (radii < 0.0).any(axis=1))
    if len(bad):
        k = int(bad[0])
        raise OutsideDomain(
            f"primitive {part.ids[k]} (row {k} of {type(part.prims).__name__}) must have finite numbers and no "
            f"radius below 0, got {[a[k].tolist() for a in part.prims]}"
        )
