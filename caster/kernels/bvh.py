"""Culling 2: a tree of boxes, for any rays."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.kernels.jit import jit
from caster.kernels.protocol import hull_point, hull_size, intersect, keep_nearer, passes, prepare

LEAF_SIZE = 4
STACK_SIZE = (
    64  # splits halve the count, so a tree of 2^31 primitives is 30 deep; a traversal holds depth + 1
)

# Three roundings (box - origin, times 1/d, and 1/d itself) separate a computed slab distance from the true
# one: the far side is pushed out by 1 + 2 gamma_3 (Ize 2013), gamma_3 = 3 u / (1 - 3 u), u = 2^-53.
FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)

# The intersection tests round too, so a ray may be counted as a hit that passes a primitive at a distance of
# a few u (|o| + extent): 6 u per sheared corner of a triangle, about 8 u for the closest approach to a ball.
# Rays are widened by 16 u (|o| + extent), times the condition number of the kind's matrices if it has any.
REACH = 16.0 * 2.0**-53


class Tree(NamedTuple):
    """Nodes in depth-first order. Children of an inner node are node + 1 and `second`; a leaf holds a run."""

    low: np.ndarray  # (nodes, 3) float64
    high: np.ndarray  # (nodes, 3) float64
    second: np.ndarray  # (nodes,) int32, second child; 0 in a leaf
    first: np.ndarray  # (nodes,) int32, start of the leaf's run in order
    prims_in: np.ndarray  # (nodes,) int32, length of the run, 0 in an inner node
    order: np.ndarray  # (n,) int32, primitive numbers within the kind
    extent: float  # largest |coordinate| of any box
    reach: float  # REACH times the condition of the kind


@jit
def find_boxes(prims: Any, low: Any, high: Any, start: int, stop: int) -> None:
    """Bounds of primitives start..stop."""
    for k in range(start, stop):
        for c in range(3):
            low[k, c], high[k, c] = math.inf, -math.inf
        for j in range(hull_size(prims)):
            p = hull_point(prims, k, j)
            for c in range(3):
                low[k, c], high[k, c] = min(low[k, c], p[c]), max(high[k, c], p[c])


@jit
def split_in_half(order: Any, keys: Any, start: int, stop: int) -> int:
    """Reorder order[start:stop] so that the lower half comes first, by (key, number); return the middle."""
    middle, low, high = (start + stop) // 2, start, stop - 1
    while low < high:
        pivot = order[(low + high) // 2]
        pivot_key = keys[pivot]
        i, j = low, high
        while i <= j:
            while keys[order[i]] < pivot_key or (keys[order[i]] == pivot_key and order[i] < pivot):
                i += 1
            while keys[order[j]] > pivot_key or (keys[order[j]] == pivot_key and order[j] > pivot):
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return middle


@jit
def enclose(low: Any, high: Any, tree: Any, node: int, start: int, stop: int) -> int:
    """Set the box of a node around its run; return the axis along which the box centres spread most."""
    widest, axis = -1.0, 0
    for c in range(3):
        a, b = math.inf, -math.inf
        centre_low, centre_high = math.inf, -math.inf
        for at in range(start, stop):
            k = tree.order[at]
            a, b = min(a, low[k, c]), max(b, high[k, c])
            centre = 0.5 * low[k, c] + 0.5 * high[k, c]
            centre_low, centre_high = min(centre_low, centre), max(centre_high, centre)
        tree.low[node, c], tree.high[node, c] = a, b
        if centre_high - centre_low > widest:
            widest, axis = centre_high - centre_low, c
    return axis


@jit
def grow(low: Any, high: Any, centres: Any, tree: Any) -> int:
    """Fill the tree's nodes by halving runs along their widest axis; return how many there are."""
    stack = np.zeros((STACK_SIZE, 3), np.int64)  # start, stop, and the node whose second child this run is
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, len(tree.order), -1
    top, nodes = 1, 0
    while top > 0:
        top -= 1
        start, stop, parent = stack[top, 0], stack[top, 1], stack[top, 2]
        if parent >= 0:
            tree.second[parent] = nodes
        node = nodes
        nodes += 1
        axis = enclose(low, high, tree, node, start, stop)
        if stop - start <= LEAF_SIZE:
            tree.first[node], tree.prims_in[node] = start, stop - start
            continue
        middle = split_in_half(tree.order, centres[axis], start, stop)
        stack[top, 0], stack[top, 1], stack[top, 2] = middle, stop, node
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = start, middle, -1
        top += 2
    return nodes


@jit
def reaches(tree: Any, node: int, o: Any, inverse: Any, pad: float, t_min: float, t_max: float) -> bool:
    """Whether the ray, widened by pad, may meet the box between t_min and t_max.

    Near and far sides are chosen by the sign of 1/d, so that -0.0 and inf behave; 0 * inf gives NaN where the
    ray runs inside a slab's plane, and the comparisons below drop NaN.
    """
    near, far = t_min, t_max
    for c in range(3):
        if math.copysign(1.0, inverse[c]) > 0.0:
            first, last = tree.low[node, c] - pad, tree.high[node, c] + pad
        else:
            first, last = tree.high[node, c] + pad, tree.low[node, c] - pad
        enter, leave = (first - o[c]) * inverse[c], (last - o[c]) * inverse[c] * FAR_PADDING
        if enter > near:
            near = enter
        if leave < far:
            far = leave
    return near <= far


@jit
def inverse_or_inf(x: float) -> float:
    """1 / x with the sign of x, inf for both zeros."""
    return math.copysign(math.inf, x) if x == 0.0 else 1.0 / x


@jit
def cast_bvh(prims: Any, tree: Any, rays: Any, record: Any, span: Any) -> None:
    """Rays span[0]..span[1] against one kind; a box at exactly the nearest t is opened, so no tie is lost."""
    stack = np.zeros(STACK_SIZE, np.int32)
    for i in range(span[0], span[1]):
        o, d, t_min = (
            (rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]),
            (rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]),
            rays.t_min[i],
        )
        inverse = (inverse_or_inf(d[0]), inverse_or_inf(d[1]), inverse_or_inf(d[2]))
        pad = tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)
        stack[0] = 0
        top = 1
        while top > 0:
            top -= 1
            node = stack[top]
            if not reaches(
                tree, node, o, inverse, pad, t_min, min(rays.t_max[i], record.t[i] + record.off[i])
            ):
                continue
            if tree.prims_in[node] == 0:
                stack[top], stack[top + 1] = tree.second[node], node + 1
                top += 2
            for at in range(tree.first[node], tree.first[node] + tree.prims_in[node]):
                k = tree.order[at]
                pre = prepare(prims, k, o)
                if passes(prims, pre, d):
                    continue
                hit = intersect(prims, pre, d, t_min, rays.t_max[i])
                if hit[0] < math.inf:
                    keep_nearer(record, i, prims, k, rays, hit)
