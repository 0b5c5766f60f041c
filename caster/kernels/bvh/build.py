"""Kernels of BVH construction: bounding boxes and splits by the binned surface area heuristic (Wald 2007).

caster/rendering/bvh_construction.py builds the trees with them.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import inlined, jit
from caster.jit.simd import CHILDREN
from caster.kernels.math.vec import row
from caster.kernels.protocol import Vec3, hull_point, hull_size
from caster.kernels.triangles import Triangles

LEAF_SIZE = 4
BINS = 16
# Below this depth runs are halved. A large tree grows in two goes (caster/rendering/bvh_construction.py), so that
# with 2^31 primitives it is less than 2 (40 + 31) deep; a traversal holds all but one of a node's boxes a level.
MAX_SAH_DEPTH = 40
BUILD_STACK_SIZE = 160  # nodes in two that wait for their turn
STACK_SIZE = 144 * (CHILDREN - 1)

LEAF_SIZE_BASE = 8  # more than a leaf has
MAX_PRIMITIVES = 2**31 // LEAF_SIZE_BASE  # whose leaves fit into links

FIRST, COUNT, INNER = 0, 1, -1  # columns of the links of binary nodes, and the count of a node that is no leaf

# What is hit is hit exactly, but the points of a hull are sums of four numbers, off by 4 u of their magnitudes at most:
# 16 u (|o| + extent) cover them. Up to 7 u more are lost where boxes and origins are taken relative to the tree's
# centre and multiplied by 1/d (caster/kernels/bvh/traversal.py), so boxes are widened by 24.
BOX_PADDING = 24.0 * 2.0**-53


# Replaces 0 in a direction, per unit of a tree: so small that it moves no ray across a pad within t < 2^930, and so
# large that its inverse times any box is finite (inf - inf is NaN). At least MIN_DIRECTION.
MIN_DIRECTION_PER_UNIT, MIN_DIRECTION = 2.0**-990, 2.0**-1000


class Tree(NamedTuple):
    """Nodes of CHILDREN boxes each, or fewer; the first node is the root, whose own box is not kept.

    Boxes are rounded outwards to float32, relative to `center`, and in units of `unit`, so that a scene of any size,
    far from the origin or not, has the same tree.
    """

    # (nodes, 6, CHILDREN) float32: low x, y, z, high x, y, z of each; where there is none, low above high
    boxes: np.ndarray
    # (nodes, CHILDREN) int32: what is in each box, the number of a node or ~(LEAF_SIZE_BASE start + number) for
    # order[start:start + number]; nothing where there is no box
    links: np.ndarray
    order: np.ndarray  # (n,) int32, primitive numbers within the kind
    center: Vec3
    unit: float  # a power of two
    flat: float  # what stands for 0 in a direction: a power of two
    extent: float  # largest |coordinate| of any box, in scene units
    reach: float  # BOX_PADDING


def hulls_of(prims: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(points (m, 3) float64, corners (n, points of a hull) int32) of convex hulls that hold so many primitives.

    Those of triangles share the vertices; corners are (n, 0) for a kind without bounds.
    """
    if isinstance(prims, Triangles):
        return prims.vertices, prims.faces
    size = int(hull_size(prims))
    points = np.empty((count * size, 3))
    if size:
        list_hull_points(prims, points, count)
    return points, np.arange(count * size, dtype=np.int32).reshape(count, size)


@jit
def list_hull_points(prims: Any, points: Any, count: int) -> None:
    """points (n, 3): those of the hulls of the first `count` primitives."""
    size = hull_size(prims)
    for k in range(count):
        for j in range(size):
            points[k * size + j, 0], points[k * size + j, 1], points[k * size + j, 2] = hull_point(prims, k, j)


@jit
def bound_hulls_in_space(points: Any, corners: Any, low: Any, high: Any) -> None:
    """Bounding boxes of hulls; empty boxes of a kind without bounds."""
    for k in range(len(corners)):
        for c in range(3):
            low[k, c], high[k, c] = math.inf, -math.inf
            for j in range(corners.shape[1]):
                x = points[corners[k, j], c]
                low[k, c], high[k, c] = min(low[k, c], x), max(high[k, c], x)


