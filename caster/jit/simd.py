"""SIMD operations that LLVM does not vectorise by itself: minima of lanes, tests of the child boxes of a BVH node.

Compiled, vectors take the place of these bodies (caster/jit/vector_intrinsics.py).
"""

from typing import Any

import numpy as np

from caster.jit.kernel_cache import COMPILED

LANES = 8 if COMPILED else 1
"""So many float64 AVX-512 takes at once. Uncompiled, taking several together would be in vain."""


def any_sum_reaches(a: Any, i: Any, j: Any, limit: float) -> bool:
    """Whether a[i + n] + a[j + n] >= limit for one n of 0..LANES - 1; i, j: uint64 in kernels."""
    return any(a[i + n] + a[j + n] >= limit for n in range(LANES))


def lane_min(a: Any, i: Any) -> float:
    """The least of a[i:i + LANES]."""
    return min(float(a[i + n]) for n in range(LANES))


def lane_max(a: Any, i: Any) -> float:
    """The largest of a[i:i + LANES]."""
    return max(float(a[i + n]) for n in range(LANES))


def lane_max_of_sums(a: Any, i: Any, j: Any) -> float:
    """The largest of a[i + n] + a[j + n] for n of 0..LANES - 1."""
    return max(float(a[i + n] + a[j + n]) for n in range(LANES))


def prefetch(rows: Any, k: Any) -> None:
    """Row k of an array is read soon, if there is one: its cache line is loaded meanwhile."""


ALL_LANES = (1 << LANES) - 1
"""The bits of LANES numbers."""


def lanes_in_range(a: Any, i: Any, least: float, end: float) -> int:
    """A bit for each n of 0..LANES - 1 where least <= a[i + n] < end."""
    return sum((least <= a[i + n] < end) << n for n in range(LANES))


def numbers_in_range(a: Any, i: Any, least: float, end: float, lanes: Any, into: Any) -> None:
    """lanes[into + n] = a[i + n] - least where that is at least 0 and a[i + n] < end, else 0, for n of 0..LANES - 1."""
    for n in range(LANES):
        lanes[into + n] = a[i + n] - least if least <= a[i + n] < end else 0.0


def gather_corners(rows: Any, faces: Any, lanes: Any, numbers: Any, into: Any, step: Any) -> None:
    """Rows (v, 3) of the three corners of LANES faces (f, 3), coordinate by coordinate.

    lanes: numbers of the faces from `numbers` on; coordinate i of corner c goes to `into` + (3 c + i) `step` and on.
    """
    for n in range(LANES):
        for c in range(3):
            for i in range(3):
                lanes[into + (3 * c + i) * step + n] = rows[faces[int(lanes[numbers + n]), c], i]


CHILDREN = 8
"""Boxes a node of a tree holds: as many as are looked at at once."""

# 1/d and a sum are off by u each of the distance itself, so the far side of a box is pushed out by 1 + 2 gamma_3 (Ize
# 2013), gamma_3 = 3 u / (1 - 3 u), u = 2^-53.
FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)

LARGEST_T = float(np.finfo(np.float64).max)  # for boxes that are entered at a t beyond float64


def intersect_boxes(boxes: Any, node: int, view: Any, t_min: float, t_max: float, near: Any) -> int:
    """A bit for each of the node's boxes that a ray enters between t_min and t_max; where it does goes to near (8,).

    view: near and far (rows of boxes[node]), inverse, enter, leave, each for x, y, z. A side at b along an axis is met
    at b inverse + enter, or + leave if it is a far one.
    """
    sides = [boxes[node, list(rows)].astype(np.float64).T for rows in view[:2]]
    with np.errstate(over="ignore"):
        return _entered(sides[0] * view[2] + view[3], sides[1] * view[2] + view[4], t_min, t_max, near)


