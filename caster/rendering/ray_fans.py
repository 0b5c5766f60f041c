"""Ray arrays that start at one point and sweep row by row, as a film's do, are cast as fans.

Whether that is faster is estimated from a sample of the rays. The hits have the same bits as those of single rays.
"""

from typing import NamedTuple

import numpy as np

from caster.description.transform import row_lengths
from caster.geometry.packing import Packed
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import HEIGHT, PIXELS, WIDTH, tile_boxes
from caster.kernels.surface.lighting import NOWHERE, PointLight
from caster.rendering.bvh_construction import uses_bvh, vec3
from caster.rendering.ray_tiles import MIN_SHADOW_RAYS_PER_PRIMITIVE, Piece, RayTiles, TileCaster, numbers_between

SAMPLED_RAYS = 64  # by which a common origin is found


def sampled(rays: Rays, count: int) -> Rays:
    """At most so many of the rays, evenly spread, without those that are none."""
    rows = np.unique(np.linspace(0, len(rays.t_min) - 1, count).astype(np.int64))
    return rays.take(rows[rays.t_max[rows] >= 0.0])


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
    some = rays.take(slice(begin, begin + 2 * LONGEST_ROW + 2))
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


SAMPLED_DIRECTIONS = 1024  # by which it is estimated how many rays lead to something

# Fans break even with packets where a share of 0.08 to 0.18 of the rays lead to primitives with a BVH (teapot, torus
# and every-shape at four fields of view, 384 x 384 rays in rows and shuffled, AMD Zen 4).
MIN_SHARE_IN_VIEW = 0.15


def fan_tiles(packed: Packed, rays: Rays, threads: int | None) -> RayTiles | None:
    """The tiles of rays that start at one point and sweep row by row, if fans are faster for them; else None.

    Enough rays have to lead to primitives with a BVH.
    """
    count = len(rays.t_min)
    if count < MIN_RAYS_IN_ROWS or not any(uses_bvh(kind) for kind in packed.kinds):
        return None
    origins = sampled(rays, SAMPLED_RAYS).o
    if len(origins) < SAMPLED_RAYS // 2 or (origins != origins[0]).any() or (rows := find_rows(rays)) is None:
        return None
    few = int(count * PRIMITIVES_PER_RAY_IN_ROWS * MIN_SHADOW_RAYS_PER_PRIMITIVE)
    caster = TileCaster(packed, any_hit=False, light=PointLight(vec3(origins[0]), NOWHERE), rays=few)
    if not caster.fans:
        return None
    caster.prepare(threads)
    if caster.share_in_view(sampled(rays, SAMPLED_DIRECTIONS).d) < MIN_SHARE_IN_VIEW:
        return None
    return _tiles_in_rows(caster, count, rows)


def _tiles_in_rows(caster: TileCaster, count: int, rows: RayRows) -> RayTiles:
    """Tiles of rays that lie beside and below each other, and those of the rays before and behind the whole rows."""
    first, width, height = rows
    grid = np.arange(HEIGHT, dtype=np.int32)[:, None] * np.int32(width) + np.arange(WIDTH, dtype=np.int32)

    def numbers_of(piece: Piece) -> np.ndarray:
        if len(piece) == 2:
            return numbers_between(WIDTH, piece)
        x0, y0, x1, y1 = piece
        numbers = grid[: y1 - y0] + np.int32(first + y0 * width + x0)
        numbers[:, x1 - x0 :] = -1
        return numbers.reshape(-1)

    ends = [(0, first), (first + width * height, count)]
    rest = [(i, min(i + PIXELS, stop)) for start, stop in ends for i in range(start, stop, PIXELS)]
    return RayTiles(caster, [*tile_boxes(width, height), *rest], numbers_of)
