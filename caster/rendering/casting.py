"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores."""

import itertools
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Literal

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.jit.decorators import bind
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.build import LEAF_SIZE, STACK_SIZE
from caster.kernels.bvh.fans import (
    BLOCKS,
    BOX_SIZE,
    GROUPS,
    ROWS,
    Fan,
    FanBounds,
    RayGroups,
    cast_fan,
    cast_left_runs,
    group_rays,
)
from caster.kernels.bvh.traversal import cast_bvh, cast_packets, cast_packets_brute_force
from caster.kernels.nearest import (
    CountCandidates,
    ListCandidates,
    Nearest,
    NearestMode,
    Rays,
    UncertainHits,
    cast_brute_force,
    exact_hit,
    merge,
    nearest_of_candidates,
    no_hits,
    precedes,
)
from caster.kernels.raster.tile import (
    PIXELS,
    WIDTH,
    clear_rays,
    load_ray_range,
    new_tile,
    store_blocked,
    store_ray_range,
)
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.rendering.bvh_construction import bvh_of, fan_bounds, fans_to, has_bvh
from caster.rendering.threads import parallel_for

__all__ = ["Culling", "find_nearest"]

Culling = Literal["brute-force", "raster", "bvh"]


def find_nearest(packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None) -> Nearest:
    """The nearest hit of any rays."""
    count = len(rays.t_min)
    nearest, uncertain = no_hits(count), np.zeros(count, bool)
    if culling == "brute-force":
        for kind in packed.kinds:
            parallel_for(
                _brute_force_caster(NearestMode(kind.ids), kind, rays, UncertainHits(*nearest, uncertain)),
                count,
                threads,
            )
        return decide_uncertain(packed, rays, nearest, uncertain, threads, trees=False)
    ids = scene_prim_ids(packed)
    cast = tile_caster(packed)

    def store(tile: np.ndarray, first: int, number: int) -> None:
        store_ray_range(tile, 0, ids, first, first + number, nearest, uncertain)

    _for_ray_tiles(cast, rays, store, threads)
    return decide_uncertain(packed, rays, nearest, uncertain, threads)


def find_any(packed: Packed, rays: Rays, threads: int | None = None) -> np.ndarray:
    """(n,) bool: whether rays hit anything at all (any-hit). Traversal ends at the first certain hit."""
    count = len(rays.t_min)
    blocked, uncertain = np.zeros(count, bool), np.zeros(count, bool)

    def store(tile: np.ndarray, first: int, number: int) -> None:
        store_blocked(tile, number, first, blocked, uncertain)

    _for_ray_tiles(tile_caster(packed, any_hit=True), rays, store, threads)
    rows = np.flatnonzero(uncertain)
    if len(rows):
        blocked[rows] = exact_nearest(packed, Rays(*(a[rows] for a in rays)), threads).prim >= 0
    return blocked


