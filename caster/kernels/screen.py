"""Culling 1: each primitive against the pixels of a rectangle that holds its picture.

For cameras that keep straight lines straight (a common origin, or a common direction): the picture of a
convex hull lies in the box around the pictures of its points.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import LANES, any_reaches
from caster.kernels.protocol import (
    Vec3,
    hull_point,
    hull_size,
    intersect,
    numbers,
    prepare,
    project,
    project_ball,
)
from caster.kernels.tile import (
    DX,
    DY,
    DZ,
    HEIGHT,
    OFF,
    OX,
    OY,
    OZ,
    SIZE,
    T_MAX,
    T_MIN,
    VIEW,
    WIDTH,
    Box,
    T,
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


class Spans(NamedTuple):
    """Where the primitives of a kind may be seen."""

    pixels: np.ndarray  # (n, 4) int32: x_start, y_start, x_stop, y_stop in the window
    near: np.ndarray  # (n,) float64: nothing of it has a smaller depth
    faces: (
        np.ndarray
    )  # (n, 3) int32: of triangles, their corners' places in `pictures`; of other kinds (0, 3)
    pictures: np.ndarray  # (m, 4) float64, a Picture each, in pixels of the window
    forward: Vec3  # along which depth counts
    least: float  # a depth times this is no more than t: 1 over the length of the longest d


Picture = tuple[float, float, float, float]
"""(x, y, how far around it to look, in pixels, inf where it has no picture; depth)"""

# Nothing of a primitive is nearer than the least depth of its points, by more than the `slack` that its box is widened
# by: 24 u times the largest coordinates (tree.REACH), where depth is off by some 12 u of them; and again as much for
# the hits themselves. The factor is for the rounding of `reach_of`.
NEARER = 1.0 - 2.0**-40


@inlined
def picture(camera: Any, p: Any, reach: tuple[float, float]) -> Picture:
    """Of one point."""
    x, y, pixels, depth, valid = project(camera, p)
    return x, y, reach[1] + reach[0] * pixels if valid else math.inf, depth


@inlined
def endless() -> tuple[float, float, float, float, float]:
    """(left, top, right, bottom, least depth) before any point has been seen."""
    return math.inf, math.inf, -math.inf, -math.inf, math.inf


@inlined
def around(box: tuple[float, float, float, float, float], point: Picture) -> Any:
    """A box and least depth that hold one more point."""
    x, y, wide, depth = point
    left, top, right, bottom, least = box
    return (
        min(left, x - wide),
        min(top, y - wide),
        max(right, x + wide),
        max(bottom, y + wide),
        min(least, depth),
    )


@inlined
def corner(spans: Any, k: int, j: int) -> Picture:
    """The picture of a triangle's corner."""
    i = spans.faces[k, j]
    return spans.pictures[i, 0], spans.pictures[i, 1], spans.pictures[i, 2], spans.pictures[i, 3]


@inlined
def keep_span(spans: Any, k: int, box: Any, deepest: float, slack: float, window: Any) -> None:
    """Turn the box of primitive k, whose points are no deeper than `deepest`, into pixels."""
    left, top, right, bottom, least = box
    if deepest < -slack:  # all of it is behind
        spans.pixels[k, 0], spans.pixels[k, 1], spans.pixels[k, 2], spans.pixels[k, 3] = 0, 0, 0, 0
        return
    x0, y0, width, height = window
    spans.pixels[k, 0], spans.pixels[k, 2] = pixel_span(left, right, x0, width)
    spans.pixels[k, 1], spans.pixels[k, 3] = pixel_span(top, bottom, y0, height)
    near = (least - 2.0 * slack) * NEARER
    spans.near[k] = near if near > 0.0 else 0.0  # also where it is none: inf - inf


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
    """The spans of primitives start..stop.

    reach: how far beyond its points a primitive may be seen, in scene units (the slack) and in pixels.
    """
    corners = hull_size(prims)
    for k in range(start, stop):
        box, deepest = endless(), -math.inf
        for j in range(corners):
            point = picture(camera, hull_point(prims, k, j), reach)
            box, deepest = around(box, point), max(deepest, point[3])
        if corners == 0:  # a kind without bounds
            box, deepest = (-math.inf, -math.inf, math.inf, math.inf, -math.inf), math.inf
        keep_span(spans, k, box, deepest, reach[0], window)


@jit
def find_spans_of_balls(
    prims: Any, camera: Any, window: Any, spans: Any, reach: tuple[float, float], start: int, stop: int
) -> None:
    """The same for balls, which fill the boxes around them badly."""
    slack, margin = reach
    for k in range(start, stop):
        r, center = prims.radius[k], (prims.center[k, 0], prims.center[k, 1], prims.center[k, 2])
        left, top, right, bottom, least, valid = project_ball(camera, center, r + slack)
        wide = margin if valid else math.inf
        box = left - wide, top - wide, right + wide, bottom + wide, least
        keep_span(spans, k, box, least + 2.0 * (r + slack), slack, window)


@jit
def find_pictures(
    points: Any, camera: Any, window: Any, pictures: Any, reach: Any, start: int, stop: int
) -> None:
    """pictures (n, 4) of points start..stop, which several triangles share."""
    for i in range(start, stop):
        x, y, wide, depth = picture(camera, (points[i, 0], points[i, 1], points[i, 2]), reach)
        pictures[i, 0], pictures[i, 1] = x - window.x0, y - window.y0
        pictures[i, 2], pictures[i, 3] = wide, depth


