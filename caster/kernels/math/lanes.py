"""Tests of several rays, pixels or boxes at once, with the vectors of caster/jit/simd.py."""

from typing import Any

import numpy as np

from caster.jit.decorators import inlined
from caster.jit.simd import (
    CHILDREN,
    Vector,
    bits_below,
    bits_up_to,
    larger,
    largest,
    least,
    lesser,
    load_children,
    load_lanes,
    select,
    store,
)
from caster.kernels.math.vec import TINY
from caster.kernels.protocol import Vec3

# ---- numbers of a tile, LANES from a place on ----


@inlined
def any_sum_reaches(a: Any, i: Any, j: Any, limit: float) -> bool:
    """Whether a[i + n] + a[j + n] >= limit for one n of 0..LANES - 1."""
    return bits_up_to(limit, load_lanes(a, i) + load_lanes(a, j)) != 0


@inlined
def lane_min(a: Any, i: Any) -> float:
    """The least of a[i:i + LANES]."""
    return least(load_lanes(a, i))


@inlined
def lane_max(a: Any, i: Any) -> float:
    """The largest of a[i:i + LANES]."""
    return largest(load_lanes(a, i))


@inlined
def lane_max_of_sums(a: Any, i: Any, j: Any) -> float:
    """The largest of a[i + n] + a[j + n] for n of 0..LANES - 1."""
    return largest(load_lanes(a, i) + load_lanes(a, j))


@inlined
def lanes_in_range(a: Any, i: Any, low: float, end: float) -> int:
    """A bit for each n of 0..LANES - 1 where low <= a[i + n] < end."""
    v = load_lanes(a, i)
    return bits_up_to(low, v) & bits_below(v, end)


@inlined
def numbers_in_range(a: Any, i: Any, low: float, end: float, lanes: Any, into: Any) -> None:
    """lanes[into + n] = a[i + n] - low where low <= a[i + n] < end, else 0, for n of 0..LANES - 1."""
    v = load_lanes(a, i)
    store(select(lanes_in_range(a, i, low, end), v - low, 0.0), lanes, into)


# ---- boxes of a tree's node ----

# 1/d and a sum are off by u each of the distance itself, so the far side of a box is pushed out by 1 + 2 gamma_3 (Ize
# 2013), gamma_3 = 3 u / (1 - 3 u), u = 2^-53.
FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)

LARGEST_T = float(np.finfo(np.float64).max)  # for boxes that are entered at a t beyond float64

SIDES = 6  # rows of a node's boxes


@inlined
def intersect_boxes(boxes: Any, node: int, view: Any, t_min: float, t_max: float, near: Any) -> int:
    """A bit for each of the node's boxes that any of some rays may enter between t_min and t_max, and these t in near.

    boxes: (nodes, SIDES, CHILDREN). view: a traversal.RayAxis for each axis. near: (8,).
    """
    x, y, z = ray_slab(boxes, node, view, 0), ray_slab(boxes, node, view, 1), ray_slab(boxes, node, view, 2)
    enter = larger(larger(larger(x[0], y[0]), z[0]), t_min)
    leave = lesser(lesser(lesser(x[1], y[1]), z[1]) * FAR_PADDING, t_max)
    store(lesser(enter, LARGEST_T), near, 0)
    return bits_up_to(enter, leave)


@inlined
def ray_slab(boxes: Any, node: int, view: Any, axis: int) -> tuple[Vector, Vector]:
    """(where each box is entered at the earliest, where it is left at the latest) along an axis.

    A near side b is met at no less than (b unit + enter)/d, a far one at no more than (b unit + leave)/d.
    """
    ray, first = view[axis], node * SIDES * CHILDREN
    near = load_children(boxes, first + ray.near * CHILDREN)
    far = load_children(boxes, first + (2 * axis + 3 - ray.near) * CHILDREN)
    begin, end = near * ray.unit + ray.enter, far * ray.unit + ray.leave
    return lesser(begin * ray.least, begin * ray.most), larger(end * ray.least, end * ray.most)


# ---- fans (caster/kernels/bvh/fans.py): five numbers a box, each the least of something, CHILDREN boxes in a row ----

FAN_FIELDS = 5

Lines = tuple[Vec3, Vec3, Vec3]


@inlined
def fan_row(boxes: Any, node: int, field: int) -> Vector:
    return load_children(boxes, (node * FAN_FIELDS + field) * CHILDREN)


@inlined
def boxes_below(boxes: Any, node: int, limits: tuple[float, float, float, float, float]) -> int:
    """A bit for each of a node's boxes of which no number is above its limit; boxes: flat, (nodes, 5, CHILDREN)."""
    return (
        bits_up_to(fan_row(boxes, node, 0), limits[0])
        & bits_up_to(fan_row(boxes, node, 1), limits[1])
        & bits_up_to(fan_row(boxes, node, 2), limits[2])
        & bits_up_to(fan_row(boxes, node, 3), limits[3])
        & bits_up_to(fan_row(boxes, node, 4), limits[4])
    )


@inlined
def boxes_reach_lines(boxes: Any, node: int, lines: Lines) -> int:
    """A bit for each of a node's boxes (least x, -largest x, least y, -largest y, ...) in which a x + b y + c >= 0
    somewhere, for each (a, b, c) of three lines.
    """
    return (
        boxes_reach_line(boxes, node, lines[0])
        & boxes_reach_line(boxes, node, lines[1])
        & boxes_reach_line(boxes, node, lines[2])
    )


@inlined
def boxes_reach_line(boxes: Any, node: int, line: Vec3) -> int:
    most = largest_product(boxes, node, line[0], 0) + largest_product(boxes, node, line[1], 2) + line[2]
    return bits_up_to(0.0, most)


@inlined
def largest_product(boxes: Any, node: int, slope: float, field: int) -> Vector:
    """slope x where it is largest; field: that of the least x."""
    rises = slope > 0.0
    return (-slope if rises else slope) * fan_row(boxes, node, field + 1 if rises else field)


@inlined
def lanes_within_lines(xy: Any, i: Any, j: Any, lines: Lines) -> int:
    """A bit for each n of 0..LANES - 1 where a xy[i + n] + b xy[j + n] + c >= 0 for each (a, b, c) of three lines."""
    x, y = load_lanes(xy, i), load_lanes(xy, j)
    return points_within(x, y, lines[0]) & points_within(x, y, lines[1]) & points_within(x, y, lines[2])


@inlined
def points_within(x: Vector, y: Vector, line: Vec3) -> int:
    return bits_up_to(0.0, line[0] * x + line[1] * y + line[2])


@inlined
def lanes_above(tile: Any, x: Any, y: Any, z: Any, plane: Any) -> int:
    """A bit for each point (tile[x + n], tile[y + n], tile[z + n]) that is surely above a plane (p, normal, error).

    Surely above: normal . (p - point) > error . |p - point|.
    """
    p, normal, error = plane
    a, b, c = p[0] - load_lanes(tile, x), p[1] - load_lanes(tile, y), p[2] - load_lanes(tile, z)
    height = normal[0] * a + normal[1] * b + normal[2] * c
    off = error[0] * larger(a, -1.0 * a) + error[1] * larger(b, -1.0 * b) + error[2] * larger(c, -1.0 * c)
    return bits_below(off + TINY, height)
