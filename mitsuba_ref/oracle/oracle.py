"""Exact oracle: the first hit of a ray, computed in integers without rounding, and the index of primitives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

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
    TieSet,
    check_rays,
    lowest_identical,
)

__all__ = ["EXACT_KINDS", "ExactAnswer", "ExactHit", "Oracle", "OutsideDomain", "Root"]


class PackedKind(Protocol):
    """All primitives of one kind: their arrays, and their numbers in the scene."""

    @property
    def prims(self) -> Any: ...
    @property
    def ids(self) -> np.ndarray: ...


class PackedScene(Protocol):
    """The packed primitives of a scene, as far as the oracle reads them; first[-1] is their number."""

    @property
    def kinds(self) -> Sequence[PackedKind]: ...
    @property
    def first(self) -> np.ndarray: ...


class Oracle:
    """Exact first hits and roots on the packed primitives of one scene."""

    def __init__(self, packed: PackedScene, stand_ins: Sequence[Any] | None = None) -> None:
        """stand_ins: the arrays that the reference traces (SceneModel.kinds), in place of those of packed.kinds.

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
        candidates = self.primitives.candidates(RayColumns(o.T.copy(), d.T.copy(), starts, ends))
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
        return ExactAnswer(best, tie_set(best, ties), flags)

    def roots(self, prim: int, o: Iterable[float], d: Iterable[float]) -> tuple[ExactHit, ...]:
        """All roots of primitive number `prim`, at any t, ascending; none for a dropped face.

        Raises OutsideDomain for a ray that is not finite or has no direction, IndexError for an unknown primitive.
        """
        if not 0 <= prim < self.count:
            raise IndexError(f"the scene has primitives 0 to {self.count - 1}, got {prim}")
        line = np.array([[*o]], np.float64), np.array([[*d]], np.float64)
        check_rays(*line, np.zeros(1), np.zeros(1))
        (ray,) = integer_rays(*line)
        crossed = [part.intersect(k, ray) for part, k in self.primitives.numbered(prim)]
        found = {t: ExactHit(prim, t, where) for roots, _ in crossed for t, where in roots}
        return tuple(found[t] for t in sorted(found))


def tie_set(best: Root | None, ties: dict[int, tuple[PrimitiveArray, int, str]]) -> Sequence[ExactHit]:
    """All hits at `best`. ties: array, row and place of each tested primitive that is hit there, by its number."""
    if best is None:
        return ()
    if any(k in part.identical for part, k, _ in ties.values()):
        groups = [(where, part.identical.get(k, part.ids[k : k + 1])) for part, k, where in ties.values()]
        return TieSet(best, groups)
    return tuple(ExactHit(prim, best, ties[prim][2]) for prim in sorted(ties))


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
    return PrimitiveArray(EXACT_KINDS[type(prims)], prims, ids, {}, *identical_groups(lowest, ids))


def identical_groups(lowest: np.ndarray | None, ids: np.ndarray) -> tuple[dict[int, np.ndarray], np.ndarray | None]:
    """({row: ascending numbers of all primitives identical to it}, (n,) bool: identical to a lower row)."""
    if lowest is None:
        return {}, None
    rows = np.flatnonzero(np.bincount(lowest, minlength=len(lowest))[lowest] > 1)
    rows = rows[np.argsort(lowest[rows], kind="stable")]
    starts = np.flatnonzero(np.diff(lowest[rows], prepend=-1))
    groups = np.split(rows, starts[1:])
    return {int(group[0]): np.sort(ids[group]) for group in groups}, lowest != np.arange(len(lowest))


# ---- the index of primitives: a tree of boxes, traversed in float64 with padding, which misses no candidate ----

BRANCHING_FACTOR = 32  # boxes in a box of the next level
GROUPS_PER_CHUNK = 1 << 9  # groups tested at once: temporary arrays of 128 kB stay in a cache
RAYS_PER_CHUNK = 256  # each passes some hundred boxes
MAX_RAY_BOX_PAIRS = 1 << 19  # 100 MB of temporary arrays
LARGEST_MORTON_CELL = 2**10 - 1

