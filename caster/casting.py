"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from caster.kernels.bvh import LEAF_SIZE, cast_bvh
from caster.kernels.everything import cast_everything
from caster.kernels.nearest import Nearest, Rays, Sketch, exact_hit, merge, no_hits, precedes
from caster.packing import Kind, Packed

Culling = Literal["everything", "screen", "bvh"]

BANDS_PER_THREAD = 4  # small enough that a thread with an empty sky takes over work from one with a mesh


def thread_count(asked: int | None = None) -> int:
    """As many as asked for, else as many as this process may use."""
    if asked:
        return asked
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_bands(work: Callable[[int, int], None], count: int, threads: int | None = None) -> None:
    """Call work(start, stop) over 0..count in pieces; kernels release the GIL, so threads run together."""
    workers = thread_count(threads)
    edges = np.linspace(0, count, min(count, workers * BANDS_PER_THREAD) + 1).astype(int).tolist()
    if workers == 1 or count < 2:
        for start, stop in pairwise(edges):  # a signal is heard between two bands
            work(start, stop)
        return
    with ThreadPoolExecutor(workers) as pool:
        finish(pool, [pool.submit(work, start, stop) for start, stop in pairwise(edges)])


def finish(pool: ThreadPoolExecutor, futures: Iterable[Future[None]]) -> None:
    """Wait for all; after an error or an interruption, do not begin what has not begun."""
    try:
        for future in futures:
            future.result()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def find_nearest(packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None) -> Nearest:
    """The nearest hit of any rays."""

    def search(kind: Kind, found: Sketch) -> None:
        cast = _by_tree if culling == "bvh" and worth_a_tree(kind) else _by_everything
        in_bands(cast(kind, rays, found), len(rays.t_min), threads)

    return _over_kinds(packed, rays, search, threads, trees=culling != "everything")


def worth_a_tree(kind: Kind) -> bool:
    return kind.bounded and len(kind.ids) > LEAF_SIZE


def _by_everything(kind: Kind, rays: Rays, found: Nearest | Sketch) -> Callable[[int, int], None]:
    return lambda start, stop: cast_everything(kind.prims, len(kind.ids), rays, found, start, stop)


def _by_tree(kind: Kind, rays: Rays, found: Nearest | Sketch) -> Callable[[int, int], None]:
    tree = kind.tree
    return lambda start, stop: cast_bvh(kind.prims, tree, rays, found, (start, stop))


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
        search(kind, Sketch(*nearest, doubt, kind.ids))
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


def _beyond(nearest: Nearest) -> Nearest:
    """Nothing found yet, but what is sure to lie behind these hits need not be."""
    found = no_hits(len(nearest.t))
    np.add(nearest.t, nearest.off, out=found.t)
    return found


# For fewer rays than this, trying every primitive takes less time than growing a tree that is not there yet.
WORTH_GROWING = 64


def decide(packed: Packed, rays: Rays, threads: int | None = None, *, trees: bool = True) -> Nearest:
    """The nearest hits of rays, found exactly wherever float64 cannot tell; without trees, by trying everything."""
    count = len(rays.t_min)
    nearest = no_hits(count)
    for kind in packed.kinds:
        found, contested = _beyond(nearest), np.zeros(count, bool)
        tree = trees and worth_a_tree(kind) and (count > WORTH_GROWING or kind.has_tree)
        cast = _by_tree if tree else _by_everything
        in_bands(cast(kind, rays, found), count, threads)
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
