"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores."""

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from caster.kernels.bvh import cast_bvh
from caster.kernels.everything import cast_everything
from caster.kernels.nearest import (
    Counting,
    Folding,
    Listing,
    Nearest,
    Rays,
    Sketch,
    choose,
    exact_hit,
    merge,
    no_hits,
    precedes,
)
from caster.kernels.tree import LEAF_SIZE, STACK_SIZE
from caster.packing import Kind, Packed
from caster.threads import in_bands

Culling = Literal["everything", "screen", "bvh"]


def find_nearest(packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None) -> Nearest:
    """The nearest hit of any rays."""

    def search(kind: Kind, found: Sketch) -> None:
        cast = _by_tree if culling == "bvh" and worth_a_tree(kind) else _by_everything
        in_bands(cast(Folding(kind.ids), kind, rays, found), len(rays.t_min), threads)

    return _over_kinds(packed, rays, search, threads, trees=culling != "everything")


def worth_a_tree(kind: Kind) -> bool:
    return kind.bounded and len(kind.ids) > LEAF_SIZE


Mode = Folding | Counting | Listing


def _by_everything(mode: Mode, kind: Kind, rays: Rays, record: Sketch) -> Callable[[int, int], None]:
    return lambda start, stop: cast_everything(mode, kind.prims, len(kind.ids), rays, record, start, stop)


def _by_tree(mode: Mode, kind: Kind, rays: Rays, record: Sketch) -> Callable[[int, int], None]:
    tree = kind.tree

    def work(start: int, stop: int) -> None:
        room = np.empty(STACK_SIZE, np.int32), np.empty(STACK_SIZE)
        cast_bvh(mode, kind.prims, tree, rays, record, (start, stop), room)

    return work


def _over_kinds(
    packed: Packed,
    rays: Rays,
    search: Callable[[Kind, Sketch], None],
    threads: int | None,
    *,
    trees: bool = True,
) -> Nearest:
    """The nearest hit among all kinds; search(kind, found) goes through one. Doubtful rays are cast once more."""
    nearest, doubt = no_hits(len(rays.t_min)), np.zeros(len(rays.t_min), bool)
    for kind in packed.kinds:
        search(kind, Sketch(*nearest, doubt))
    return decide_doubtful(packed, rays, nearest, doubt, threads, trees=trees)


def decide_doubtful(
    packed: Packed,
    rays: Rays,
    nearest: Nearest,
    doubt: np.ndarray,
    threads: int | None = None,
    *,
    trees: bool = True,
) -> Nearest:
    """The record, with the rays that are in doubt, (n,) bool, cast once more, exactly."""
    rows = np.flatnonzero(doubt)
    if len(rows):
        exact = decide(packed, Rays(*(a[rows] for a in rays)), threads, trees=trees)
        for everywhere, here in zip(nearest, exact, strict=True):
            everywhere[rows] = here
    return nearest


# For fewer rays than this, trying every primitive takes less time than growing a tree that is not there yet.
WORTH_GROWING = 64


def decide(packed: Packed, rays: Rays, threads: int | None = None, *, trees: bool = True) -> Nearest:
    """The nearest hits of rays, found exactly wherever float64 cannot tell; without trees, by trying everything.

    What float64 is sure of bounds where the first hit is; of all that may come before that, integers choose.
    """
    count = len(rays.t_min)
    sketch, nearest = Sketch(*no_hits(count), np.zeros(count, bool)), no_hits(count)

    def go_through(kind: Kind, mode: Mode) -> None:
        tree = trees and worth_a_tree(kind) and (count > WORTH_GROWING or kind.has_tree)
        cast = _by_tree if tree else _by_everything
        in_bands(cast(mode, kind, rays, sketch), count, threads)

    for kind in packed.kinds:
        go_through(kind, Folding(kind.ids))
    for kind in packed.kinds:
        counts = np.zeros(count + 1, np.int64)
        go_through(kind, Counting(counts[1:]))
        starts = np.cumsum(counts)
        candidates = np.empty(starts[-1], np.int32)
        go_through(kind, Listing(starts[:-1].copy(), candidates))
        found, contested = no_hits(count), np.zeros(count, bool)
        in_bands(partial(choose, kind.prims, rays, starts, candidates, found), count, threads)
        merge(nearest, found, kind.ids, contested, 0, count)
        for i in np.flatnonzero(contested):
            _decide_between(packed, kind, rays, nearest, found, int(i))
    return nearest


def _decide_between(packed: Packed, kind: Kind, rays: Rays, nearest: Nearest, found: Nearest, i: int) -> None:
    """Which of two kinds' nearest primitives comes first along ray i."""
    k, held = int(found.prim[i]), int(nearest.prim[i])
    if held < 0 or _precedes(packed, rays, i, (kind, k), held):
        nearest.t[i], nearest.prim[i], nearest.off[i] = found.t[i], kind.ids[k], found.off[i]


def _precedes(packed: Packed, rays: Rays, i: int, place: tuple[Kind, int], held: int) -> bool:
    """Whether the primitive at a place comes before the one numbered `held`, exactly."""
    (kind, k), (other, j) = place, packed.place_of(held)
    mine, theirs = exact_hit(kind.prims, k, rays, i), exact_hit(other.prims, j, rays, i)
    return precedes(mine, int(kind.ids[k]), theirs, held)
