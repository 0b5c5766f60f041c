"""BVH construction on several threads: binary nodes by the surface area heuristic, collapsed into wide ones.

Also the fans of a light or point, and the projections of trees by them (caster/kernels/bvh/fans.py).
"""

import math
from functools import partial

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import Kind
from caster.geometry.triangle_mesh import normalize_rows
from caster.jit.simd import CHILDREN
from caster.kernels.bvh.build import (
    BOX_PADDING,
    COUNT,
    INNER,
    LEAF_SIZE,
    MAX_PRIMITIVES,
    MIN_DIRECTION,
    MIN_DIRECTION_PER_UNIT,
    Tree,
    build_binary,
    collapse,
    hulls_of,
    quantize_boxes,
)
from caster.kernels.bvh.fans import (
    BOX_SIZE,
    FAN_SLACK,
    PRIM_FIELDS,
    Fan,
    FanBounds,
    bound_hulls_along,
    bound_nodes_along,
    project_along,
)
from caster.kernels.protocol import Vec3
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.kernels.triangles import Triangles
from caster.rendering.threads import parallel_for, parallel_for_pieces, thread_count

PARALLEL_SUBTREES = 16  # one thread builds the top of a tree; these subtrees are built in parallel
PARALLEL_MIN_PRIMITIVES = 20_000  # fewer are built faster by one thread


def bvh_of(kind: Kind) -> Tree:
    """The BVH over all primitives of a kind, built on first use and kept with them."""
    if not has_bvh(kind):
        kind.derived["bvh"] = build_tree(*kind.boxes(), thread_count())
    return kind.derived["bvh"]


def has_bvh(kind: Kind) -> bool:
    return "bvh" in kind.derived


# If a kind's largest coordinate is beyond these, products with 1/d may overflow: brute force is used instead.
MIN_BVH_EXTENT, MAX_BVH_EXTENT = 2.0**-400, 2.0**400


def uses_bvh(kind: Kind) -> bool:
    return kind.bounded and len(kind.ids) > LEAF_SIZE and MIN_BVH_EXTENT < kind.extent < MAX_BVH_EXTENT


def build_tree(low: np.ndarray, high: np.ndarray, threads: int) -> Tree:
    """Build a tree over boxes low, high (n, 3), n > 0. It is the same for every number of threads.

    Raises SceneError for more than MAX_PRIMITIVES.
    """
    count = len(low)
    if count > MAX_PRIMITIVES:
        raise SceneError(f"a tree holds {MAX_PRIMITIVES} primitives of a kind at most, got {count}")
    least, largest = low.min(axis=0), high.max(axis=0)
    x, y, z = (0.5 * least + 0.5 * largest).tolist()
    center, unit = (x, y, z), _unit(least, largest, np.array([x, y, z]))
    boxes, order = np.empty((count, 6), np.float32), np.arange(count, dtype=np.int32)
    quantize_boxes(low, high, center, unit, boxes, 0, count)
    binary_boxes, binary_links = _build_binary(boxes, order, threads)
    # collapse them into nodes of CHILDREN, of which there are at most as many as inner binary nodes
    capacity = max(1, int(np.count_nonzero(binary_links[:, COUNT] == INNER)))
    wide_boxes, links = np.empty((capacity, 6, CHILDREN), np.float32), np.empty((capacity, CHILDREN), np.int32)
    number = collapse(binary_boxes, binary_links, wide_boxes, links)
    extent = float(max(-low.min(), low.max(), -high.min(), high.max()))
    flat = max(MIN_DIRECTION_PER_UNIT * unit, MIN_DIRECTION)
    return Tree(wide_boxes[:number].copy(), links[:number].copy(), order, center, unit, flat, extent, BOX_PADDING)


def _unit(least: np.ndarray, largest: np.ndarray, center: np.ndarray) -> float:
    """The power of two by which coordinates of the box, relative to its centre, are divided to lie in [-1, 1]."""
    with np.errstate(over="ignore"):
        half = float(max((center - least).max(), (largest - center).max()))
    if half == 0.0:
        return 1.0
    return 2.0 ** min(max(math.frexp(half)[1], -1021), 1023) if half < math.inf else 2.0**1023


