"""All primitives of a scene in one list, and which of them a ray may have to do with."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.exact_arithmetic.answers import OutsideDomain
from mitsuba_ref.exact_arithmetic.box_tree import RAYS_AT_ONCE, BoxTree, Passed, Rays
from mitsuba_ref.exact_arithmetic.integers import IntegerRay
from mitsuba_ref.exact_arithmetic.kind import ExactKind, Met


class Part(NamedTuple):
    """All primitives of one kind."""

    kind: ExactKind
    prims: Any
    ids: np.ndarray  # (n,) the number of each in the scene
    ready: dict[int, Any]  # those that were asked before, in whole numbers

    def meet(self, k: int, ray: IntegerRay) -> Met:
        if k not in self.ready:
            self.ready[k] = self.kind.prepare(self.prims, k)
        return self.kind.meet(self.ready[k], ray)


class Candidate(NamedTuple):
    """A primitive that one ray may meet, but not at any t < near."""

    part: Part
    k: int
    near: float


class Primitives:
    """Parts one after the other; a place is a number in this list."""

    def __init__(self, parts: Sequence[Part]) -> None:
        """Raises OutsideDomain for primitives that no ray can be asked about."""
        for part in parts:
            refuse_unusable(part)
        self.parts = tuple(parts)
        self.first = np.cumsum([0, *(len(part.ids) for part in parts)])
        present = [part.kind.present(part.prims) for part in parts]
        self.present = np.concatenate([np.zeros(0, bool), *present])
        boxes = [(np.zeros((0, 3)), np.zeros((0, 3))), *(part.kind.boxes(part.prims) for part in parts)]
        low, high = (np.concatenate(bounds) for bounds in zip(*boxes, strict=True))
        bounded = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        self.boxed = np.flatnonzero(self.present & bounded)  # places
        self.boundless = np.flatnonzero(self.present & ~bounded)  # places of those that any ray may meet
        self.tree = BoxTree(low[self.boxed], high[self.boxed])

    def numbered(self, prim: int) -> Iterator[tuple[Part, int]]:
        """All pieces of primitive number `prim`; none for a face that is nowhere, or a number that is none."""
        for part, first in zip(self.parts, self.first.tolist(), strict=False):
            for k in np.flatnonzero(part.ids == prim).tolist():
                if self.present[first + k]:
                    yield part, k

    def candidates(self, rays: Rays) -> Iterator[list[Candidate]]:
        """For each ray what it may meet at t_min < t <= t_max, in the order of `near`; never too few."""
        for start in range(0, rays.o.shape[1], RAYS_AT_ONCE):
            yield from self._candidates(Rays(*(a[..., start : start + RAYS_AT_ONCE] for a in rays)))

    def _candidates(self, rays: Rays) -> Iterator[list[Candidate]]:
        passed, count = self.tree.passed(rays), rays.o.shape[1]
        if passed is None:
            for half in (slice(None, count // 2), slice(count // 2, None)):
                yield from self._candidates(Rays(*(a[..., half] for a in rays)))
            return
        ray, place, near = self._pairs(rays, passed)
        order = np.lexsort([place, near, ray])
        part = np.searchsorted(self.first, place, side="right") - 1
        k = place - self.first[part]
        columns = (column[order].tolist() for column in (part, k, near))
        rows = [Candidate(self.parts[part], k, near) for part, k, near in zip(*columns, strict=True)]
        ends = np.searchsorted(ray[order], np.arange(count + 1)).tolist()
        for start, end in pairwise(ends):
            yield rows[start:end]

    def _pairs(self, rays: Rays, passed: Passed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(ray, place, near), (m,) each."""
        ray, place = passed.ray, self.boxed[passed.box]
        kept = self._may_meet(rays, ray, place)
        count, more = rays.o.shape[1], len(self.boundless)
        return (
            np.concatenate([ray[kept], np.repeat(np.arange(count), more)]),
            np.concatenate([place[kept], np.tile(self.boundless, count)]),
            np.concatenate([passed.near[kept], np.full(count * more, -np.inf)]),
        )

    def _may_meet(self, rays: Rays, ray: np.ndarray, place: np.ndarray) -> np.ndarray:
        kept = np.ones(len(ray), bool)
        for part, first, end in zip(self.parts, self.first, self.first[1:], strict=False):
            rows = np.flatnonzero((place >= first) & (place < end))
            if part.kind.may_meet is not None and len(rows):
                o, d = rays.o[:, ray[rows]].T, rays.d[:, ray[rows]].T
                kept[rows] = part.kind.may_meet(part.prims, place[rows] - first, o, d)
        return kept


def refuse_unusable(part: Part) -> None:
    bad = np.flatnonzero(~part.kind.usable(part.prims))
    if len(bad):
        k = int(bad[0])
        raise OutsideDomain(
            f"primitive {part.ids[k]} (row {k} of {type(part.prims).__name__}) must have finite numbers and no "
            f"radius below 0, got {[a[k].tolist() for a in part.prims]}"
        )