# A ray enters and leaves a box at t = (bound - o) / d, a rounded difference over d: off by (1 + u)^2 - 1 < 3 u of
# itself, u = 2^-53, and by 2^-1075 if denormal. Computing and subtracting the pad takes three more roundings: 8 u and
# 2^-1060 leave room for that. If the difference or t overflows, inf - inf is NaN, which bounds nothing.
PAD_RTOL = 8 * 2.0**-53
PAD_ATOL = 2.0**-1060


BOXES_PER_CHUNK = 1 << 16  # boxes processed at once: temporary arrays stay in a cache


class BoxCrossings(NamedTuple):
    """Pairs of a ray and a box; no point of the ray within the box has a t below near."""

    ray: np.ndarray  # (m,)
    box: np.ndarray  # (m,)
    near: np.ndarray  # (m,)


class RayColumns(NamedTuple):
    """Rays in columns, for fast sums over the three coordinates."""

    o: np.ndarray  # (3, n)
    d: np.ndarray  # (3, n)
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)


class BoxLevel(NamedTuple):
    """Boxes in groups; the last group is filled with copies of its last box."""

    low: np.ndarray  # (3, groups, BRANCHING_FACTOR)
    high: np.ndarray
    boxes: int  # without copies


def whole_groups(order: np.ndarray) -> np.ndarray:
    """`order` with its last number repeated to fill the last group."""
    return np.append(order, np.repeat(order[-1:], -len(order) % BRANCHING_FACTOR))


def box_levels(low: np.ndarray, high: np.ndarray, boxes: int) -> list[BoxLevel]:
    """Levels of a box tree: boxes (3, n) in whole groups, the boxes of these groups, and so on up to one group."""
    groups, levels = (3, -1, BRANCHING_FACTOR), []
    while boxes:
        level = BoxLevel(low.reshape(groups), high.reshape(groups), boxes)
        levels.append(level)
        boxes = level.low.shape[1] if level.low.shape[1] > 1 else 0
        missing = (0, 0), (0, -boxes % BRANCHING_FACTOR)
        low = np.pad(level.low.min(axis=2), missing, mode="edge")
        high = np.pad(level.high.max(axis=2), missing, mode="edge")
    return levels


class BoxTree:
    """A tree of boxes; its traversal never misses a box that a ray passes."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        """low, high: (n, 3), finite."""
        self.order = morton_order(low, high)
        whole = whole_groups(self.order)
        self.levels = box_levels(columns_in_order(low, whole), columns_in_order(high, whole), len(low))

    def crossings(self, rays: RayColumns) -> BoxCrossings | None:
        """All boxes that contain a point of ray i with t_min[i] < t <= t_max[i], and some more.

        None if several rays pass too many boxes to be processed together.
        """
        count = rays.o.shape[1]
        found = BoxCrossings(
            np.arange(count if self.levels else 0), np.zeros(count if self.levels else 0, np.int64), np.zeros(0)
        )
        for level in reversed(self.levels):
            if len(found.ray) * BRANCHING_FACTOR > MAX_RAY_BOX_PAIRS and count > 1:
                return None
            found = crossed_members(rays, found.ray, found.box, level)
        return found._replace(box=self.order[found.box])


def crossed_members(rays: RayColumns, ray: np.ndarray, group: np.ndarray, level: BoxLevel) -> BoxCrossings:
    """The boxes of group[i] that ray[i] passes, for each i."""
    found = [BoxCrossings(ray[:0], group[:0], np.zeros(0))]
    for start in range(0, len(ray), GROUPS_PER_CHUNK):
        some, of = ray[start : start + GROUPS_PER_CHUNK], group[start : start + GROUPS_PER_CHUNK]
        crossed, near = slab_test(rays, some[:, None], level.low[:, of], level.high[:, of])
        crossed &= of[:, None] * BRANCHING_FACTOR + np.arange(BRANCHING_FACTOR) < level.boxes
        i, member = np.nonzero(crossed)
        found.append(BoxCrossings(some[i], of[i] * BRANCHING_FACTOR + member, near[i, member]))
    return BoxCrossings(*(np.concatenate(column) for column in zip(*found, strict=True)))


def slab_test(rays: RayColumns, ray: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(whether ray[i] passes box i, lower bound of t there). low, high: (3, ...), a shape that `ray` broadcasts to."""
    beside, near, far = np.zeros(low.shape[1:], bool), np.array(-np.inf), np.array(np.inf)
    for axis in range(3):
        o, d, start, end = rays.o[axis, ray], rays.d[axis, ray], low[axis], high[axis]
        with np.errstate(all="ignore"):
            forward = d > 0.0
            entry = (np.where(forward, start, end) - o) / d
            leave = (np.where(forward, end, start) - o) / d
            entry -= PAD_RTOL * np.abs(entry) + PAD_ATOL
            leave += PAD_RTOL * np.abs(leave) + PAD_ATOL
        beside |= (d == 0.0) & ((o < start) | (o > end))  # there, entry and leave are NaN
        near, far = np.fmax(near, entry), np.fmin(far, leave)
    crossed: np.ndarray = ~(beside | (near > far) | (far <= rays.t_min[ray]) | (near > rays.t_max[ray]))
    return crossed, near


