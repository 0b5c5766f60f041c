"""Screen bounds of primitives: a rectangle of pixels around each, and its least depth.

A rectilinear camera projects a convex hull into the box around its projected points. Another one bends it beyond that
by a bound of its distortion; large hulls and spheres are bounded by the projections of spheres.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import inlined, jit
from caster.kernels.math.vec import LARGEST_SQUARE, SMALLEST_SQUARE, TINY, dot, hypotenuse, l1_norm, point_at, row, sub
from caster.kernels.protocol import Vec3, distortion_bound, project, project_bounding_sphere, tight_sphere
from caster.kernels.raster.tile import Box

# The margin of a rectangle around projected points, beside the distance at which the intersection test may still count
# a hit (`slack`, in scene units). It has to exceed the rounding of the projection: below 1e-9 of the film's size, where
# pinhole.MIN_DEPTH_SHARE holds, or 7e-5 pixels.
PROJECTION_MARGIN = 2.0**-10  # pixels


class Window(NamedTuple):
    """The pixels of the film that are rendered, row by row."""

    x0: int
    y0: int
    width: int
    height: int


class ScreenBounds(NamedTuple):
    """Screen bounds of the primitives of a kind."""

    pixels: np.ndarray  # (n, 4) int32: x_start, y_start, x_stop, y_stop in the window
    near: np.ndarray  # (n,) float64, a lower bound of the depth
    # (n, 3) int32: the corners in `projected` of triangles before a rectilinear camera; else (0, 3)
    faces: np.ndarray
    projected: np.ndarray  # (m, 4) float64, a projection each, in pixels of the window


ProjectedPoint = tuple[float, float, float, float]
"""(x, y, margin in pixels, or inf if the point is not projected, depth)"""

# No part of a primitive is nearer than the least depth of its points by more than the `slack` of its box: 24 u times
# the largest coordinates (BOX_PADDING), since depth is off by some 12 u of them; and again as much for the hits
# themselves. The factor is for a d that is longer than 1 by its rounding: t is at least the depth over its length.
DEPTH_ROUNDING = 1.0 - 2.0**-40


@inlined
def projected_corner(bounds: Any, i: int) -> ProjectedPoint:
    return bounds.projected[i, 0], bounds.projected[i, 1], bounds.projected[i, 2], bounds.projected[i, 3]


@inlined
def store_bounds(bounds: Any, k: int, box: Any, deepest: float, slack: float, window: Any) -> Box:
    """Store the pixels of the box of primitive k; deepest: the largest depth of its points."""
    left, top, right, bottom, least = box
    if deepest < -slack:  # all of it is behind
        left, right = math.inf, -math.inf
    x0, x1 = pixel_range(left, right, window.width)
    y0, y1 = pixel_range(top, bottom, window.height)
    bounds.pixels[k, 0], bounds.pixels[k, 1], bounds.pixels[k, 2], bounds.pixels[k, 3] = x0, y0, x1, y1
    near = (least - 2.0 * slack) * DEPTH_ROUNDING
    bounds.near[k] = near if near > 0.0 else 0.0  # also for NaN: inf - inf
    return x0, y0, x1, y1


@inlined
def pixel_range(low: float, high: float, count: int) -> tuple[int, int]:
    """Pixels start..stop (exclusive), of `count`, include all with centres in [low, high]."""
    start = min(max(low - 0.5, 0.0), float(count))
    stop = min(max(high + 0.5, 0.0), float(count))
    return math.ceil(start), math.floor(stop)


@jit
def bound_spheres(
    prims: Any, camera: Any, window: Any, bounds: Any, reach: tuple[float, float], start: int, stop: int
) -> None:
    """Screen bounds of primitives start..stop of a kind with a `tight_sphere`, by the projection of that.

    reach: the margin of a primitive around its points, in scene units (the slack) and in pixels.
    """
    for k in range(start, stop):
        center, r = tight_sphere(prims, k)
        bound_sphere(camera, window, bounds, reach, k, center, r, 2.0 * (r + reach[0]))


@inlined
def bound_sphere(
    camera: Any, window: Any, bounds: Any, reach: tuple[float, float], k: int, center: Vec3, r: float, depth: float
) -> None:
    """Screen bounds of primitive k by a sphere around it; depth: that of the sphere, or inf."""
    left, top, right, bottom, least, valid = project_bounding_sphere(camera, center, r + reach[0])
    wide = reach[1] if valid else math.inf
    x, y = float(window.x0), float(window.y0)
    box = left - wide - x, top - wide - y, right + wide - x, bottom + wide - y, least
    store_bounds(bounds, k, box, least + depth, reach[0], window)


@jit
def project_vertices(points: Any, camera: Any, window: Any, projected: Any, reach: Any, start: int, stop: int) -> None:
    """projected (n, 4): points start..stop, which several hulls may share."""
    for i in range(start, stop):
        x, y, pixels, depth, valid = project(camera, row(points, i))
        projected[i, 0], projected[i, 1] = x - window.x0, y - window.y0
        projected[i, 2], projected[i, 3] = reach[1] + reach[0] * pixels if valid else math.inf, depth


# Three in five triangles whose bounds are a single pixel do not contain its centre.


@inlined
def misses_pixel_center(bounds: Any, corners: Any, k: int, more: float, x: int, y: int) -> bool:
    """Whether a triangle certainly does not contain the centre of a pixel; more: beyond the margins of its corners."""
    a, b = projected_corner(bounds, corners[k, 0]), projected_corner(bounds, corners[k, 1])
    c, p, q = projected_corner(bounds, corners[k, 2]), x + 0.5, y + 0.5
    wide = max(max(a[2], b[2]), c[2]) + more  # inf, so that nothing is certain, if a corner is not projected
    first, second, third = edge_line(a, b, c, wide), edge_line(b, c, a, wide), edge_line(c, a, b, wide)
    return is_beyond(first, p, q) | is_beyond(second, p, q) | is_beyond(third, p, q)


@inlined
def edge_line(p: Any, q: Any, r: Any, wide: float) -> Vec3:
    """The line (a, b, c) through the projections of p and q, moved away from r by `wide` along each axis.

    Corners that are off by up to `wide` along x and y do not lie beyond it, nor do points between them.
    """
    x, y = q[0] - p[0], q[1] - p[1]
    side = 1.0 if x * (r[1] - p[1]) - y * (r[0] - p[0]) >= 0.0 else -1.0
    return -side * y, side * x, side * (y * p[0] - x * p[1]) + ((abs(x) + abs(y)) * wide + TINY)


@inlined
def is_beyond(line: Vec3, x: float, y: float) -> bool:
    """Whether a point lies beyond a line."""
    return line[0] * x + line[1] * y + line[2] < 0.0


EVERYWHERE = -math.inf, -math.inf, math.inf, math.inf, -math.inf  # the box of a kind without bounds


# Roundings of a radius are some 4 u of it.
RADIUS_ROUNDING = 1.0 + 2.0**-40


@inlined
def bounding_sphere(points: Any, corners: Any, k: int) -> tuple[Vec3, float]:
    """(centre, radius) of a sphere around hull k."""
    count = corners.shape[1]
    center, square, widest = (0.0, 0.0, 0.0), 0.0, 0.0
    for j in range(count):
        center = point_at(center, 1.0 / count, row(points, corners[k, j]))
    for j in range(count):
        apart = sub(row(points, corners[k, j]), center)
        square, widest = max(square, dot(apart, apart)), max(widest, l1_norm(apart))
    plain = (square > SMALLEST_SQUARE) & (square < LARGEST_SQUARE)
    return center, RADIUS_ROUNDING * (math.sqrt(square) if plain else widest)


@jit
def bound_hulls(
    points: Any, corners: Any, camera: Any, window: Any, bounds: Any, reach: tuple[float, float], start: int, stop: int
) -> None:
    """Screen bounds of the convex hulls start..stop of projected points; corners: (n, points) int32, or none at all.

    Before a camera that is not rectilinear, by a bound of its distortion; large hulls by spheres.
    """
    for k in range(start, stop):
        if corners.shape[1] == 0:
            store_bounds(bounds, k, EVERYWHERE, math.inf, reach[0], window)
            continue
        left, top, right, bottom, least, deepest = math.inf, math.inf, -math.inf, -math.inf, math.inf, -math.inf
        for j in range(corners.shape[1]):
            x, y, margin, depth = projected_corner(bounds, corners[k, j])
            left, top = min(left, x - margin), min(top, y - margin)
            right, bottom = max(right, x + margin), max(bottom, y + margin)
            least, deepest = min(least, depth), max(deepest, depth)
        wide, high = right - left, bottom - top
        more, share, valid = distortion_bound(camera, hypotenuse(wide, high))
        if not valid or more > wide + high:
            center, r = bounding_sphere(points, corners, k)
            bound_sphere(camera, window, bounds, reach, k, center, r, math.inf)
            continue
        box = left - more, top - more, right + more, bottom + more, least * share
        x0, y0, x1, y1 = store_bounds(bounds, k, box, deepest, reach[0], window)
        single = corners.shape[1] == 3 and (x1 - x0) * (y1 - y0) == 1
        if single and misses_pixel_center(bounds, corners, k, more, x0, y0):
            bounds.pixels[k, 2] = x0
