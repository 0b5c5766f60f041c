"""Ray arrays that share a point or a direction as fans: in rows, as a film's are, or sorted.

The shared point, and whether fans are faster, is estimated from a sample of the rays. The hits have the same bits as
those of single rays.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from caster.description.transform import dot_rows, inverse, row_lengths
from caster.geometry.packing import Packed
from caster.jit.simd import LANES
from caster.kernels.bvh.build import MAX_PRIMITIVES
from caster.kernels.bvh.fans import BLOCKS_ACROSS, BLOCKS_DOWN, ROWS, RUNS_ACROSS, Fan
from caster.kernels.bvh.ray_sorting import KEYS, count_strays, find_keys, order_by_keys, project_rays
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import HEIGHT, PIXELS, WIDTH, tile_boxes
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.rendering.bvh_construction import uses_bvh, vec3
from caster.rendering.ray_tiles import MIN_SHADOW_RAYS_PER_PRIMITIVE, Piece, RayTiles, TileCaster, filled_up
from caster.rendering.threads import even_pieces, parallel_for, parallel_for_pieces, thread_count

__all__ = ["SAMPLED_RAYS", "find_rows"]


class CommonPoint(NamedTuple):
    """The point or direction that the rays of an array share."""

    light: PointLight | DirectionalLight  # where they end, start or come from; its intensity is of no use
    outward: bool  # whether the rays start at the point
    deviation: float  # by how much they may miss the point, along any axis


MIN_RAYS_SORTED = 1 << 16  # to sort fewer takes as long as it saves
SAMPLED_RAYS = 64

# Rays to one point, rounded to float32, pass it by 2^-23 of their largest coordinate or less.
MAX_DEVIATION = 2.0**-20
# What is computed of a deviation is off by 8 u of the coordinates; a sample may lack the largest.
DEVIATION_ROUNDING, SAMPLE_MARGIN = 64.0 * 2.0**-53, 4.0


def common_point(rays: Rays, any_hit: bool) -> CommonPoint | None:
    """The point that a sample of the rays shares, or for any-hit rays the direction; None if they share neither.

    For rays that end at a point, it is the least-squares intersection of their lines.
    """
    sample = np.unique(np.linspace(0, len(rays.t_min) - 1, SAMPLED_RAYS).astype(np.int64))
    sample = sample[rays.t_max[sample] >= 0.0]
    if len(sample) < SAMPLED_RAYS // 2:
        return None
    some = Rays(*(a[sample] for a in rays))
    if (some.o == some.o[0]).all():
        return CommonPoint(PointLight(vec3(some.o[0]), NO_INTENSITY), True, 0.0)
    if not any_hit:
        return None
    if (some.d == some.d[0]).all():
        return CommonPoint(DirectionalLight(vec3(some.d[0]), NO_INTENSITY), False, 0.0)
    if not np.isfinite(some.t_max).all():
        return None
    lengths = row_lengths(some.d)
    unit = some.d / lengths[:, None]
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        middle = some.o.mean(axis=0)
        pulled = (across * (some.o - middle)[:, None, :]).sum(axis=(0, 2))
        point = middle + dot_rows(inverse(across.sum(axis=0)), pulled)
        along = ((point - some.o) * unit).sum(axis=1)  # the distance to where each ray is nearest to the point
        beside = float(np.abs(some.o + along[:, None] * unit - point).max())
        off = max(beside, float((some.t_max * lengths - along).max()))
        size = float(np.abs(some.o).max() + np.abs(point).max())
        if np.isfinite(size) and off <= MAX_DEVIATION * size:
            light = PointLight(vec3(point), NO_INTENSITY)
            return CommonPoint(light, False, SAMPLE_MARGIN * off + DEVIATION_ROUNDING * size)
    return None


NO_INTENSITY = 0.0, 0.0, 0.0


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


def find_rows(rays: Rays) -> RayRows | None:
    """The rows of rays that start at one point, by directions from the middle of the array on; None: there are none.

    The result decides only how tiles are filled: wrong rows give the same hits.
    """
    count = len(rays.t_min)
    begin = max(0, count // 2 - LONGEST_ROW)
    some = Rays(*(a[begin : begin + 2 * LONGEST_ROW + 2] for a in rays))
    with np.errstate(all="ignore"):
        x, y, z = np.abs(np.diff(some.d / row_lengths(some.d)[:, None], axis=0)).T
        steps = np.maximum(np.maximum(x, y), z)
    there = some.t_max >= 0.0  # where there is no ray, no end is seen
    steps[~(there[1:] & there[:-1])] = 0.0
    ends = np.flatnonzero(steps > ROW_JUMP * steps.sum() / max(np.count_nonzero(steps), 1)) + 1
    width = int(np.diff(ends).min(initial=count))
    if len(ends) < 2 or width < WIDTH // 2 or ((ends - ends[0]) % width).any():
        return None
    first = int(begin + ends[0]) % width
    return RayRows(first, width, (count - first) // width)


def fan_tiles(
    packed: Packed, rays: Rays, any_hit: bool, threads: int | None, *, always: bool = False
) -> Iterator[RayTiles] | None:
    """The tiles of rays that share a point, if fans are faster for them or `always` is set; else None.

    Fans are faster for rays that sweep from one point row by row, and for larger unordered arrays. Enough rays have to
    lead to primitives with a BVH.
    """
    count = len(rays.t_min)
    if not any(uses_bvh(kind) for kind in packed.kinds) or not (always or count >= MIN_RAYS_IN_ROWS):
        return None
    common = common_point(rays, any_hit)
    if common is None:
        return None
    rows = find_rows(rays) if common.outward else None
    if rows is None and not (always or count >= MIN_RAYS_SORTED):
        return None
    few = int(count * PRIMITIVES_PER_RAY_IN_ROWS * MIN_SHADOW_RAYS_PER_PRIMITIVE) if rows else count
    number = MAX_PRIMITIVES if always else few
    light, outward, deviation = common
    caster = TileCaster(packed, any_hit=any_hit, light=light, rays=number, outward=outward, deviation=deviation)
    fan = caster.first_fan
    if fan is None:
        return None
    sample = project_sample(fan, rays, outward)
    if not always and (len(sample.points) == 0 or (rows is None and sample.in_order)):
        return None
    caster.prepare(threads)
    if not always and sample.share * caster.share_in_view(sample.points) < MIN_SHARE_IN_VIEW:
        return None
    if rows is not None:
        return _tiles_in_rows(caster, count, rows)
    strays: list[int] = []
    parallel_for(lambda a, b: strays.append(count_strays(fan, rays, outward, deviation, a, b)), count, threads)
    if any(strays):
        return None
    one_range = all((limits == limits[0]).all() for limits in (rays.t_min, rays.t_max))
    return _sorted_tiles(caster, fan, rays, outward, sample.corners, one_range, threads)


def _tiles_in_rows(caster: TileCaster, count: int, rows: RayRows) -> Iterator[RayTiles]:
    """Tiles of rays that lie beside and below each other, and those of the rays before and behind the whole rows."""
    first, width, height = rows
    grid = np.arange(HEIGHT, dtype=np.int32)[:, None] * np.int32(width) + np.arange(WIDTH, dtype=np.int32)

    def numbers_in_box(piece: Piece) -> np.ndarray:
        x0, y0, x1, y1 = piece
        numbers = grid[: y1 - y0] + np.int32(first + y0 * width + x0)
        numbers[:, x1 - x0 :] = -1
        return numbers.reshape(-1)

    yield RayTiles(caster, list(tile_boxes(width, height)), numbers_in_box)
    ends = [(0, first), (first + width * height, count)]
    rest = [(i, min(i + PIXELS, stop)) for start, stop in ends for i in range(start, stop, PIXELS)]
    yield RayTiles(caster, rest, lambda piece: filled_up(np.arange(*piece, dtype=np.int32), WIDTH))


# The rays of a sorted run fill a block of a tile before the next, and a group: which of the run is at each place.
PLACES = (
    np.arange(PIXELS)
    .reshape(HEIGHT // (BLOCKS_DOWN * ROWS), RUNS_ACROSS // BLOCKS_ACROSS, BLOCKS_DOWN, BLOCKS_ACROSS, ROWS, LANES)
    .transpose(0, 2, 4, 1, 3, 5)
    .reshape(-1)
)


def _sorted_tiles(
    caster: TileCaster, fan: Fan, rays: Rays, outward: bool, corners: "Corners", one_range: bool, threads: int | None
) -> Iterator[RayTiles]:
    """Tiles of rays that are neighbours in the projection, MAX_RAYS_SORTED of them at a time."""
    count = len(rays.t_min)
    for first, stop in even_pieces(0, count, -(-count // MAX_RAYS_SORTED)):
        order = filled_up(sort_rays(fan, rays, outward, (first, stop), corners, threads), PIXELS)
        pieces = [(start,) for start in range(0, len(order), PIXELS)]

        def numbers(piece: Piece, order: np.ndarray = order) -> np.ndarray:
            found: np.ndarray = order[piece[0] : piece[0] + PIXELS][PLACES]
            return found

        yield RayTiles(caster, pieces, numbers, outward, one_range)


MAX_RAYS_SORTED = 1 << 20  # at a time
MIN_RAYS_PER_COUNT = 1 << 15  # fewer rays of a thread take less time than to add up its counts of all keys

SAMPLED_RUNS, RUN_LENGTH = 128, 8  # rays of the sample: neighbours, at even distances

# Rays are in order whose neighbours are projected to within a path of so many times the distance that as many rays in
# rows and columns would have. Packets of them take as long as fans do, which have to be sorted first.
MAX_PATH_IN_ORDER = 16.0

# A ray past everything takes a third of the time of sorting it. Fans break even with packets at shares of 0.08 to 0.18
# (teapot, torus and every-shape at four fields of view, 384 x 384 rays in rows and shuffled, AMD Zen 4).
MIN_SHARE_IN_VIEW = 0.15

Corners = tuple[float, float, float, float]


class ProjectedSample(NamedTuple):
    """Rays in the projection of a fan, by a sample of them."""

    points: np.ndarray  # (m, 2) x, y of those that the fan has
    share: float  # of the rays that the fan has
    corners: Corners  # least x, y and largest x, y
    in_order: bool


def project_sample(fan: Fan, rays: Rays, outward: bool) -> ProjectedSample:
    """A sample of the rays, in runs of neighbours."""
    count = len(rays.t_min)
    starts = np.linspace(0, count - RUN_LENGTH, SAMPLED_RUNS).astype(np.int64)
    sample = (starts[:, None] + np.arange(RUN_LENGTH)).ravel()
    points = np.empty((len(sample), 2))
    project_rays(fan, Rays(*(a[sample] for a in rays)), outward, points)
    known = points[~np.isnan(points[:, 0])]
    if not len(known):
        return ProjectedSample(known, 0.0, (0.0, 0.0, 0.0, 0.0), False)
    (x0, y0), (x1, y1) = known.min(axis=0).tolist(), known.max(axis=0).tolist()
    paths = np.abs(np.diff(points.reshape(SAMPLED_RUNS, RUN_LENGTH, 2), axis=1)).sum(axis=(1, 2))
    paths = paths[np.isfinite(paths)]
    apart = math.sqrt((x1 - x0) * (y1 - y0) / count)
    in_order = len(paths) > 0 and bool(np.median(paths) <= MAX_PATH_IN_ORDER * apart)
    return ProjectedSample(known, len(known) / len(points), (x0, y0, x1, y1), in_order)


def sort_rays(
    fan: Fan, rays: Rays, outward: bool, ray_range: tuple[int, int], corners: Corners, threads: int | None
) -> np.ndarray:
    """Numbers of a range of rays, sorted by key (ray_sorting.py)."""
    first, stop = ray_range
    workers = thread_count(threads)
    pieces = list(enumerate(even_pieces(first, stop, min(workers, -(-(stop - first) // MIN_RAYS_PER_COUNT)))))
    counts = np.zeros((len(pieces), KEYS), np.int64)
    keys, order = np.empty((2, stop - first), np.int32)

    def in_pieces(work: Callable[[int, tuple[int, int]], None]) -> None:
        parallel_for_pieces(lambda: lambda numbered: work(*numbered), pieces, workers)

    in_pieces(lambda n, piece: find_keys(fan, rays, outward, corners, first, piece, keys, counts[n]))
    # each key has a part for each piece, in the order of the rays
    places = np.ascontiguousarray(np.cumsum(counts.T).reshape(KEYS, len(pieces)).T - counts)
    in_pieces(lambda n, piece: order_by_keys(keys, places[n], first, piece, order))
    return order
