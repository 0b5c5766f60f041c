"""Culling 1: each primitive against the pixels of a rectangle that holds its picture.

For cameras that keep straight lines straight (a common origin, or a common direction): the picture of a
convex hull lies in the box around the pictures of its points.
"""

import math
from typing import Any, NamedTuple

from caster.kernels.jit import inlined, jit
from caster.kernels.protocol import hull_point, hull_size, intersect, numbers, prepare, project
from caster.kernels.tile import (
    DX,
    DY,
    DZ,
    HEIGHT,
    LANES,
    OX,
    OY,
    OZ,
    T_MAX,
    T_MIN,
    WIDTH,
    Box,
    cast_lanes,
    keep_first,
    lane,
)

# A rectangle reaches so much further than the projected points on each side, plus the distance at which the
# intersection test may still count a hit (`slack`, in scene units). The margin has to outdo the rounding of the
# projection alone: below 1e-9 of the film's size, where pinhole.SHALLOWEST holds, so 7e-5 of a pixel on the largest.
MARGIN = 2.0**-10  # pixels


class Window(NamedTuple):
    """Which pixels of the film there are rays for, row by row."""

    x0: int
    y0: int
    width: int
    height: int


@inlined
def film_box(
    prims: Any, k: int, camera: Any, slack: float, margin: float
) -> tuple[float, float, float, float]:
    """(left, top, right, bottom) around the picture of primitive k; endless where a point has none; none behind."""
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    behind, corners = 0, hull_size(prims)
    for j in range(corners):
        x, y, pixels, valid = project(camera, hull_point(prims, k, j))
        behind += not valid and pixels < -slack
        reach = margin + slack * pixels if valid else math.inf
        left, top = min(left, x - reach), min(top, y - reach)
        right, bottom = max(right, x + reach), max(bottom, y + reach)
    if 0 < behind == corners:
        return math.inf, math.inf, -math.inf, -math.inf
    if left > right:  # a kind without bounds
        return -math.inf, -math.inf, math.inf, math.inf
    return left, top, right, bottom


@inlined
def pixel_span(low: float, high: float, first: int, count: int) -> tuple[int, int]:
    """Pixels first + start .. first + stop (exclusive) hold all whose centres lie in [low, high]."""
    start = min(max(low - 0.5 - first, 0.0), float(count))
    stop = min(max(high + 0.5 - first, 0.0), float(count))
    return math.ceil(start), math.floor(stop)


@jit
def find_spans(
    prims: Any, camera: Any, window: Any, spans: Any, reach: tuple[float, float], start: int, stop: int
) -> None:
    """spans[k] = (x_start, y_start, x_stop, y_stop) within the window, for primitives start..stop.

    reach: how far beyond its points a primitive may be seen, in scene units and in pixels.
    """
    for k in range(start, stop):
        left, top, right, bottom = film_box(prims, k, camera, reach[0], reach[1])
        spans[k, 0], spans[k, 2] = pixel_span(left, right, window.x0, window.width)
        spans[k, 1], spans[k, 3] = pixel_span(top, bottom, window.y0, window.height)


@jit
def count_in_tiles(spans: Any, across: int, counts: Any) -> None:
    """Add to counts[n + 1] how many spans reach into tile n; tiles go row by row, `across` in a row."""
    for k in range(len(spans)):
        if spans[k, 0] < spans[k, 2] and spans[k, 1] < spans[k, 3]:
            for y in range(spans[k, 1] // HEIGHT, (spans[k, 3] - 1) // HEIGHT + 1):
                for x in range(spans[k, 0] // WIDTH, (spans[k, 2] - 1) // WIDTH + 1):
                    counts[y * across + x + 1] += 1


@jit
def sort_into_tiles(spans: Any, across: int, ends: Any, order: Any) -> None:
    """Write primitives to order[ends[n]:], for each tile n that they reach into, moving ends[n] on."""
    for k in range(len(spans)):
        if spans[k, 0] < spans[k, 2] and spans[k, 1] < spans[k, 3]:
            for y in range(spans[k, 1] // HEIGHT, (spans[k, 3] - 1) // HEIGHT + 1):
                for x in range(spans[k, 0] // WIDTH, (spans[k, 2] - 1) // WIDTH + 1):
                    n = y * across + x
                    order[ends[n]] = k
                    ends[n] += 1


@inlined
def within_tile(spans: Any, k: int, box: Box) -> Box:
    """The span of primitive k inside the tile of a box, counted from its corner; x_start and x_stop in whole LANES."""
    x_start, y_start = max(spans[k, 0] - box[0], 0), max(spans[k, 1] - box[1], 0)
    x_stop, y_stop = min(spans[k, 2], box[2]) - box[0], min(spans[k, 3], box[3]) - box[1]
    return x_start // LANES * LANES, y_start, -(-x_stop // LANES) * LANES, y_stop


@jit
def cast_shared_origin(prims: Any, order: Any, run: Any, spans: Any, base: int, box: Box, tile: Any) -> None:
    """Primitives order[run[0]:run[1]] of a kind whose places begin at `base`, for rays that start in one point."""
    o = tile[OX], tile[OY], tile[OZ]
    for at in range(run[0], run[1]):
        k = order[at]
        x_start, y_start, x_stop, y_stop = within_tile(spans, k, box)
        pre, place = prepare(prims, numbers(prims, k), o), float(base + k)
        for y in range(y_start, y_stop):
            for first in range(lane(y * WIDTH + x_start), lane(y * WIDTH + x_stop), lane(LANES)):
                for i in range(first, first + lane(LANES)):
                    d = tile[DX + i], tile[DY + i], tile[DZ + i]
                    t, off = intersect(prims, pre, d, tile[T_MIN + i], tile[T_MAX + i])
                    keep_first(tile, i, place, t, off)


@jit
def cast_own_origins(prims: Any, order: Any, run: Any, spans: Any, base: int, box: Box, tile: Any) -> None:
    """The same for rays that start in different places (an orthographic camera)."""
    for at in range(run[0], run[1]):
        k = order[at]
        x_start, y_start, x_stop, y_stop = within_tile(spans, k, box)
        prim, place = numbers(prims, k), float(base + k)
        for y in range(y_start, y_stop):
            for first in range(lane(y * WIDTH + x_start), lane(y * WIDTH + x_stop), lane(LANES)):
                cast_lanes(prims, prim, place, tile, first)
