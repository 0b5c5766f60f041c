"""Rasterization: casts the rays of a tile at its primitives in order of depth."""

import math
from typing import Any

from caster.jit.decorators import inlined, jit
from caster.jit.simd import LANES, larger, largest, least, lesser, load_lanes, prefetch, splat
from caster.kernels.math.lanes import any_sum_reaches
from caster.kernels.protocol import Vec3, intersect, load, prefetch_numbers, prepare, t_lower_bound
from caster.kernels.raster.screen_bounds import pixel_range, projected_corner
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    OX,
    PIXELS,
    T_ERROR,
    T_MAX,
    T_MIN,
    WIDTH,
    Box,
    T,
    cast_lanes,
    get,
    lane,
    update_nearest,
)


@jit
def max_visible_t(tile: Any, box: Box) -> float:
    """The largest visible t of a tile; inf if a pixel has no hit."""
    far = splat(0.0)
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            far = larger(far, load_lanes(tile, T + i) + load_lanes(tile, T_ERROR + i))
    return largest(far)


@inlined
def direction_bounds(tile: Any, box: Box) -> tuple[Vec3, Vec3]:
    """(low, high): bounds of the components of all d of a tile."""
    x, y, z = field_bounds(tile, DX, box), field_bounds(tile, DY, box), field_bounds(tile, DZ, box)
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])


@inlined
def field_bounds(tile: Any, field: Any, box: Box) -> tuple[float, float]:
    """(least, largest) of a field, over the tile's part of a box in whole LANES."""
    low, high = splat(math.inf), splat(-math.inf)
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            v = load_lanes(tile, field + i)
            low, high = lesser(low, v), larger(high, v)
    return least(low), largest(high)


# Each primitive is tested in the pixels of its screen bounds (caster/kernels/raster/screen_bounds.py).


@inlined
def bounds_in_tile(pixels: Any, k: int, box: Box) -> Box:
    """The span of primitive k inside the tile of a box, counted from its corner; x_start and x_stop in whole LANES."""
    x_start, y_start = max(pixels[k, 0] - box[0], 0), max(pixels[k, 1] - box[1], 0)
    x_stop, y_stop = min(pixels[k, 2], box[2]) - box[0], min(pixels[k, 3], box[3]) - box[1]
    return x_start // LANES * LANES, y_start, -(-x_stop // LANES) * LANES, y_stop


# Triangles that are so many pixels wide in a tile are bounded row by row: half of the box around a triangle lies
# outside of it, and to bound a row takes as long as three or four vectors of lanes.
ROW_BOUNDS_MIN_WIDTH = 64


@jit
def row_bounds(bounds: Any, k: int, box: Box, rect: Box, y: int) -> tuple[int, int]:
    """The pixels of triangle k in row y of a tile, in whole LANES."""
    row, low, high = box[1] + y + 0.5, math.inf, -math.inf
    for j in range(3):
        xa, ya, wide, _ = projected_corner(bounds, bounds.faces[k, j])
        xb, yb, wide_b, _ = projected_corner(bounds, bounds.faces[k, (j + 1) % 3])
        wide = max(wide, wide_b)
        if not wide < math.inf:
            return rect[0], rect[2]
        top, bottom = min(ya, yb), max(ya, yb)
        if top - wide <= row <= bottom + wide:
            if bottom - top > wide:  # the part of the edge that is no farther than `wide` above or below
                slope = (xb - xa) / (yb - ya)
                xb = xa + (min(max(row + wide, top), bottom) - ya) * slope
                xa = xa + (min(max(row - wide, top), bottom) - ya) * slope
            low, high = min(low, min(xa, xb) - wide), max(high, max(xa, xb) + wide)
    start, stop = pixel_range(low - box[0], high - box[0], box[2] - box[0])
    return max(start // LANES * LANES, rect[0]), min(-(-stop // LANES) * LANES, rect[2])


@inlined
def any_pixel_visible(tile: Any, rect: Box, near: float) -> bool:
    """Whether one of the rays of a span may hit something at t >= near first."""
    x_start, y_start, x_stop, y_stop = rect
    for y in range(y_start, y_stop):
        for first in range(lane(y * WIDTH + x_start), lane(y * WIDTH + x_stop), lane(LANES)):
            if any_sum_reaches(tile, T + first, T_ERROR + first, near):
                return True
    return False


# Numbers of primitives are prefetched so many ahead: a primitive takes some 30 ns, and so does a line of the last
# cache.
FIRST_AHEAD, THEN_AHEAD = 8, 4


@inlined
def prefetch_ahead(prims: Any, order: Any, at: int, stop: int, bounds: Any) -> None:
    """Prefetch the numbers of primitives after order[at]."""
    if at + FIRST_AHEAD < stop:
        k = order[at + FIRST_AHEAD]
        prefetch(bounds.near, k)
        prefetch(bounds.pixels, k)
        prefetch_numbers(prims, k, False)
        prefetch_numbers(prims, order[at + THEN_AHEAD], True)


# Smaller spans are tested for visibility once, not row by row: few of them are visible in part.
SINGLE_VISIBILITY_TEST_MAX_PIXELS = 256


@jit
def cast_in_bounds(
    prims: Any, order: Any, run: Any, bounds: Any, base: int, box: Box, tile: Any, shares_origin: bool
) -> None:
    """Cast a tile at the run[1] primitives from order[run[0]] on of a kind, in their screen bounds.

    base: the place of the kind's first primitive.
    shares_origin: whether all rays start at one point; else they have one direction (an orthographic camera).
    """
    o = get(tile, OX)
    far, tried, patience = math.inf, 0, PIXELS
    looked, low, high = False, o, o
    stop = run[0] + run[1]
    for at in range(run[0], stop):
        k = order[at]
        prefetch_ahead(prims, order, at, stop, bounds)
        near, rect = max(bounds.near[k], 0.0), bounds_in_tile(bounds.pixels, k, box)
        x_start, y_start, x_stop, y_stop = rect
        tries = (x_stop - x_start) * (y_stop - y_start)
        small = tries <= SINGLE_VISIBILITY_TEST_MAX_PIXELS
        if near > far or (small and not any_pixel_visible(tile, rect, near)):
            continue
        prim, prim_number = load(prims, k), float(base + k)
        pre = prepare(prims, prim, o)
        if not small:
            if shares_origin:
                if not looked:
                    (low, high), looked = direction_bounds(tile, box), True
                near = max(near, t_lower_bound(prims, pre, low, high))
                if near > far or near == math.inf:
                    continue
            if not any_pixel_visible(tile, rect, near):
                y_start = y_stop  # hidden, but that took as long to find
        by_row = len(bounds.faces) > 0 and x_stop - x_start >= ROW_BOUNDS_MIN_WIDTH
        for y in range(y_start, y_stop):
            left, right = row_bounds(bounds, k, box, rect, y) if by_row else (x_start, x_stop)
            for first in range(lane(y * WIDTH + left), lane(y * WIDTH + max(left, right)), lane(LANES)):
                if not (small or any_sum_reaches(tile, T + first, T_ERROR + first, near)):
                    continue
                if shares_origin:
                    for i in range(first, first + lane(LANES)):
                        t, error = intersect(prims, pre, get(tile, DX + i), tile[T_MIN + i], tile[T_MAX + i])
                        update_nearest(tile, i, prim_number, t, error)
                else:
                    cast_lanes(prims, prim, prim_number, tile, first, False)
        tried += tries
        if tried >= patience:
            far, tried = max_visible_t(tile, box), 0  # what lies farther is hidden now
            if far == math.inf:
                patience *= 2
