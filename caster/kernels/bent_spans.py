"""Where primitives may be seen by a camera that bends straight lines: by balls around them, and how far it bends."""

import math
from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.protocol import Vec3, bent, hull_point, hull_size, project_ball
from caster.kernels.spans import Picture, around, corner, endless, keep_span, lies_between
from caster.kernels.vec import LARGEST_SQUARE, SMALLEST_SQUARE, along, dot, size, sub


@jit
def find_spans_around(
    prims: Any, camera: Any, window: Any, spans: Any, reach: tuple[float, float], start: int, stop: int
) -> None:
    """The spans of primitives start..stop, by balls around their points; see spans.find_spans."""
    corners = hull_size(prims)
    for k in range(start, stop):
        keep_span_around(prims, camera, window, spans, reach, k, corners)


@inlined
def keep_span_around(
    prims: Any, camera: Any, window: Any, spans: Any, reach: Any, k: int, corners: int
) -> None:
    """Of primitive k, which has so many points."""
    center, r = ball_around(prims, k, corners)
    left, top, right, bottom, least, valid = project_ball(camera, center, r + reach[0])
    wide = reach[1] if valid else math.inf
    box = left - wide, top - wide, right + wide, bottom + wide, least
    keep_span(spans, k, box, math.inf, reach[0], window)


# Roundings of a radius are some 4 u of it.
ROUND = 1.0 + 2.0**-40


@inlined
def ball_around(prims: Any, k: int, corners: int) -> tuple[Vec3, float]:
    """(centre, radius) of a ball that holds primitive k; a radius of inf for a kind without bounds."""
    if corners == 0:
        return (0.0, 0.0, 0.0), math.inf
    center, square, widest = (0.0, 0.0, 0.0), 0.0, 0.0
    for j in range(corners):
        center = along(center, 1.0 / max(corners, 1), hull_point(prims, k, j))
    for j in range(corners):
        apart = sub(hull_point(prims, k, j), center)
        square, widest = max(square, dot(apart, apart)), max(widest, size(apart))
    plain = (square > SMALLEST_SQUARE) & (square < LARGEST_SQUARE)
    return center, ROUND * (math.sqrt(square) if plain else widest)


@jit
def find_spans_of_bent_faces(
    prims: Any, camera: Any, window: Any, spans: Any, reach: Any, start: int, stop: int
) -> None:
    """The same for triangles between points whose pictures are known; of large ones by balls, too."""
    for k in range(start, stop):
        a, b, c = corner(spans, k, 0), corner(spans, k, 1), corner(spans, k, 2)
        left, top, right, bottom, least = around(around(around(endless(), a), b), c)
        wide, high = right - left, bottom - top
        more, share, valid = bent(camera, math.sqrt(wide * wide + high * high))
        if not valid or more > wide + high:
            keep_span_around(prims, camera, window, spans, reach, k, 3)
            continue
        box = left - more, top - more, right + more, bottom + more, least * share
        x0, y0, x1, y1 = keep_span(spans, k, box, math.inf, reach[0], (0, 0, window.width, window.height))
        if (x1 - x0) * (y1 - y0) == 1:
            hidden = lies_between(wider(a, more), wider(b, more), wider(c, more), x0, y0)
            spans.pixels[k, 2] = x0 if hidden else x1


@inlined
def wider(point: Picture, more: float) -> Picture:
    return point[0], point[1], point[2] + more, point[3]