def _build_binary(boxes: np.ndarray, order: np.ndarray, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """(boxes, links) of binary nodes over all of `order`: the top by this thread, its subtrees in parallel."""
    count = len(order)
    node_boxes, links = np.empty((2 * count, 6), np.float32), np.zeros((2 * count, 2), np.int32)
    enough = LEAF_SIZE if count < PARALLEL_MIN_PRIMITIVES else count // PARALLEL_SUBTREES
    top = build_binary(boxes, order, 0, count, enough, node_boxes, links, 0, 1)
    ends = np.flatnonzero(links[:top, COUNT] > LEAF_SIZE)
    room = 2 * links[ends, COUNT] - 2  # nodes below the root of a tree of so many leaves
    parts = np.column_stack([ends, links[ends], top + np.cumsum(room) - room]).tolist()

    def build(part: list[int]) -> None:
        node, start, number, free = part
        build_binary(boxes, order, start, start + number, LEAF_SIZE, node_boxes, links, node, free)

    parallel_for_pieces(lambda: build, parts, threads)
    return node_boxes, links


FAN_REACH = 16.0
"""Rays belong to a fan if they start within so many times the largest coordinate of kinds with a tree."""


def fans_to(light: PointLight | DirectionalLight, center: Vec3, extent: float) -> list[Fan]:
    """The fans of all shadow rays to a light, those from around `center` first; extent: the largest |coordinate|.

    One fan of parallel rays, or six of rays through a point.
    """
    if isinstance(light, DirectionalLight):
        back, reach = light.back, FAN_REACH * extent
        axis = int(np.argmax(np.abs(back)))
        x, y, z = np.roll(np.eye(3), -axis - 1, axis=0)
        across, up = (e - (back[np.argmax(e)] / back[axis]) * z for e in (x, y))
        away = -np.copysign(1.0, back[axis]) * z
        slack = FAN_SLACK * (reach + extent)
        return [Fan(0.0, (0.0, 0.0, 0.0), back, vec3(across), vec3(up), vec3(away), reach, slack)]
    point = light.position
    ahead = np.subtract(center, point)
    largest = np.abs(ahead).max()
    forward = ahead / largest if largest > 0.0 else np.array([1.0, 0.0, 0.0])
    forward = normalize_rows(forward[None])[0]
    across = normalize_rows(np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])[None])[0]
    up = np.cross(forward, across)
    reach = FAN_REACH * max(extent, *map(abs, point))
    slack = FAN_SLACK * (reach + extent)
    return [
        Fan(1.0, point, (0.0, 0.0, 0.0), vec3(x), vec3(y), vec3(sign * z), reach, slack)
        for z, x, y in ((forward, across, up), (across, up, forward), (up, forward, across))
        for sign in (1.0, -1.0)
    ]


def vec3(a: np.ndarray) -> Vec3:
    x, y, z = a.tolist()
    return x, y, z


def fan_bounds(kind: Kind, fan: Fan, threads: int | None) -> FanBounds:
    """Project the primitives and the tree of a kind."""
    tree, count = bvh_of(kind), len(kind.ids)
    points, corners = hulls_of(kind.prims, count)
    nodes, prims, projected = np.empty(len(tree.links) * BOX_SIZE), np.empty(count * PRIM_FIELDS), np.empty_like(points)
    project = partial(project_along, fan, points, projected)
    parallel_for(project, len(points), threads, least=PARALLEL_MIN_PRIMITIVES)
    bound = partial(bound_hulls_along, fan, corners, projected, tree.order, prims)
    parallel_for(bound, count, threads, least=PARALLEL_MIN_PRIMITIVES)
    bounds = FanBounds(nodes, prims, projected if isinstance(kind.prims, Triangles) else projected[:0])
    bound_nodes_along(tree.links, bounds)
    return bounds
