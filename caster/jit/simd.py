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