def intersect_boxes_packet(boxes: Any, node: int, view: Any, t_min: float, t_max: float, near: Any) -> int:
    """The same for boxes that one of several rays may enter.

    view: near and far, the least and the most of 1/d, enter, leave, each for x, y, z, and the unit of the boxes. A side
    at b is met at no less than (b unit + enter)/d if it is a near one, no more than (b unit + leave)/d if it is far.
    """
    near_side, far_side = (boxes[node, list(rows)].astype(np.float64).T * view[6] for rows in view[:2])
    with np.errstate(over="ignore"):
        begin = np.minimum(*((near_side + view[4]) * slope for slope in view[2:4]))
        end = np.maximum(*((far_side + view[5]) * slope for slope in view[2:4]))
        return _entered(begin, end, t_min, t_max, near)


def _entered(enter: Any, leave: Any, t_min: float, t_max: float, near: Any) -> int:
    """enter, leave: (CHILDREN, 3)."""
    enter, leave = np.maximum(enter.max(axis=1), t_min), np.minimum(leave.min(axis=1) * FAR_PADDING, t_max)
    near[:] = np.minimum(enter, LARGEST_T)
    return int(np.packbits(enter <= leave, bitorder="little")[0])


def lowest_bit(mask: int) -> int:
    """The number of the lowest bit that is set, of a mask that is not 0."""
    return (mask & -mask).bit_length() - 1


# Fans (caster/kernels/bvh/fans.py): five numbers a box, each the least of something, CHILDREN boxes in a row.
FAN_FIELDS = 5

Lines = tuple[tuple[float, float, float], ...]


def boxes_below(boxes: Any, node: int, limits: tuple[float, ...]) -> int:
    """A bit for each of a node's boxes of which no number is above its limit; boxes: flat, (nodes, 5, CHILDREN)."""
    rows = boxes[node * FAN_FIELDS * CHILDREN :][: FAN_FIELDS * CHILDREN].reshape(FAN_FIELDS, CHILDREN)
    below = np.less_equal(rows.T, limits).all(axis=1)
    return int(np.packbits(below, bitorder="little")[0])


def boxes_reach_lines(boxes: Any, node: int, lines: Lines) -> int:
    """A bit for each of a node's boxes (least x, -largest x, least y, -largest y, ...) in which a x + b y + c >= 0
    somewhere, for each (a, b, c) of three lines.
    """
    first = node * FAN_FIELDS * CHILDREN
    x0, x1, y0, y1 = boxes[first : first + 4 * CHILDREN].reshape(4, CHILDREN)
    within = np.ones(CHILDREN, bool)
    with np.errstate(invalid="ignore", over="ignore"):  # of boxes without anything
        for a, b, c in lines:
            within &= (-a * x1 if a > 0.0 else a * x0) + (-b * y1 if b > 0.0 else b * y0) + c >= 0.0
    return int(np.packbits(within, bitorder="little")[0])


def lanes_within_lines(xy: Any, i: Any, j: Any, lines: Lines) -> int:
    """A bit for each n of 0..LANES - 1 where a xy[i + n] + b xy[j + n] + c >= 0 for each (a, b, c) of three lines."""
    found = 0
    for n in range(LANES):
        x, y = xy[i + n], xy[j + n]
        if all(a * x + b * y + c >= 0.0 for a, b, c in lines):
            found |= 1 << n
    return found


PLANE_ATOL = 2.0**-1020  # vec.TINY: what products lose that underflow


def lanes_not_above(tile: Any, x: Any, y: Any, z: Any, plane: Any) -> int:
    """A bit for each point (tile[x + n], tile[y + n], tile[z + n]) that may be not above a plane (p, normal, error).

    Surely above: normal . (p - point) > error . |p - point|.
    """
    found = 0
    p, normal, error = plane
    for n in range(LANES):
        away = p[0] - tile[x + n], p[1] - tile[y + n], p[2] - tile[z + n]
        height = normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2]
        most = error[0] * abs(away[0]) + error[1] * abs(away[1]) + error[2] * abs(away[2]) + PLANE_ATOL
        if not height > most:
            found |= 1 << n
    return found