def _for_ray_tiles(
    cast: Callable[[int, np.ndarray], None],
    rays: Rays,
    store: Callable[[np.ndarray, int, int], None],
    threads: int | None,
) -> None:
    """Cast rays, a tile of them at a time; store(tile, first, number) takes the answers to rays first.. ."""

    def work(start: int, stop: int) -> None:
        tile = new_tile()
        for first in range(start, stop, PIXELS):
            number = min(PIXELS, stop - first)
            load_ray_range(rays, first, first + number, tile, 0)
            clear_rays(tile, number, -(-number // LANES) * LANES)
            cast(number, tile)
            store(tile, first, number)

    parallel_for(work, len(rays.t_min), threads)


def tile_caster(packed: Packed, any_hit: bool = False) -> Callable[[int, np.ndarray], None]:
    """Cast the first so many rays of a tile; until they have met anything, if that will do."""
    kinds = [
        _kind_caster(kind, base, any_hit)
        for kind, base in zip(packed.kinds, prim_offsets(packed), strict=True)
    ]

    def go(count: int, tile: np.ndarray) -> None:
        workspace = _new_workspace()
        for cast in kinds:
            cast(count, tile, workspace)

    return go


Workspace = tuple[np.ndarray, np.ndarray, np.ndarray]


def _new_workspace() -> Workspace:
    """For what a ray has yet to look at, where it enters that, and where it enters the boxes of a node."""
    return np.zeros(STACK_SIZE, np.int32), np.empty(STACK_SIZE), np.empty(CHILDREN)


def _kind_caster(kind: Kind, base: int, any_hit: bool) -> Callable[[int, np.ndarray, Workspace], None]:
    """Cast so many rays of a tile at a kind."""
    if uses_bvh(kind):
        tree = bvh_of(kind)
        return lambda count, tile, workspace: cast_packets(
            kind.prims, tree, base, count, tile, workspace, any_hit
        )
    return lambda count, tile, workspace: cast_packets_brute_force(
        kind.prims, len(kind.ids), base, count, tile, any_hit
    )


# To project a primitive towards a light takes a quarter of the time of a shadow ray. Few are projected for any film.
MIN_SHADOW_RAYS_PER_PRIMITIVE = 0.25
FEW_PRIMITIVES = 1 << 14


class ShadowCaster:
    """Casts the shadow rays of tiles to one light, until each has met anything: as fans where that pays.

    rays: about how many there will be.
    """

    def __init__(self, packed: Packed, light: PointLight | DirectionalLight, rays: int) -> None:
        offsets = list(zip(packed.kinds, prim_offsets(packed), strict=True))
        most = max(FEW_PRIMITIVES, int(rays / MIN_SHADOW_RAYS_PER_PRIMITIVE))
        self._kinds = [(kind, base) for kind, base in offsets if uses_bvh(kind) and len(kind.ids) <= most]
        self._others = [
            _kind_caster(kind, base, any_hit=True)
            for kind, base in offsets
            if not uses_bvh(kind) or len(kind.ids) > most
        ]
        self._fans: list[Fan] = []
        if self._kinds:
            center = bvh_of(max(self._kinds, key=lambda it: len(it[0].ids))[0]).center
            self._fans = fans_to(light, center, max(kind.extent for kind, _ in self._kinds))
        self._bounds: dict[tuple[int, int], FanBounds] = {}
        self._lock = threading.Lock()

    def begin(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """What casts the first so many rays of this tile, whole rows of it."""
        workspace, counts = _new_workspace(), groups.counts
        find = [bind(group_rays, fan, tile, 0, groups, given=(2,)) for fan in self._fans]
        casters: dict[int, list[Callable[[], None]]] = {}

        def go(count: int) -> None:
            groups.taken[:], counts[:] = 0, (0, count)
            for number, group in enumerate(find):
                group(count // WIDTH)
                if counts[0]:
                    if number not in casters:
                        casters[number] = [
                            self._fan_caster(number, n, tile, groups) for n in range(len(self._kinds))
                        ]
                    for cast in casters[number]:
                        cast()
                if not counts[1]:
                    break
            if counts[1]:
                for kind, base in self._kinds:
                    cast_left_runs(kind.prims, bvh_of(kind), base, count, tile, groups.taken, workspace)
            for cast_others in self._others:
                cast_others(count, tile, workspace)

        return go

    def _fan_caster(self, number: int, n: int, tile: np.ndarray, groups: RayGroups) -> Callable[[], None]:
        kind, base = self._kinds[n]
        about = kind.prims, bvh_of(kind), self._bounds_of(number, n), base, tile, groups
        return bind(cast_fan, self._fans[number], *about, given=())

    def _bounds_of(self, number: int, n: int) -> FanBounds:
        """Kind n as the fan of that number sees it, found when a tile first needs it."""
        found = self._bounds.get((number, n))
        if found is None:
            with self._lock:
                found = self._bounds.get((number, n)) or fan_bounds(self._kinds[n][0], self._fans[number], 1)
                self._bounds[number, n] = found
        return found


def new_ray_groups() -> RayGroups:
    """Room for the rays of a tile."""
    return RayGroups(
        np.zeros(BLOCKS * BOX_SIZE),
        np.zeros(GROUPS * BOX_SIZE),
        np.zeros(PIXELS // LANES, np.int64),
        np.zeros(2, np.int64),
        np.zeros(CHILDREN * ROWS, np.int64),
        np.zeros(STACK_SIZE, np.int32),
    )


def prim_offsets(packed: Packed) -> list[int]:
    """Place of each kind's first primitive: they are counted kind by kind."""
    return [0, *itertools.accumulate(len(kind.ids) for kind in packed.kinds)][: len(packed.kinds)]


def scene_prim_ids(packed: Packed) -> np.ndarray:
    """(places,) int32, number in the scene of each primitive, kind by kind."""
    return np.concatenate([kind.ids for kind in packed.kinds]) if packed.kinds else np.zeros(0, np.int32)


# Where a kind's largest coordinate lies beyond these, products with 1/d may leave float64: everything is tried instead.
MIN_BVH_EXTENT, MAX_BVH_EXTENT = 2.0**-400, 2.0**400


def uses_bvh(kind: Kind) -> bool:
    return kind.bounded and len(kind.ids) > LEAF_SIZE and MIN_BVH_EXTENT < kind.extent < MAX_BVH_EXTENT


Mode = NearestMode | CountCandidates | ListCandidates


def _brute_force_caster(
    mode: Mode, kind: Kind, rays: Rays, record: UncertainHits
) -> Callable[[int, int], None]:
    return lambda start, stop: cast_brute_force(mode, kind.prims, len(kind.ids), rays, record, start, stop)


def _bvh_caster(mode: Mode, kind: Kind, rays: Rays, record: UncertainHits) -> Callable[[int, int], None]:
    tree = bvh_of(kind)

    def work(start: int, stop: int) -> None:
        cast_bvh(mode, kind.prims, tree, rays, record, (start, stop), _new_workspace())

    return work


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

# So many primitives that may come first are written down at once, 16 MiB of them; rays with more take turns.
MAX_LISTED_CANDIDATES = 1 << 22


def exact_nearest(packed: Packed, rays: Rays, threads: int | None = None, *, trees: bool = True) -> Nearest:
    """The nearest hits of rays, decided exactly wherever float64 leaves them open; without trees, by brute force.

    What float64 is sure of bounds where the first hit is; of all that may come before that, integers choose.
    """
    count = len(rays.t_min)
    sketch, nearest = UncertainHits(*no_hits(count), np.zeros(count, bool)), no_hits(count)

    def go_through(kind: Kind, mode: Mode, rays: Rays = rays, sketch: UncertainHits = sketch) -> None:
        tree = trees and uses_bvh(kind) and (count > BVH_MIN_RAYS or has_bvh(kind))
        cast = _bvh_caster if tree else _brute_force_caster
        parallel_for(cast(mode, kind, rays, sketch), len(rays.t_min), threads)

    for kind in packed.kinds:
        go_through(kind, NearestMode(kind.ids))
    for kind in packed.kinds:
        counts, found, contested = np.zeros(count, np.int64), no_hits(count), np.zeros(count, bool)
        go_through(kind, CountCandidates(counts))
        for rows in _batches(counts):
            starts = np.concatenate([[0], np.cumsum(counts[rows])])
            candidates = np.empty(starts[-1], np.int32)
            some, into = Rays(*(a[rows] for a in rays)), Nearest(*(a[rows] for a in found))
            bounds = UncertainHits(*(a[rows] for a in sketch))
            go_through(kind, ListCandidates(starts[:-1].copy(), candidates), some, bounds)
            parallel_for(
                partial(nearest_of_candidates, kind.prims, some, starts, candidates, into),
                len(starts) - 1,
                threads,
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
    mine, theirs = exact_hit(kind.prims, k, rays, i), exact_hit(other.prims, j, rays, i)
    return precedes(mine, int(kind.ids[k]), theirs, held)