SMALLEST32, ULP32 = 2.0**-149, 2.0**-23


@inlined
def round_up_to_float32(x: float) -> float:
    """A number that is at least x after rounding to float32, for |x| <= 1."""
    return x + (abs(x) * ULP32 + SMALLEST32)


@jit
def quantize_boxes(low: Any, high: Any, center: Vec3, unit: float, boxes: Any, start: int, stop: int) -> None:
    """The boxes start..stop in float32 and in the units of the tree: (n, 6)."""
    for k in range(start, stop):
        for c in range(3):
            boxes[k, c] = -round_up_to_float32((center[c] - low[k, c]) / unit)
            boxes[k, c + 3] = round_up_to_float32((high[k, c] - center[c]) / unit)


@inlined
def half_area(low: Any, high: Any) -> float:
    """Half the surface of a box, 0 of an empty one."""
    x, y, z = max(high[0] - low[0], 0.0), max(high[1] - low[1], 0.0), max(high[2] - low[2], 0.0)
    return x * y + y * z + z * x


@jit
def bound_run(boxes: Any, order: Any, start: int, stop: int, into: Any) -> Any:
    """Write the box of a run to into (6,); returns (axis of widest spread, least, largest) of twice the centres."""
    low = np.full(6, math.inf)  # of the boxes, of the middles
    high = np.full(6, -math.inf)
    for at in range(start, stop):
        k = order[at]
        for c in range(3):
            a, b = float(boxes[k, c]), float(boxes[k, c + 3])
            low[c], high[c] = min(low[c], a), max(high[c], b)
            low[c + 3], high[c + 3] = min(low[c + 3], a + b), max(high[c + 3], a + b)
    axis = 0
    for c in range(3):
        into[c], into[c + 3] = low[c], high[c]
        if high[c + 3] - low[c + 3] > high[axis + 3] - low[axis + 3]:
            axis = c
    return axis, low[axis + 3], high[axis + 3]


@inlined
def bin_of(boxes: Any, k: int, axis: int, least: float, per_bin: float) -> int:
    return min(int((float(boxes[k, axis]) + float(boxes[k, axis + 3]) - least) * per_bin), BINS - 1)


@jit
def partition(boxes: Any, order: Any, run: Any, spread: Any, counts: Any, bounds: Any) -> int:
    """Reorder a run so that its two parts cost least by area times number; return where the second begins.

    spread: the result of `bound_run`. counts (BINS,) and bounds (BINS, 6) are work space.
    """
    start, stop = run
    axis, least, largest = spread
    counts[:] = 0
    bounds[:, :3], bounds[:, 3:] = math.inf, -math.inf
    per_bin = BINS / (largest - least)
    for at in range(start, stop):
        k = order[at]
        b = bin_of(boxes, k, axis, least, per_bin)
        counts[b] += 1
        for c in range(3):
            bounds[b, c] = min(bounds[b, c], boxes[k, c])
            bounds[b, c + 3] = max(bounds[b, c + 3], boxes[k, c + 3])
    last = best_split_bin(counts, bounds)
    left, right = start, stop - 1
    while left <= right:
        k = order[left]
        if bin_of(boxes, k, axis, least, per_bin) <= last:
            left += 1
        else:
            order[left], order[right] = order[right], k
            right -= 1
    return left


@jit
def best_split_bin(counts: Any, bounds: Any) -> int:
    """The last bin of the first part, where both parts' area times number is least."""
    costs = np.zeros(BINS)
    low, high = np.full(3, math.inf), np.full(3, -math.inf)
    number = 0
    for b in range(BINS - 1, 0, -1):
        number += counts[b]
        costs[b - 1] = number * half_area_with_bin(low, high, bounds, b)
    low[:], high[:] = math.inf, -math.inf
    number, best, least = 0, 0, math.inf
    for b in range(BINS - 1):
        number += counts[b]
        cost = costs[b] + number * half_area_with_bin(low, high, bounds, b)
        if cost < least:
            best, least = b, cost
    return best


