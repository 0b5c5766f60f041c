"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores."""

import itertools
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Literal, NamedTuple

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.jit.decorators import bind
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.build import LEAF_SIZE, MAX_PRIMITIVES, STACK_SIZE
from caster.kernels.bvh.fans import (
    BLOCKS,
    BOX_SIZE,
    GROUPS,
    ROWS,
    Fan,
    FanBounds,
    RayGroups,
    cast_fan,
    cast_fan_outward,
    cast_left_runs,
    group_rays,
)
from caster.kernels.bvh.ray_sorting import (
    BUCKETS,
    LOWER_BITS,
    LOWER_CELLS,
    NOT_IN_FAN,
    find_keys,
    find_row,
    largest_deviation,
    load_sorted,
    project_rays,
    rays_of_other_limits,
    scatter_to_buckets,
    sort_buckets,
    store_sorted,
    store_sorted_blocked,
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
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import (
    PIXELS,
    WIDTH,
    Box,
    clear_rays,
    load_ray_range,
    load_rays_from,
    new_lanes,
    new_tile,
    store_blocked,
    store_blocked_rays,
    store_ray_range,
    store_rays,
    tile_boxes,
)
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.kernels.surface.per_hit import new_surface_buffer
from caster.rendering.bvh_construction import boxes_along, bvh_of, fan_bounds, fans_to, has_bvh
from caster.rendering.threads import (
    CHUNKS_PER_THREAD,
    parallel_for,
    parallel_for_pieces,
    thread_count,
    unwritten_array,
)

__all__ = ["Culling", "find_any", "find_nearest", "find_rows"]

Culling = Literal["brute-force", "raster", "bvh"]


def find_nearest(
    packed: Packed,
    rays: Rays,
    culling: Culling = "bvh",
    threads: int | None = None,
    *,
    always_fans: bool = False,
) -> Nearest:
    """The nearest hit of any rays. always_fans: as fans, if they can be, even where that does not pay: same bits."""
    count = len(rays.t_min)
    if culling == "brute-force":
        nearest, uncertain = no_hits(count), np.zeros(count, bool)
        for kind in packed.kinds:
            parallel_for(
                _brute_force_caster(NearestMode(kind.ids), kind, rays, UncertainHits(*nearest, uncertain)),
                count,
                threads,
            )
        return decide_uncertain(packed, rays, nearest, uncertain, threads, trees=False)
    # threads write all of it
    nearest, uncertain = (
        Nearest(*(unwritten_array((count,), dtype) for dtype in (float, np.int32, float))),
        unwritten_array((count,), bool),
    )
    ids = scene_prim_ids(packed)
    cast = tile_caster(packed)

    record = Record(
        lambda tile, first, stop: store_ray_range(tile, 0, ids, first, stop, nearest, uncertain),
        lambda tile, first, width, box: store_rays(tile, first, width, box, ids, nearest, uncertain),
        lambda tile, order, first, stop: store_sorted(tile, order, first, stop, ids, nearest, uncertain),
    )
    fans = FanCaster.of(packed, rays, any_hit=False, always=always_fans)
    if fans is not None:
        fans.cast(rays, cast, record, threads)
    else:
        _for_ray_tiles(cast, rays, record, threads)
    return decide_uncertain(packed, rays, nearest, uncertain, threads)


def find_any(
    packed: Packed, rays: Rays, threads: int | None = None, *, always_fans: bool = False
) -> np.ndarray:
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
        _for_ray_tiles(cast, rays, record, threads)
    rows = np.flatnonzero(uncertain)
    if len(rows):
        blocked[rows] = exact_nearest(packed, Rays(*(a[rows] for a in rays)), threads).prim >= 0
    return blocked


class Record(NamedTuple):
    """Where the answers to the rays of a tile are written."""

    ray_range: Callable[[np.ndarray, int, int], None]  # (tile, first, stop): of rays first..stop
    # (tile, first, width, box): of a box of rays that lie in rows, `width` of them each, from ray `first` on
    window: Callable[[np.ndarray, int, int, Box], None]
    sorted_rays: Callable[
        [np.ndarray, np.ndarray, int, int], None
    ]  # (tile, order, first, stop): of order[first:stop]


# To wake a second thread takes as long as so many rays, about.
MIN_RAYS_PER_THREAD = 256


def _for_ray_tiles(
    cast: Callable[[int, np.ndarray], None],
    rays: Rays,
    record: Record,
    threads: int | None,
    ray_range: tuple[int, int] | None = None,
) -> None:
    """Cast rays, or a range of them, a tile at a time."""
    begin, end = ray_range or (0, len(rays.t_min))

    def work(start: int, stop: int) -> None:
        with spare_workspaces() as take:
            tile = take().tile
            for first in range(begin + start, begin + stop, PIXELS):
                number = min(PIXELS, begin + stop - first)
                load_ray_range(rays, first, first + number, tile, 0)
                clear_rays(tile, number, -(-number // LANES) * LANES)
                cast(number, tile)
                record.ray_range(tile, first, first + number)

    if end > begin:
        parallel_for(work, end - begin, threads, least=MIN_RAYS_PER_THREAD)


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
    """Casts rays of tiles that end at one light, or start at one point (outward), as fans where that pays.

    Shadow rays until each has met anything (any_hit). rays: about how many there will be. deviation: as for `fans_to`.
    """

    def __init__(
        self,
        packed: Packed,
        light: PointLight | DirectionalLight,
        rays: int,
        *,
        any_hit: bool = True,
        outward: bool = False,
        deviation: float = 0.0,
    ) -> None:
        offsets = list(zip(packed.kinds, prim_offsets(packed), strict=True))
        most = max(FEW_PRIMITIVES, int(rays / MIN_SHADOW_RAYS_PER_PRIMITIVE))
        self._any_hit, self._outward = any_hit, outward
        self._kinds = [(kind, base) for kind, base in offsets if uses_bvh(kind) and len(kind.ids) <= most]
        few, many = (
            [
                _kind_caster(kind, base, any_hit)
                for kind, base in offsets
                if uses_bvh(kind) == with_tree and (not with_tree or len(kind.ids) > most)
            ]
            for with_tree in (False, True)
        )
        self._before_fans, self._after_fans = few, many
        self._fans: list[Fan] = []
        if self._kinds:
            center = bvh_of(max(self._kinds, key=lambda it: len(it[0].ids))[0]).center
            extent = max(kind.extent for kind, _ in self._kinds)
            self._fans = fans_to(light, center, extent, deviation)
        self._bounds: dict[tuple[int, int], FanBounds] = {}
        self._lock = threading.Lock()

    @property
    def has_fans(self) -> bool:
        """Whether there is a kind whose primitives are few enough for so many rays."""
        return bool(self._fans)

    @property
    def first_fan(self) -> Fan:
        """That of most rays."""
        return self._fans[0]

    def share_in_view(self, points: np.ndarray) -> float:
        """Share of points (m, 2) of the first projection at which a tree has a box, about; 0 without points."""
        covered = np.zeros(len(points), bool)
        for kind, _ in self._kinds:
            for low, high in boxes_along(self._fans[0], bvh_of(kind)):
                covered |= ((points >= low) & (points <= high)).all(axis=1)
        return float(covered.mean()) if len(points) else 0.0

    def prepare(self, threads: int | None) -> None:
        """Find what most tiles need, on all threads."""
        for n, (kind, _) in enumerate(self._kinds):
            self._bounds[0, n] = fan_bounds(kind, self._fans[0], threads)

    def begin(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """What casts the first so many rays of this tile, whole rows of it."""
        workspace, counts = _new_workspace(), groups.counts
        find: list[Callable[[int], None]] = []  # bound when they are needed: most tiles lie in the first fan
        casters: dict[int, list[Callable[[], None]]] = {}

        def go(count: int) -> None:
            for cast_others in self._before_fans:  # what they hit ends the search for the rest
                cast_others(count, tile, workspace)
            groups.taken[:], counts[:] = 0, (0, count)
            for number, fan in enumerate(self._fans):
                if number == len(find):
                    find.append(bind(group_rays, fan, tile, 0, groups, self._outward, given=(2,)))
                find[number](count // WIDTH)
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
                    about = kind.prims, bvh_of(kind), base, count, tile, groups.taken, workspace
                    cast_left_runs(*about, self._any_hit)
            for cast_others in self._after_fans:
                cast_others(count, tile, workspace)

        return go

    def _fan_caster(self, number: int, n: int, tile: np.ndarray, groups: RayGroups) -> Callable[[], None]:
        kind, base = self._kinds[n]
        about = kind.prims, bvh_of(kind), self._bounds_of(number, n), base, tile, groups
        if self._outward:
            return bind(cast_fan_outward, self._fans[number], *about, self._any_hit, given=())
        return bind(cast_fan, self._fans[number], *about, given=())

    def _bounds_of(self, number: int, n: int) -> FanBounds:
        """Kind n as the fan of that number sees it, found when a tile first needs it."""
        found = self._bounds.get((number, n))
        if found is None:
            with self._lock:
                found = self._bounds.get((number, n)) or fan_bounds(self._kinds[n][0], self._fans[number], 1)
                self._bounds[number, n] = found
        return found


class CommonPoint(NamedTuple):
    """What all rays of an array, but for single ones, have in common."""

    light: PointLight | DirectionalLight  # where they end, start or come from; its intensity is of no use
    outward: bool  # they start there
    deviation: float  # rays that pass the point by more, along an axis, are cast as any others


MIN_RAYS_SORTED = 1 << 16  # to sort fewer takes as long as it saves
SAMPLED_RAYS = 64

# Rays to one point, rounded to float32, pass it by 2^-23 of their largest coordinate or less.
MAX_DEVIATION = 2.0**-20
# What is computed of a deviation is off by 8 u of the coordinates; a sample may lack the largest.
DEVIATION_ROUNDING, SAMPLE_MARGIN = 64.0 * 2.0**-53, 4.0


def common_point(rays: Rays, any_hit: bool) -> CommonPoint | None:
    """Whether rays have a point or, of any-hit rays, a direction in common, by a sample of them; None: they have not.

    The point of rays that end at one is the nearest to all lines in the sense of least squares.
    """
    count = len(rays.t_min)
    sample = np.unique(np.linspace(0, count - 1, SAMPLED_RAYS).astype(np.int64))
    sample = sample[rays.t_max[sample] >= 0.0]
    if len(sample) < SAMPLED_RAYS // 2:
        return None
    some = Rays(*(a[sample] for a in rays))
    if (some.o == some.o[0]).all():
        return CommonPoint(PointLight(_vec3(some.o[0]), NO_INTENSITY), True, 0.0)
    if not any_hit:
        return None
    if (some.d == some.d[0]).all():
        return CommonPoint(DirectionalLight(_vec3(some.d[0]), NO_INTENSITY), False, 0.0)
    if not np.isfinite(some.t_max).all():
        return None
    unit = some.d / np.linalg.norm(some.d, axis=1, keepdims=True)
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        middle = some.o.mean(axis=0)
        point = middle + np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, some.o - middle))
        size = float(np.abs(some.o).max() + np.abs(point).max())
        if np.isfinite(size):
            off = largest_deviation(some, _vec3(point), 0, len(sample))
            if off <= MAX_DEVIATION * size:
                light = PointLight(_vec3(point), NO_INTENSITY)
                return CommonPoint(light, False, SAMPLE_MARGIN * off + DEVIATION_ROUNDING * size)
    return None


NO_INTENSITY = 0.0, 0.0, 0.0


def _vec3(a: np.ndarray) -> Vec3:
    x, y, z = a.tolist()
    return x, y, z


Corners = tuple[float, float, float, float]
NO_CORNERS = 0.0, 0.0, 0.0, 0.0


class RayRows(NamedTuple):
    """Rays that sweep over what they see row by row, as a film's do."""

    first: int  # ray of the first whole row
    width: int  # rays of a row
    height: int  # whole rows


# Fewer rays of rows are cast as fast in packets: what is found once, boxes of primitives above all, takes 0.2 ms.
MIN_RAYS_IN_ROWS = 1 << 14
PRIMITIVES_PER_RAY_IN_ROWS = 0.25  # more take longer to be projected than rows of rays save
LONGEST_ROW = 1 << 13
# A row ends where neighbours are so many times as far apart as on average, jumps included: those of the shortest row
# that is looked for are 63 / 2 times as far. In the middle of a perspective film that sees 150 degrees they are less
# than 4 times as far apart as on average.
ROW_JUMP = 8.0
SAMPLED_AHEAD = 256


def share_ahead(caster: ShadowCaster, rays: Rays) -> float:
    """Share of a sample of rays that lead to a box of a tree as the first fan sees it, about."""
    some = np.linspace(0, len(rays.t_min) - 1, SAMPLED_AHEAD).astype(np.int64)
    points = np.empty((len(some), 2))
    project_rays(caster.first_fan, Rays(*(a[some] for a in rays)), True, points)
    return caster.share_in_view(points[~np.isnan(points[:, 0])]) * np.isfinite(points[:, 0]).mean()


def find_rows(rays: Rays) -> RayRows | None:
    """The rows of rays that start at one point, by directions from the middle of the array on; None: there are none.

    What is found decides how tiles are filled, no more: other rays give the same hits.
    """
    count = len(rays.t_min)
    begin = max(0, count // 2 - LONGEST_ROW)
    end = min(count, begin + 2 * LONGEST_ROW + 2)
    found = np.zeros(2, np.int64)
    find_row(rays, begin, end, ROW_JUMP, np.empty(end - begin), found)
    first, width = found.tolist()
    return RayRows(first, width, (count - first) // width) if width >= WIDTH // 2 else None


class FanCaster:
    """Casts many rays with a point in common: in rows, as they come, or sorted by where they are projected to."""

    def __init__(
        self, caster: ShadowCaster, common: CommonPoint, corners: Corners, rows: RayRows | None = None
    ) -> None:
        self._caster, self._common, self._corners, self._rows = caster, common, corners, rows

    @staticmethod
    def of(packed: Packed, rays: Rays, any_hit: bool, *, always: bool = False) -> "FanCaster | None":
        """Where rays have a point in common, and that pays or it is to be done always.

        It pays for rays that sweep from one point row by row, and for more in no order of their own, a share of which
        leads to what has a tree.
        """
        count = len(rays.t_min)
        if (count < min(MIN_RAYS_IN_ROWS, MIN_RAYS_SORTED) and not always) or not any(
            uses_bvh(kind) for kind in packed.kinds
        ):
            return None
        common = common_point(rays, any_hit)
        if common is None:
            return None
        light, outward, deviation = common
        rows = find_rows(rays) if outward and (always or count >= MIN_RAYS_IN_ROWS) else None
        if rows is not None:
            few = int(count * PRIMITIVES_PER_RAY_IN_ROWS * MIN_SHADOW_RAYS_PER_PRIMITIVE)
            number = MAX_PRIMITIVES if always else few
            caster = ShadowCaster(packed, light, number, any_hit=any_hit, outward=True)
            pays = caster.has_fans and (always or share_ahead(caster, rays) >= MIN_SHARE_IN_VIEW)
            return FanCaster(caster, common, NO_CORNERS, rows) if pays else None
        if count < MIN_RAYS_SORTED and not always:
            return None
        number = MAX_PRIMITIVES if always else count
        caster = ShadowCaster(packed, light, number, any_hit=any_hit, outward=outward, deviation=deviation)
        if not caster.has_fans:
            return None
        sample = project_sample(caster.first_fan, rays, outward)
        pays = not sample.in_order and caster.share_in_view(sample.points) >= MIN_SHARE_IN_VIEW
        if not (pays or always):
            return None
        return FanCaster(caster, common, sample.corners)

    def cast(
        self,
        rays: Rays,
        cast_others: Callable[[int, np.ndarray], None],
        record: Record,
        threads: int | None,
    ) -> None:
        """cast_others: casts the first so many rays of a tile; for rays that do not have the point in common."""
        self._caster.prepare(threads)
        if self._rows is not None:
            self._cast_rows(rays, self._rows, cast_others, record, threads)
        else:
            self._cast_sorted(rays, cast_others, record, threads)

    def _cast_rows(
        self,
        rays: Rays,
        rows: RayRows,
        cast_others: Callable[[int, np.ndarray], None],
        record: Record,
        threads: int | None,
    ) -> None:
        """Tiles of rays that lie beside and below each other."""
        first, width, height = rows
        origin = self._caster.first_fan.origin

        def begin() -> Callable[[Box], None]:
            workspace = take()
            tile = workspace.tile
            cast_fans = self._caster.begin(tile, workspace.ray_groups)

            def work(box: Box) -> None:
                count = (box[3] - box[1]) * WIDTH
                if load_rays_from(rays, first, width, box, origin, tile) == 0:
                    cast_fans(count)
                else:
                    cast_others(count, tile)
                record.window(tile, first, width, box)

            return work

        boxes = list(tile_boxes(width, height))
        with spare_workspaces() as take:
            parallel_for_pieces(begin, boxes, thread_count(threads))
        for rest in ((0, first), (first + width * height, len(rays.t_min))):
            _for_ray_tiles(cast_others, rays, record, threads, rest)

    def _cast_sorted(
        self,
        rays: Rays,
        cast_others: Callable[[int, np.ndarray], None],
        record: Record,
        threads: int | None,
    ) -> None:
        fan, outward = self._caster.first_fan, self._common.outward
        count = len(rays.t_min)
        same_limits = _total(partial(rays_of_other_limits, rays), count, threads) == 0
        edges = np.linspace(0, count, -(-count // MAX_RAYS_SORTED) + 1).astype(int).tolist()
        for first, stop in itertools.pairwise(edges):
            order, members = sort_rays(fan, rays, self._common, (first, stop), self._corners, threads)

            def begin(order: np.ndarray = order, members: int = members) -> Callable[[tuple[int, int]], None]:
                workspace = take()
                tile = workspace.tile
                cast_fans = self._caster.begin(tile, workspace.ray_groups)

                def work(piece: tuple[int, int]) -> None:
                    belong = piece[1] <= members
                    load_sorted(rays, order, *piece, tile, fan.origin, outward and belong, same_limits)
                    if belong:
                        cast_fans(PIXELS)
                    else:
                        cast_others(PIXELS, tile)
                    record.sorted_rays(tile, order, *piece)

                return work

            pieces = [*_tiles(0, members), *_tiles(members, stop - first)]
            with spare_workspaces() as take:
                parallel_for_pieces(begin, pieces, thread_count(threads))


def _total(number: Callable[[int, int], int], count: int, threads: int | None) -> int:
    """number(start, stop) of all pieces of 0..count."""
    found: list[int] = []
    parallel_for(lambda start, stop: found.append(number(start, stop)), count, threads)
    return sum(found)


def _tiles(start: int, stop: int) -> Iterator[tuple[int, int]]:
    return ((first, min(first + PIXELS, stop)) for first in range(start, stop, PIXELS))


MAX_RAYS_SORTED = 1 << 20  # at a time: 24 bytes each

SAMPLED_RUNS, RUN_LENGTH = 512, 8  # rays of the sample: neighbours, at even distances

# Rays are in order whose neighbours are projected to within a path of so many times the distance that as many rays in
# rows and columns would have. Packets of them take as long as fans do, which have to be sorted first.
MAX_PATH_IN_ORDER = 16.0

# A ray past everything takes a third of the time of sorting it.
MIN_SHARE_IN_VIEW = 0.25


class ProjectedSample(NamedTuple):
    """Rays in the projection of a fan, by a sample of them."""

    points: np.ndarray  # (m, 2) x, y of those that the fan has
    corners: Corners  # least x, y and largest x, y
    in_order: bool


def project_sample(fan: Fan, rays: Rays, outward: bool) -> ProjectedSample:
    """A sample of the rays, in runs of neighbours."""
    starts = np.linspace(0, len(rays.t_min) - RUN_LENGTH, SAMPLED_RUNS).astype(np.int64)
    sample = (starts[:, None] + np.arange(RUN_LENGTH)).ravel()
    points = np.empty((len(sample), 2))
    project_rays(fan, Rays(*(a[sample] for a in rays)), outward, points)
    known = points[~np.isnan(points[:, 0])]
    if not len(known):
        return ProjectedSample(known, (0.0, 0.0, 0.0, 0.0), False)
    low, high = known.min(axis=0), known.max(axis=0)
    paths = np.abs(np.diff(points.reshape(SAMPLED_RUNS, RUN_LENGTH, 2), axis=1)).sum(axis=(1, 2))
    paths = paths[np.isfinite(paths)]
    apart = math.sqrt(float(np.prod(high - low)) / len(rays.t_min))
    in_order = len(paths) > 0 and bool(np.median(paths) <= MAX_PATH_IN_ORDER * apart)
    return ProjectedSample(known, (low[0].item(), low[1].item(), high[0].item(), high[1].item()), in_order)


def sort_rays(
    fan: Fan,
    rays: Rays,
    common: CommonPoint,
    ray_range: tuple[int, int],
    corners: Corners,
    threads: int | None,
) -> tuple[np.ndarray, int]:
    """(numbers of rays, how many of them have the point in common): these first, sorted by keys (ray_sorting.py)."""
    first, stop = ray_range
    workers = thread_count(threads)
    edges = np.linspace(first, stop, workers * CHUNKS_PER_THREAD + 1).astype(int).tolist()
    pieces = list(enumerate(itertools.pairwise(edges)))
    counts = np.zeros((len(pieces), BUCKETS), np.int64)
    pairs, scattered = np.empty((2, stop - first), np.int64)
    order = np.empty(stop - first, np.int32)

    def in_pieces(work: Callable[[int, tuple[int, int]], None]) -> None:
        parallel_for_pieces(lambda: lambda numbered: work(*numbered), pieces, workers)

    about = fan, rays, common.outward, common.deviation, corners, first
    in_pieces(lambda n, piece: find_keys(*about, piece, pairs, counts[n]))
    # each bucket has a part for each piece, in the order of the rays
    places = (np.cumsum(counts.T.ravel()) - counts.T.ravel()).reshape(BUCKETS, len(pieces)).T.copy()
    starts = np.append(places[0], stop - first)
    in_pieces(
        lambda n, piece: scatter_to_buckets(pairs, places[n], piece[0] - first, piece[1] - first, scattered)
    )

    def sort(buckets: tuple[int, int]) -> None:
        sort_buckets(scattered, starts, buckets, np.empty(LOWER_CELLS, np.int64), order)

    shares = np.linspace(0, stop - first, len(pieces) + 1)
    buckets = np.unique(np.concatenate([[0, BUCKETS], np.searchsorted(starts, shares[1:-1])])).tolist()
    parallel_for_pieces(lambda: sort, list(itertools.pairwise(buckets)), workers)
    return order, int(starts[NOT_IN_FAN >> LOWER_BITS])


def new_ray_groups() -> RayGroups:
    """Room for the rays of a tile."""
    return RayGroups(
        np.zeros(BLOCKS * BOX_SIZE),
        np.zeros(GROUPS * BOX_SIZE),
        np.zeros(PIXELS // LANES, np.int64),
        np.zeros(2, np.int64),
        np.zeros(CHILDREN * ROWS, np.int64),
        np.zeros(STACK_SIZE, np.int32),
        np.zeros(STACK_SIZE),
        np.zeros(PIXELS // LANES),
    )


@dataclass(frozen=True)
class TileWorkspace:
    """Buffers of one thread: the tile it works on, and what only some AOVs need."""

    tile: np.ndarray = field(default_factory=new_tile)

    @cached_property
    def surface(self) -> np.ndarray:
        return new_surface_buffer()

    @cached_property
    def lanes(self) -> np.ndarray:
        return new_lanes()

    @cached_property
    def shadow_tile(self) -> np.ndarray:
        return new_tile()

    @cached_property
    def ray_groups(self) -> RayGroups:
        return new_ray_groups()


MAX_SPARE_WORKSPACES = 16  # 3 MB each

_SPARE_WORKSPACES: list[TileWorkspace] = []


@contextmanager
def spare_workspaces() -> Iterator[Callable[[], TileWorkspace]]:
    """Gives a function that returns a workspace, with what earlier work left in it; they are spare afterwards."""
    taken: list[TileWorkspace] = []

    def take() -> TileWorkspace:
        workspace = None
        with suppress(IndexError):
            workspace = _SPARE_WORKSPACES.pop()
        taken.append(workspace or TileWorkspace())
        return taken[-1]

    yield take
    _SPARE_WORKSPACES.extend(taken[: max(MAX_SPARE_WORKSPACES - len(_SPARE_WORKSPACES), 0)])


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

# As MIN_RAYS_PER_THREAD: so many tests of a ray and a primitive, so many rays whose candidates integers choose from.
MIN_TESTS_PER_THREAD, MIN_EXACT_PER_THREAD = 1 << 15, 64

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
        cast, least = _brute_force_caster, MIN_TESTS_PER_THREAD // max(len(kind.ids), 1)
        if tree:
            cast, least = _bvh_caster, MIN_RAYS_PER_THREAD
        parallel_for(cast(mode, kind, rays, sketch), len(rays.t_min), threads, least=least)

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
    mine, theirs = exact_hit(kind.prims, k, rays, i), exact_hit(other.prims, j, rays, i)
    return precedes(mine, int(kind.ids[k]), theirs, held)