@jit
def find_spans_of_faces(window: Any, spans: Any, reach: Any, start: int, stop: int) -> None:
    """The same as `find_spans`, for triangles between points whose pictures are known."""
    for k in range(start, stop):
        box, deepest = endless(), -math.inf
        for j in range(3):
            point = corner(spans, k, j)
            box, deepest = around(box, point), max(deepest, point[3])
        keep_span(spans, k, box, deepest, reach[0], (0, 0, window.width, window.height))


@inlined
def is_seen(pixels: Any, k: int) -> bool:
    return (pixels[k, 0] < pixels[k, 2]) & (pixels[k, 1] < pixels[k, 3])


# Within a tile, primitives are sorted into drawers by their least depth: by its exponent and 4 bits of the fraction.
# The farthest 8 powers of two have drawers of their own; what is nearer, or behind, shares the first.
DRAWERS, SHIFT = 128, 52 - 4


@inlined
def drawer(bits: int, last: int) -> int:
    """Farther primitives are in later drawers; bits, last: of depths, as int64, and of the largest that may be."""
    return min(max(DRAWERS - 1 - ((last >> SHIFT) - (bits >> SHIFT)), 0), DRAWERS - 1)


@jit
def count_in_tiles(
    pixels: Any, bits: Any, last: int, queue: Any, across: int, counts: Any, start: int, stop: int
) -> int:
    """How many spans reach into each tile, of primitives queue[start:stop]: counts[n * DRAWERS + drawer].

    Tiles go row by row, `across` in a row. A queue without members stands for all primitives in their own order.
    Returns how many primitives are looked for anywhere.
    """
    seen = 0
    for place in range(start, stop):
        k = queue[place] if len(queue) > 0 else place
        if is_seen(pixels, k):
            seen += 1
            into = drawer(bits[k], last)
            for y in range(pixels[k, 1] // HEIGHT, (pixels[k, 3] - 1) // HEIGHT + 1):
                for x in range(pixels[k, 0] // WIDTH, (pixels[k, 2] - 1) // WIDTH + 1):
                    counts[(y * across + x) * DRAWERS + into] += 1
    return seen


@jit
def sort_into_tiles(
    pixels: Any, bits: Any, last: int, queue: Any, across: int, ends: Any, order: Any, start: int, stop: int
) -> None:
    """Write them to order[ends[n * DRAWERS + drawer]:], for each tile n they reach into, moving that end on."""
    for place in range(start, stop):
        k = queue[place] if len(queue) > 0 else place
        if is_seen(pixels, k):
            into = drawer(bits[k], last)
            for y in range(pixels[k, 1] // HEIGHT, (pixels[k, 3] - 1) // HEIGHT + 1):
                for x in range(pixels[k, 0] // WIDTH, (pixels[k, 2] - 1) // WIDTH + 1):
                    n = (y * across + x) * DRAWERS + into
                    order[ends[n]] = k
                    ends[n] += 1


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


@jit
def reach_of(tile: Any, box: Box, forward: Any) -> float:
    """By how much a depth is at least to be multiplied for a ray of the tile to be at it: t d . forward = depth."""
    for j in range(lane(LANES)):
        tile[VIEW + j] = 0.0
    for y in range(box[3] - box[1]):
        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            for j in range(lane(LANES)):  # some maxima side by side, so that several are compared at once
                i = first + j
                ahead = tile[DX + i] * forward[0] + tile[DY + i] * forward[1] + tile[DZ + i] * forward[2]
                tile[VIEW + j] = max(tile[VIEW + j], ahead)
    most = 0.0
    for j in range(lane(LANES)):
        most = max(most, tile[VIEW + j])
    return 1.0 / most if most > 0.0 else 0.0


@jit
def farthest(tile: Any, box: Box) -> float:
    """How far a tile can be seen into anywhere: inf if only at one pixel, which is soon found."""
    for j in range(lane(LANES)):
        tile[VIEW + j] = 0.0
    for y in range(box[3] - box[1]):
        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            if any_reaches(tile, T + first, OFF + first, math.inf):
                return math.inf
            for j in range(lane(LANES)):
                tile[VIEW + j] = max(tile[VIEW + j], tile[T + first + j] + tile[OFF + first + j])
    far = 0.0
    for j in range(lane(LANES)):
        far = max(far, tile[VIEW + j])
    return far


# In spans of no more pixels, what is hidden is looked for once, not in each row again: few show in part.
FEW = 256


@jit
def cast_shared_origin(prims: Any, order: Any, run: Any, spans: Any, base: int, box: Box, tile: Any) -> None:
    """Primitives order[run[0]:run[1]] of a kind whose places begin at `base`, for rays that start in one point."""
    o = tile[OX], tile[OY], tile[OZ]
    far, tried, patience, stretch = math.inf, 0, SIZE, spans.least
    for at in range(run[0], run[1]):
        k = order[at]
        near, span = max(spans.near[k], 0.0) * stretch, within_tile(spans.pixels, k, box)
        if near > far or not may_show_in(tile, span, near):
            continue
        x_start, y_start, x_stop, y_stop = span
        tries = (x_stop - x_start) * (y_stop - y_start)
        small = tries <= FEW
        pre, place = prepare(prims, numbers(prims, k), o), float(base + k)
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
        if tried > patience:  # worth a look at what all of this has covered, and at the tile's own directions
            far, tried = farthest(tile, box), 0
            if far < math.inf:
                stretch = reach_of(tile, box, spans.forward)
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
        if near > far or not may_show_in(tile, span, near):
            continue
        x_start, y_start, x_stop, y_stop = span
        tries = (x_stop - x_start) * (y_stop - y_start)
        small = tries <= FEW
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
        if tried > patience:
            far, tried = farthest(tile, box), 0
            if far < math.inf:
                stretch = reach_of(tile, box, spans.forward)
            else:
                patience *= 2