@inlined
def half_area_with_bin(low: Any, high: Any, bounds: Any, b: int) -> float:
    """Half the surface of a box, which is extended by a bin."""
    for c in range(3):
        low[c], high[c] = min(low[c], bounds[b, c]), max(high[c], bounds[b, c + 3])
    return half_area(low, high)


@jit
def build_binary(
    boxes: Any, order: Any, start: int, stop: int, enough: int, node_boxes: Any, links: Any, root: int, free: int
) -> int:
    """Fill binary nodes over order[start:stop], down to runs of at most `enough`.

    The root is node `root`, the others are numbered from `free` on; returns the number after the last. node_boxes:
    (room, 6); links: (room, 2): (its first primitive in `order`, how many) of a leaf, (the first of two children,
    INNER) of any other.
    """
    stack = np.zeros((BUILD_STACK_SIZE, 4), np.int64)  # start, stop, node, depth
    counts, bounds = np.zeros(BINS, np.int64), np.zeros((BINS, 6))
    stack[0, 0], stack[0, 1], stack[0, 2] = start, stop, root
    top = 1
    while top > 0:
        top -= 1
        first, last, node, depth = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        spread = bound_run(boxes, order, first, last, node_boxes[node])
        if last - first <= enough:
            links[node, FIRST], links[node, COUNT] = first, last - first
            continue
        middle = (first + last) // 2
        if depth < MAX_SAH_DEPTH and spread[2] > spread[1] and spread[2] - spread[1] < math.inf:
            middle = partition(boxes, order, (first, last), spread, counts, bounds)
        links[node, FIRST], links[node, COUNT] = free, INNER
        for child in range(2):
            stack[top, 0], stack[top, 1] = (first, middle) if child == 0 else (middle, last)
            stack[top, 2], stack[top, 3] = free + child, depth + 1
            top += 1
        free += 2
    return free


# Where a node has fewer boxes, the rest reach from EMPTY_BOX to -EMPTY_BOX, outside of every tree, and are left before
# they are entered. From so far away that rays are wider than that they are entered all the same: nothing is in them.
EMPTY_BOX, EMPTY_LINK = 2.0, ~0


@jit
def collapse(boxes: Any, links: Any, wide_boxes: Any, wide_links: Any) -> int:
    """Make nodes of CHILDREN from binary ones, opening the largest box first; return their number."""
    origin, inside = np.zeros(len(wide_links), np.int64), np.zeros(CHILDREN, np.int64)
    node, nodes = 0, 1
    while node < nodes:
        inside[0] = origin[node]
        number = open_largest(boxes, links, inside)
        wide_boxes[node, :3], wide_boxes[node, 3:] = EMPTY_BOX, -EMPTY_BOX
        wide_links[node] = EMPTY_LINK
        for j in range(number):
            child = inside[j]
            for c in range(6):
                wide_boxes[node, c, j] = boxes[child, c]
            if links[child, COUNT] == INNER:
                origin[nodes] = child
                wide_links[node, j] = nodes
                nodes += 1
            else:
                wide_links[node, j] = ~(LEAF_SIZE_BASE * links[child, FIRST] + links[child, COUNT])
        node += 1
    return nodes


@jit
def open_largest(boxes: Any, links: Any, inside: Any) -> int:
    """Replace inside[0] by its children, then repeatedly the node with the largest box; returns the number of nodes."""
    number, opened = 1, 0
    while opened >= 0 and number < CHILDREN:
        opened, largest = -1, -1.0
        for j in range(number):
            k = inside[j]
            area = half_area(row(boxes, k), (boxes[k, 3], boxes[k, 4], boxes[k, 5]))
            if links[k, COUNT] == INNER and area > largest:
                opened, largest = j, area
        if opened >= 0:
            k = inside[opened]
            inside[opened], inside[number] = links[k, FIRST], links[k, FIRST] + 1
            number += 1
    return number
