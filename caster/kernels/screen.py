"""Culling 1: each primitive against the pixels of a rectangle that holds its picture (kernels/spans.py)."""

import math
from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import LANES, any_reaches
from caster.kernels.outlook import directions, farthest, reach_of
from caster.kernels.protocol import intersect, nearest_t, numbers, prepare
from caster.kernels.spans import corner, pixel_span
from caster.kernels.tile import (
    DX,
    DY,
    DZ,
    OFF,
    OX,
    OY,
    OZ,
    SIZE,
    T_MAX,
    T_MIN,
    WIDTH,
    Box,
    T,
    keep_first,
    lane,
)


@inlined
def within_tile(pixels: Any, k: int, box: Box) -> Box:
    """The span of primitive k inside the tile of a box, counted from its corner; x_start and x_stop in whole LANES."""
    x_start, y_start = max(pixels[k, 0] - box[0], 0), max(pixels[k, 1] - box[1], 0)
    x_stop, y_stop = min(pixels[k, 2], box[2]) - box[0], min(pixels[k, 3], box[3]) - box[1]
    return x_start // LANES * LANES, y_start, -(-x_stop // LANES) * LANES, y_stop


# Triangles that cover so many pixels across in a tile are looked for row by row, where they are: half of the box around
# a triangle is not in it, and to find a row's part takes as long as three or four bundles of lanes.
WIDE = 64


@jit
def in_row(spans: Any, k: int, box: Box, span: Box, y: int) -> tuple[int, int]:
    """Of the span of triangle k in a tile, what row y of the tile needs; in whole LANES."""
    row, low, high = box[1] + y + 0.5, math.inf, -math.inf
    for j in range(3):
        xa, ya, wide, _ = corner(spans, k, j)
        xb, yb, wide_b, _ = corner(spans, k, (j + 1) % 3)
        wide = max(wide, wide_b)
        if not wide < math.inf:
            return span[0], span[2]
        top, bottom = min(ya, yb), max(ya, yb)
        if top - wide <= row <= bottom + wide:
            if bottom - top > wide:  # the part of the edge that is no farther than `wide` above or below
                slope = (xb - xa) / (yb - ya)
                xb = xa + (min(max(row + wide, top), bottom) - ya) * slope
                xa = xa + (min(max(row - wide, top), bottom) - ya) * slope
            low, high = min(low, min(xa, xb) - wide), max(high, max(xa, xb) + wide)
    start, stop = pixel_span(low, high, box[0], box[2] - box[0])
    return max(start // LANES * LANES, span[0]), min(-(-stop // LANES) * LANES, span[2])


@inlined
def may_show(tile: Any, first: Any, near: float) -> bool:
    """Whether one of LANES rays has met nothing sure to be nearer."""
    return any_reaches(tile, T + first, OFF + first, near)


@inlined
def may_show_in(tile: Any, span: Box, near: float) -> bool:
    """The same for a span."""
    x_start, y_start, x_stop, y_stop = span
    for y in range(y_start, y_stop):
        for first in range(lane(y * WIDTH + x_start), lane(y * WIDTH + x_stop), lane(LANES)):
            if may_show(tile, first, near):
                return True
    return False


# In spans of no more pixels, what is hidden is looked for once, not in each row again: few show in part.
FEW = 256


@jit
def cast_shared_origin(prims: Any, order: Any, run: Any, spans: Any, base: int, box: Box, tile: Any) -> None:
    """Primitives order[run[0]:run[1]] of a kind whose places begin at `base`, for rays that start in one point."""
    o = tile[OX], tile[OY], tile[OZ]
    far, tried, patience, stretch = math.inf, 0, SIZE, spans.least
    looked, low, high = False, o, o
    for at in range(run[0], run[1]):
        k = order[at]
        near, span = max(spans.near[k], 0.0) * stretch, within_tile(spans.pixels, k, box)
        x_start, y_start, x_stop, y_stop = span
        tries = (x_stop - x_start) * (y_stop - y_start)
        small = tries <= FEW
        if near > far or (small and not may_show_in(tile, span, near)):
            continue
        pre, place = prepare(prims, numbers(prims, k), o), float(base + k)
        if not small:  # worth a closer look
            if not looked:
                (low, high), looked = directions(tile, box, spans.forward), True
            near = max(near, nearest_t(prims, pre, low, high))
            if near > far or near == math.inf:
                continue
            if not may_show_in(tile, span, near):
                y_start = y_stop  # nothing to try, but that took as long
        by_row = len(spans.faces) > 0 and x_stop - x_start >= WIDE
        for y in range(y_start, y_stop):
            start, stop = in_row(spans, k, box, span, y) if by_row else (x_start, x_stop)
            for first in range(lane(y * WIDTH + start), lane(y * WIDTH + max(start, stop)), lane(LANES)):
                if small or may_show(tile, first, near):
                    for i in range(first, first + lane(LANES)):
                        d = tile[DX + i], tile[DY + i], tile[DZ + i]
                        t, off = intersect(prims, pre, d, tile[T_MIN + i], tile[T_MAX + i])
                        keep_first(tile, i, place, t, off)
        tried += tries
        if tried >= patience:
            # worth a look at what all of this has covered, and at the tile's own directions
            far, tried = farthest(tile, box), 0
            if far < math.inf:
                stretch = max(stretch, reach_of(tile, box, spans.forward))
            else:
                patience *= 2


@jit
def cast_own_origins(prims: Any, order: Any, run: Any, spans: Any, base: int, box: Box, tile: Any) -> None:
    """The same for rays of one direction that start in different places (an orthographic camera)."""
    d = tile[DX], tile[DY], tile[DZ]
    far, tried, patience, stretch = math.inf, 0, SIZE, spans.least
    for at in range(run[0], run[1]):
        k = order[at]
        near, span = max(spans.near[k], 0.0) * stretch, within_tile(spans.pixels, k, box)
        x_start, y_start, x_stop, y_stop = span
        tries = (x_stop - x_start) * (y_stop - y_start)
        small = tries <= FEW
        if near > far:
            continue
        if not may_show_in(tile, span, near):
            if small:
                continue
            y_start = y_stop  # nothing to try, but that took as long
        prim, place = numbers(prims, k), float(base + k)
        by_row = len(spans.faces) > 0 and x_stop - x_start >= WIDE
        for y in range(y_start, y_stop):
            start, stop = in_row(spans, k, box, span, y) if by_row else (x_start, x_stop)
            for first in range(lane(y * WIDTH + start), lane(y * WIDTH + max(start, stop)), lane(LANES)):
                if small or may_show(tile, first, near):
                    for i in range(first, first + lane(LANES)):
                        o = tile[OX + i], tile[OY + i], tile[OZ + i]
                        t, off = intersect(
                            prims, prepare(prims, prim, o), d, tile[T_MIN + i], tile[T_MAX + i]
                        )
                        keep_first(tile, i, place, t, off)
        tried += tries
        if tried >= patience:
            far, tried = farthest(tile, box), 0
            if far < math.inf:
                stretch = max(stretch, reach_of(tile, box, spans.forward))
            else:
                patience *= 2
