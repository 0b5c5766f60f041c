"""Culling 1: each primitive against the pixels of a rectangle that holds its picture.

For cameras that keep straight lines straight (a common origin, or a common direction): the picture of a
convex hull lies in the box around the pictures of its points.
"""

import math
from typing import Any, NamedTuple

from caster.kernels.jit import jit
from caster.kernels.protocol import hull_point, hull_size, intersect, keep_nearer, prepare, project
from caster.kernels.vec import row

# A rectangle reaches one pixel further than the projected points on each side, plus the distance at which the
# intersection test may still count a hit (`slack`, in scene units). The pixel has to outdo the rounding of
# the projection alone: below 1e-9 of the film's size, where pinhole.SHALLOWEST holds.
MARGIN = 1.0


class Window(NamedTuple):
    """Which pixels of the film there are rays for, row by row."""

    x0: int
    y0: int
    width: int
    height: int


@jit
def film_box(prims: Any, k: int, camera: Any, slack: float) -> tuple[float, float, float, float]:
    """(left, top, right, bottom) around the picture of primitive k; endless where a hull point has none."""
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for j in range(hull_size(prims)):
        x, y, pixels, valid = project(camera, hull_point(prims, k, j))
        if not valid:
            return -math.inf, -math.inf, math.inf, math.inf
        reach = MARGIN + slack * pixels
        left, top = min(left, x - reach), min(top, y - reach)
        right, bottom = max(right, x + reach), max(bottom, y + reach)
    if left > right:  # a kind without bounds
        return -math.inf, -math.inf, math.inf, math.inf
    return left, top, right, bottom


@jit
def pixel_span(low: float, high: float, first: int, count: int) -> tuple[int, int]:
    """Pixels first + start .. first + stop (exclusive) hold all whose centres lie in [low, high]."""
    start = min(max(low - 0.5 - first, 0.0), float(count))
    stop = min(max(high - 0.5 - first + 1.0, 0.0), float(count))
    return math.floor(start), math.ceil(stop)


@jit
def find_spans(prims: Any, camera: Any, window: Any, spans: Any, slack: float) -> None:
    """spans[k] = (x_start, x_stop, y_start, y_stop) within the window, for every primitive."""
    for k in range(len(spans)):
        left, top, right, bottom = film_box(prims, k, camera, slack)
        spans[k, 0], spans[k, 1] = pixel_span(left, right, window.x0, window.width)
        spans[k, 2], spans[k, 3] = pixel_span(top, bottom, window.y0, window.height)


# In the loops below, arrays are indexed by number: a row handed to a function has its references counted every time.


@jit
def cast_shared_origin(prims: Any, spans: Any, rays: Any, record: Any, band: Any) -> None:
    """The rows of a band; primitives are prepared once, for the origin that all rays share."""
    width, first_row, last_row = band
    o = row(rays.o, 0)
    for k in range(len(spans)):
        y_start, y_stop = max(spans[k, 2], first_row), min(spans[k, 3], last_row)
        if y_start >= y_stop or spans[k, 0] >= spans[k, 1]:
            continue
        pre = prepare(prims, k, o)
        for y in range(y_start, y_stop):
            for i in range(y * width + spans[k, 0], y * width + spans[k, 1]):
                d = rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]
                hit = intersect(prims, pre, d, rays.t_min[i], rays.t_max[i])
                if hit[0] < math.inf:
                    keep_nearer(record, i, prims, k, rays, hit)


@jit
def cast_own_origins(prims: Any, spans: Any, rays: Any, record: Any, band: Any) -> None:
    """The rows of a band, for rays that start in different places (an orthographic camera)."""
    width, first_row, last_row = band
    for k in range(len(spans)):
        for y in range(max(spans[k, 2], first_row), min(spans[k, 3], last_row)):
            for i in range(y * width + spans[k, 0], y * width + spans[k, 1]):
                o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
                d = rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]
                hit = intersect(prims, prepare(prims, k, o), d, rays.t_min[i], rays.t_max[i])
                if hit[0] < math.inf:
                    keep_nearer(record, i, prims, k, rays, hit)
