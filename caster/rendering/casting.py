"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores.

Rays that float64 leaves uncertain are cast once more and decided exactly.
"""

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Literal

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.kernels.bvh.ray_sorting import store_sorted, store_sorted_blocked
from caster.kernels.bvh.traversal import list_candidates_in_tree
from caster.kernels.nearest import (
    Candidates,
    Nearest,
    Rays,
    hit_precedes,
    list_candidates,
    merge,
    nearest_of_candidates,
    no_hits,
)
from caster.kernels.raster.tile import store_blocked, store_blocked_rays, store_ray_range, store_rays
from caster.rendering.bvh_construction import bvh_of, has_bvh, uses_bvh
from caster.rendering.ray_fans import FanCaster
from caster.rendering.ray_tiles import MIN_RAYS_PER_THREAD, Record, for_ray_tiles, new_workspace, tile_caster
from caster.rendering.threads import parallel_for, unwritten_array

__all__ = ["Culling", "find_any", "find_nearest"]

Culling = Literal["brute-force", "raster", "bvh"]


def find_nearest(
    packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None, *, always_fans: bool = False
) -> Nearest:
    """The nearest hit of any rays. always_fans: as fans, if they can be, even where that does not pay: same bits."""
    trees = culling != "brute-force"
    nearest, uncertain = _cast(packed, rays, threads, uses_bvh if trees else _no_tree, fans=trees, always=always_fans)
    return decide_uncertain(packed, rays, nearest, uncertain, threads, trees=trees)


def _no_tree(kind: Kind) -> bool:
    return False


def _cast(
    packed: Packed,
    rays: Rays,
    threads: int | None,
    through_tree: Callable[[Kind], bool],
    *,
    fans: bool = False,
    always: bool = False,
) -> tuple[Nearest, np.ndarray]:
    """(nearest hits by float64, whether it cannot decide (n,) bool), with the tree of some kinds."""
    count, ids = len(rays.t_min), packed.prim_ids
    # threads write all of it
    nearest = Nearest(*(unwritten_array((count,), dtype) for dtype in (float, np.int32, float)))
    uncertain = unwritten_array((count,), bool)
    cast = tile_caster(packed, through_tree=through_tree)
    record = Record(
        lambda tile, first, stop: store_ray_range(tile, 0, ids, first, stop, nearest, uncertain),
        lambda tile, first, width, box: store_rays(tile, first, width, box, ids, nearest, uncertain),
        lambda tile, order, first, stop: store_sorted(tile, order, first, stop, ids, nearest, uncertain),
    )
    caster = FanCaster.of(packed, rays, any_hit=False, always=always) if fans else None
    if caster is not None:
        caster.cast(rays, cast, record, threads)
    else:
        for_ray_tiles(cast, rays, record, threads)
    return nearest, uncertain


def find_any(packed: Packed, rays: Rays, threads: int | None = None, *, always_fans: bool = False) -> np.ndarray:
    """(n,) bool: whether rays hit anything at all (any-hit). Traversal ends at the first certain hit."""
    count = len(rays.t_min)
    blocked, uncertain = np.zeros(count, bool), np.zeros(count, bool)

    record = Record(
        lambda tile, first, stop: store_blocked(tile, 0, first, stop, blocked, uncertain),
        lambda tile, first, width, box: store_blocked_rays(tile, first, width, box, blocked, uncertain),
        lambda tile, order, first, stop: store_sorted_blocked(tile, order, first, stop, blocked, uncertain),
    )
    cast = tile_caster(packed, any_hit=True)
    fans = FanCaster.of(packed, rays, any_hit=True, always=always_fans)
    if fans is not None:
        fans.cast(rays, cast, record, threads)
    else:
        for_ray_tiles(cast, rays, record, threads)
    rows = np.flatnonzero(uncertain)
    if len(rows):
        blocked[rows] = exact_nearest(packed, Rays(*(a[rows] for a in rays)), threads).prim >= 0
    return blocked


def decide_uncertain(
    packed: Packed,
    rays: Rays,
    nearest: Nearest,
    uncertain: np.ndarray,
    threads: int | None = None,
    *,
    trees: bool = True,
) -> Nearest:
    """Cast the uncertain rays, (n,) bool, once more, exactly, and put them into the record."""
    rows = np.flatnonzero(uncertain)
    if len(rows):
        exact = exact_nearest(packed, Rays(*(a[rows] for a in rays)), threads, trees=trees)
        for everywhere, here in zip(nearest, exact, strict=True):
            everywhere[rows] = here
    return nearest


# For fewer rays than this, trying every primitive takes less time than growing a tree that is not there yet.
BVH_MIN_RAYS = 64

# As MIN_RAYS_PER_THREAD: so many tests of a ray and a primitive, so many rays whose candidates integers choose from.
MIN_TESTS_PER_THREAD, MIN_EXACT_PER_THREAD = 1 << 15, 64

# So many primitives that may come first are written down at once, 16 MiB of them; rays with more take turns.
MAX_LISTED_CANDIDATES = 1 << 22


def exact_nearest(packed: Packed, rays: Rays, threads: int | None = None, *, trees: bool = True) -> Nearest:
    """The nearest hits of rays, decided exactly wherever float64 leaves them open; without trees, by brute force.

    What float64 is sure of bounds where the first hit is; of all that may come before that, integers choose.
    """
    count, nearest = len(rays.t_min), no_hits(len(rays.t_min))

    def through_tree(kind: Kind) -> bool:
        return trees and uses_bvh(kind) and (count > BVH_MIN_RAYS or has_bvh(kind))

    def list_all(kind: Kind, into: Candidates, rays: Rays, sketch: Nearest) -> None:
        if through_tree(kind):
            tree = bvh_of(kind)

            def work(start: int, stop: int) -> None:
                list_candidates_in_tree(into, kind.prims, tree, rays, sketch, (start, stop), new_workspace())

            parallel_for(work, len(rays.t_min), threads, least=MIN_RAYS_PER_THREAD)
        else:
            least = MIN_TESTS_PER_THREAD // max(len(kind.ids), 1)
            about = into, kind.prims, len(kind.ids), rays, sketch
            parallel_for(partial(list_candidates, *about), len(rays.t_min), threads, least=least)

    sketch = _cast(packed, rays, threads, through_tree)[0]
    for kind in packed.kinds:
        counts, found, contested = np.zeros(count, np.int64), no_hits(count), np.zeros(count, bool)
        list_all(kind, Candidates(counts, np.empty(0, np.int32)), rays, sketch)
        for rows in _batches(counts):
            starts = np.concatenate([[0], np.cumsum(counts[rows])])
            candidates = np.empty(starts[-1], np.int32)
            some, into, bounds = (
                Rays(*(a[rows] for a in rays)),
                *(Nearest(*(a[rows] for a in each)) for each in (found, sketch)),
            )
            list_all(kind, Candidates(starts[:-1].copy(), candidates), some, bounds)
            parallel_for(
                partial(nearest_of_candidates, kind.prims, some, starts, candidates, into),
                len(starts) - 1,
                threads,
                least=MIN_EXACT_PER_THREAD,
            )
        merge(nearest, found, kind.ids, contested, 0, count)
        for i in np.flatnonzero(contested):
            _decide_between(packed, kind, rays, nearest, found, int(i))
    hit = nearest.prim >= 0  # exactly t_min < t <= t_max; the float64 beside such a t may lie beyond an end
    nearest.t[hit] = np.clip(nearest.t[hit], np.nextafter(rays.t_min[hit], np.inf), rays.t_max[hit])
    return nearest


def _batches(counts: np.ndarray) -> Iterator[slice]:
    """Runs of rays with about MAX_LISTED_CANDIDATES together, or one ray with more."""
    turn = np.cumsum(counts) // MAX_LISTED_CANDIDATES
    ends = [0, *(np.flatnonzero(np.diff(turn)) + 1).tolist(), len(counts)]
    return (slice(start, stop) for start, stop in itertools.pairwise(ends))


def _decide_between(packed: Packed, kind: Kind, rays: Rays, nearest: Nearest, found: Nearest, i: int) -> None:
    """Which of two kinds' nearest primitives comes first along ray i."""
    k, held = int(found.prim[i]), int(nearest.prim[i])
    if held < 0 or _precedes(packed, rays, i, (kind, k), held):
        nearest.t[i], nearest.prim[i], nearest.error[i] = found.t[i], kind.ids[k], found.error[i]


def _precedes(packed: Packed, rays: Rays, i: int, place: tuple[Kind, int], held: int) -> bool:
    """Whether the primitive at a place comes before the one numbered `held`, exactly."""
    (kind, k), (other, j) = place, packed.place_of(held)
    return bool(hit_precedes((kind.prims, k, int(kind.ids[k])), (other.prims, j, held), rays, i))
