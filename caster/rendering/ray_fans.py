"""Casting of ray arrays that share a point or a direction as fans, row by row or sorted.

The shared point, and whether fans are faster, is estimated from a sample of the rays. The hits have the same bits as
those of single rays.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from caster.description.transform import dot_rows, inverse, row_lengths
from caster.geometry.packing import Packed
from caster.kernels.bvh.build import MAX_PRIMITIVES
from caster.kernels.bvh.fans import Fan
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
)
from caster.kernels.nearest import Rays
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import PIXELS, WIDTH, Box, load_rays_from, tile_boxes
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.rendering.bvh_construction import uses_bvh
from caster.rendering.ray_tiles import (
    MIN_SHADOW_RAYS_PER_PRIMITIVE,
    Record,
    ShadowCaster,
    for_ray_tiles,
    spare_workspaces,
)
from caster.rendering.threads import CHUNKS_PER_THREAD, even_pieces, parallel_for, parallel_for_pieces, thread_count

__all__ = ["SAMPLED_RAYS", "find_rows"]


class CommonPoint(NamedTuple):
    """The point or direction that nearly all rays of an array share."""

    light: PointLight | DirectionalLight  # where they end, start or come from; its intensity is of no use
    outward: bool  # whether the rays start at the point
    deviation: float  # rays that miss the point by more, along any axis, are cast like other rays


MIN_RAYS_SORTED = 1 << 16  # to sort fewer takes as long as it saves
SAMPLED_RAYS = 64

# Rays to one point, rounded to float32, pass it by 2^-23 of their largest coordinate or less.
MAX_DEVIATION = 2.0**-20
# What is computed of a deviation is off by 8 u of the coordinates; a sample may lack the largest.
DEVIATION_ROUNDING, SAMPLE_MARGIN = 64.0 * 2.0**-53, 4.0


def common_point(rays: Rays, any_hit: bool) -> CommonPoint | None:
    """The point that the rays share, or for any-hit rays the direction, from a sample; None if they share neither.

    For rays that end at a point, it is the least-squares intersection of their lines.
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
    unit = some.d / row_lengths(some.d)[:, None]
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        middle = some.o.mean(axis=0)
        pulled = (across * (some.o - middle)[:, None, :]).sum(axis=(0, 2))
        point = middle + dot_rows(inverse(across.sum(axis=0)), pulled)
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
    """Casts many rays that share a point: in rows, in their given order, or sorted by their projection."""

    def __init__(
        self, caster: ShadowCaster, common: CommonPoint, corners: Corners, rows: RayRows | None = None
    ) -> None:
        self._caster, self._common, self._corners, self._rows = caster, common, corners, rows

    @staticmethod
    def of(packed: Packed, rays: Rays, any_hit: bool, *, always: bool = False) -> "FanCaster | None":
        """A caster for rays that share a point, if fans are faster for them or `always` is set; else None.

        Fans are faster for rays that sweep from one point row by row, and for larger unordered arrays of which enough
        rays lead to primitives with a BVH.
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
        self, rays: Rays, cast_others: Callable[[int, np.ndarray], None], record: Record, threads: int | None
    ) -> None:
        """cast_others: casts the first n rays of a tile; used for rays that do not share the point."""
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
            for_ray_tiles(cast_others, rays, record, threads, rest)

    def _cast_sorted(
        self, rays: Rays, cast_others: Callable[[int, np.ndarray], None], record: Record, threads: int | None
    ) -> None:
        fan, outward = self._caster.first_fan, self._common.outward
        count = len(rays.t_min)
        same_limits = _total(partial(rays_of_other_limits, rays), count, threads) == 0
        for first, stop in even_pieces(0, count, -(-count // MAX_RAYS_SORTED)):
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
    fan: Fan, rays: Rays, common: CommonPoint, ray_range: tuple[int, int], corners: Corners, threads: int | None
) -> tuple[np.ndarray, int]:
    """(ray numbers, number of rays that share the point): these first, sorted by key (ray_sorting.py)."""
    first, stop = ray_range
    workers = thread_count(threads)
    pieces = list(enumerate(even_pieces(first, stop, workers * CHUNKS_PER_THREAD)))
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
    in_pieces(lambda n, piece: scatter_to_buckets(pairs, places[n], piece[0] - first, piece[1] - first, scattered))

    def sort(buckets: tuple[int, int]) -> None:
        sort_buckets(scattered, starts, buckets, np.empty(LOWER_CELLS, np.int64), order)

    shares = np.linspace(0, stop - first, len(pieces) + 1)
    buckets = np.unique(np.concatenate([[0, BUCKETS], np.searchsorted(starts, shares[1:-1])])).tolist()
    parallel_for_pieces(lambda: sort, list(itertools.pairwise(buckets)), workers)
    return order, int(starts[NOT_IN_FAN >> LOWER_BITS])