def morton_order(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Morton order of finite boxes: by the interleaved bits of their centres."""
    if not len(low):
        return np.zeros(0, np.int64)
    pieces = [slice(start, start + BOXES_PER_CHUNK) for start in range(0, len(low), BOXES_PER_CHUNK)]
    centres = ((rows, 0.5 * low[rows] + 0.5 * high[rows]) for rows in pieces)
    ends = np.array([(centre.min(axis=0), centre.max(axis=0)) for _, centre in centres])
    start = ends[:, 0].min(axis=0)
    size = np.maximum(0.5 * ends[:, 1].max(axis=0) - 0.5 * start, np.finfo(np.float64).tiny)
    code = np.zeros(len(low), np.int64)
    for rows in pieces:
        away = 0.5 * (0.5 * low[rows] + 0.5 * high[rows]) - 0.5 * start
        cell = (np.clip(away / size, 0.0, 1.0) * LARGEST_MORTON_CELL).astype(np.int64)
        code[rows] = sum(spread_bits(cell[:, axis]) << axis for axis in range(3))
    return np.argsort(code, kind="stable")


def spread_bits(x: np.ndarray) -> np.ndarray:
    """The ten bits of each number, with two zeros between them."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << shift)) & mask
    return x


def columns_in_order(rows: np.ndarray, order: np.ndarray) -> np.ndarray:
    """(3, n) rows[order].T, without a temporary array of rows."""
    columns = np.empty((3, len(order)))
    for axis in range(3):
        columns[axis] = rows[order, axis]
    return columns


class PrimitiveArray(NamedTuple):
    """All primitives of one kind, with their exact arithmetic."""

    kind: ExactKind
    prims: Any
    ids: np.ndarray  # (n,) the number of each in the scene
    ready: dict[int, Any]  # prepared primitives, by row
    identical: dict[int, np.ndarray]  # row -> numbers of all primitives with the same bits, if there are several
    repeated: np.ndarray | None  # (n,) bool: identical to a lower row, which is tested in its place; None: none is

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

    def __init__(self, parts: Sequence[PrimitiveArray]) -> None:
        """Raises OutsideDomain for primitives with numbers that are outside the domain."""
        for part in parts:
            check_usable(part)
        self.parts = tuple(parts)
        self.first = np.cumsum([0, *(len(part.ids) for part in parts)])
        present = [part.kind.present(part.prims) for part in parts]
        self.present = np.concatenate([np.zeros(0, bool), *present])
        boxes = [part.kind.boxes(part.prims) for part in parts] or [(np.zeros((0, 3)), np.zeros((0, 3)))]
        low, high = map(np.concatenate, zip(*boxes, strict=True)) if len(boxes) > 1 else boxes[0]
        del boxes
        bounded = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        tried = self.present.copy()  # one of identical primitives
        for part, first in zip(parts, self.first.tolist(), strict=False):
            if part.repeated is not None:
                tried[first : first + len(part.ids)] &= ~part.repeated
        self.boxed = np.flatnonzero(tried & bounded)  # indices
        self.boundless = np.flatnonzero(tried & ~bounded)  # of primitives that any ray may intersect
        if len(self.boxed) < len(low):
            low, high = low[self.boxed], high[self.boxed]
        self.tree = BoxTree(low, high)

    def numbered(self, prim: int) -> Iterator[tuple[PrimitiveArray, int]]:
        """All pieces of primitive number `prim`, as (array, row); none for a face with a corner that is not finite."""
        for part, first in zip(self.parts, self.first.tolist(), strict=False):
            for k in np.flatnonzero(part.ids == prim).tolist():
                if self.present[first + k]:
                    yield part, k

    def candidates(self, rays: RayColumns) -> Iterator[list[CandidatePrimitive]]:
        """For each ray all primitives that it may intersect at t_min < t <= t_max, sorted by `near`."""
        for start in range(0, rays.o.shape[1], RAYS_PER_CHUNK):
            yield from self._candidates(RayColumns(*(a[..., start : start + RAYS_PER_CHUNK] for a in rays)))

    def _candidates(self, rays: RayColumns) -> Iterator[list[CandidatePrimitive]]:
        crossings, count = self.tree.crossings(rays), rays.o.shape[1]
        if crossings is None:
            for half in (slice(None, count // 2), slice(count // 2, None)):
                yield from self._candidates(RayColumns(*(a[..., half] for a in rays)))
            return
        ray, index, near = self._pairs(rays, crossings)
        order = np.lexsort([index, near, ray])
        part = np.searchsorted(self.first, index, side="right") - 1
        k = index - self.first[part]
        columns = (column[order].tolist() for column in (part, k, near))
        rows = [CandidatePrimitive(self.parts[part], k, near) for part, k, near in zip(*columns, strict=True)]
        ends = np.searchsorted(ray[order], np.arange(count + 1)).tolist()
        for start, end in pairwise(ends):
            yield rows[start:end]

    def _pairs(self, rays: RayColumns, crossings: BoxCrossings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(ray, index, near), (m,) each."""
        ray, index = crossings.ray, self.boxed[crossings.box]
        kept = self._may_intersect(rays, ray, index)
        count, more = rays.o.shape[1], len(self.boundless)
        return (
            np.concatenate([ray[kept], np.repeat(np.arange(count), more)]),
            np.concatenate([index[kept], np.tile(self.boundless, count)]),
            np.concatenate([crossings.near[kept], np.full(count * more, -np.inf)]),
        )

    def _may_intersect(self, rays: RayColumns, ray: np.ndarray, index: np.ndarray) -> np.ndarray:
        kept = np.ones(len(ray), bool)
        for part, first, end in zip(self.parts, self.first, self.first[1:], strict=False):
            rows = np.flatnonzero((index >= first) & (index < end))
            if part.kind.may_intersect is not None and len(rows):
                o, d = rays.o[:, ray[rows]].T, rays.d[:, ray[rows]].T
                kept[rows] = part.kind.may_intersect(part.prims, index[rows] - first, o, d)
        return kept


def check_usable(part: PrimitiveArray) -> None:
    bad = np.flatnonzero(~part.kind.usable(part.prims))
    if len(bad):
        k = int(bad[0])
        raise OutsideDomain(
            f"primitive {part.ids[k]} (row {k} of {type(part.prims).__name__}) must have finite numbers and no "
            f"radius below 0, got {[a[k].tolist() for a in part.prims]}"
        )
