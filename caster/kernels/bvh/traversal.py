"""BVH traversal by single rays, and by packets of LANES neighbouring rays."""

import math
from typing import Any, NamedTuple

from caster.jit.decorators import implement, inlined, jit
from caster.jit.simd import LANES, lowest_bit
from caster.kernels.bvh.build import LEAF_SIZE_BASE
from caster.kernels.math.lanes import intersect_boxes, lane_max, lane_max_of_sums, lane_min
from caster.kernels.math.vec import l1_norm, max_norm
from caster.kernels.nearest import (
    KeepFirst,
    Ray,
    any_hit_result,
    hit_by_float64,
    ray_at,
    reach,
    store_first,
    try_primitive,
)
from caster.kernels.protocol import Vec3, load
from caster.kernels.raster.tile import DX, OX, STRIDE, T_ERROR, T_MAX, T_MIN, T, cast_lanes, get, lane, update_nearest

# A box is met from (low + c) / d to (high + c) / d along an axis, c being its reference point relative to the origin,
# less or more the pad, taken as (low + c) (1/d). What the sums round, u (|low| + |c|) in space, is in BOX_PADDING; what
# 1/d and the product do is in FAR_PADDING.

Bounds3 = tuple[Vec3, Vec3]
"""The least and the largest x, y, z."""


class RayAxis(NamedTuple):
    """One or several rays along an axis, for box tests. If some go forwards, some backwards, it bounds nothing."""

    near: int  # row of Tree.boxes[node]
    least: float  # of 1/d
    most: float
    enter: float  # the tree's centre relative to that origin from which the near side is nearest, less the pad
    leave: float  # the far side is farthest, more the pad
    unit: float


@inlined
def ray_box_setup(tree: Any, origins: Bounds3, directions: Bounds3) -> tuple[RayAxis, RayAxis, RayAxis]:
    """Slab-test constants of rays whose origins and directions lie within these bounds."""
    pad = tree.reach * (max(max_norm(origins[0]), max_norm(origins[1])) + tree.extent)
    return (
        ray_axis(tree, origins, directions, pad, 0),
        ray_axis(tree, origins, directions, pad, 1),
        ray_axis(tree, origins, directions, pad, 2),
    )


@inlined
def ray_axis(tree: Any, origins: Bounds3, directions: Bounds3, pad: float, axis: int) -> RayAxis:
    low_d, high_d = directions[0][axis], directions[1][axis]
    mixed, forwards = (low_d < 0.0) & (high_d > 0.0), low_d >= 0.0
    low_d = max(low_d, tree.flat) if forwards else min(low_d, -tree.flat)
    high_d = max(high_d, tree.flat) if forwards else min(high_d, -tree.flat)
    low = tree.center[axis] - origins[1][axis] - pad
    high = tree.center[axis] - origins[0][axis] + pad
    return RayAxis(
        axis if forwards else axis + 3,
        1.0 if mixed else 1.0 / high_d,
        1.0 if mixed else 1.0 / low_d,
        -math.inf if mixed else (low if forwards else high),
        math.inf if mixed else (high if forwards else low),
        tree.unit,
    )


@inlined
def push_children(links: Any, node: int, mask: int, top: int, workspace: Any) -> tuple[int, int]:
    """Push all boxes of a nonzero mask except the one entered first; returns (link of that one, top)."""
    stack, entries, near = workspace
    j = lowest_bit(mask)
    mask &= mask - 1
    first, at = links[node, j], near[j]
    while mask != 0:
        j = lowest_bit(mask)
        mask &= mask - 1
        other, then = links[node, j], near[j]
        ahead = then < at
        stack[top], entries[top] = first if ahead else other, at if ahead else then
        first, at = other if ahead else first, then if ahead else at
        top += 1
    return first, top


@inlined
def pop_beyond(top: int, limit: float, workspace: Any) -> int:
    """The top of the stack below boxes that are entered beyond the limit."""
    entries = workspace[1]
    while entries[top - 1] > limit:
        top -= 1
    return top


@inlined
def traverse(mode: Any, prims: Any, tree: Any, view: Any, limits: tuple[float, float], workspace: Any) -> int:
    """The best (`try_primitive`) of one or several rays after traversing the tree of a kind, near boxes first.

    view: `ray_box_setup`; limits: the least t_min and the largest t_max. A box at exactly the nearest t is opened, so
    no tie is lost. workspace: see rendering.ray_tiles.new_workspace.
    """
    stack, entries, near = workspace
    t_min, t_max = limits
    limit, best = min(t_max, reach(mode)), -1
    inside, top, entries[0] = 0, 1, -math.inf  # under all that waits lies what is always entered
    while top > 0:
        if inside >= 0:
            mask = intersect_boxes(tree.boxes, inside, view, t_min, limit, near)
            if mask != 0:
                inside, top = push_children(tree.links, inside, mask, top, workspace)
                continue
        else:
            start, number = ~inside // LEAF_SIZE_BASE, ~inside % LEAF_SIZE_BASE
            for at in range(start, start + number):
                best = try_primitive(mode, prims, tree.order[at], best)
            limit = min(t_max, reach(mode))
        top = pop_beyond(top, limit, workspace) - 1
        inside = stack[top]
    return best


@inlined
def traverse_singly(mode: Any, prims: Any, tree: Any, workspace: Any) -> int:
    """`traverse` for the one ray of a mode."""
    o, d, t_min, t_max = mode.ray
    return traverse(mode, prims, tree, ray_box_setup(tree, (o, o), (d, d)), (t_min, t_max), workspace)


@jit
def find_first_in_tree(
    prims: Any, tree: Any, workspace: Any, rays: Any, sketch: Any, found: Any, start: int, stop: int
) -> None:
    """`find_first` through the tree of a kind."""
    for i in range(start, stop):
        ray = ray_at(rays, i)
        if ray[2] < ray[3]:
            mode = KeepFirst(ray, prims, sketch.t[i] + sketch.error[i])
            store_first(mode, traverse_singly(mode, prims, tree, workspace), found, i)


# Packets: neighbours in a tile traverse the tree together.


PACKET_SIZE = lane(LANES)


class Packet(NamedTuple):
    """Mode of a traversal: find the nearest hits of LANES rays of a tile."""

    base: int
    tile: Any
    first: Any
    any_hit: bool


@implement(try_primitive, Packet)
def _cast_packet(mode: Any, prims: Any, k: int, best: int) -> int:
    cast_lanes(prims, load(prims, k), float(mode.base + k), mode.tile, mode.first, mode.any_hit)
    return best


@implement(reach, Packet)
def _reach_of_packet(mode: Any) -> float:
    return lane_max_of_sums(mode.tile, T + mode.first, T_ERROR + mode.first)


class SingleRay(NamedTuple):
    """Mode of a traversal: find the nearest hit of one ray of a tile."""

    ray: Ray
    base: int
    tile: Any
    i: Any
    any_hit: bool


@implement(try_primitive, SingleRay)
def _cast_single_ray(mode: Any, prims: Any, k: int, best: int) -> int:
    t, error = hit_by_float64(prims, k, mode.ray)
    if t < math.inf:
        t, error = any_hit_result(t, error, mode.any_hit)
        update_nearest(mode.tile, mode.i, float(mode.base + k), t, error)
    return best


@implement(reach, SingleRay)
def _reach_of_single_ray(mode: Any) -> float:
    return mode.tile[T + mode.i] + mode.tile[T_ERROR + mode.i]


@inlined
def packet_bounds(tile: Any, field: Any, first: Any) -> Bounds3:
    """The least and the largest x, y, z of a packet's origins or directions."""
    x, y, z = field + first, field + lane(STRIDE) + first, field + lane(2 * STRIDE) + first
    return (
        (lane_min(tile, x), lane_min(tile, y), lane_min(tile, z)),
        (lane_max(tile, x), lane_max(tile, y), lane_max(tile, z)),
    )


# Rays go together whose directions differ by no more than this share of the first one's, and whose origins by no more
# than this share of the tree's size: about where going together takes as long as going alone. Rays that are sorted by
# direction, but not by much, are within 0.25: there a packet takes two to three times as long.
COHERENCE_LIMIT = 0.06


@inlined
def is_coherent(tree: Any, tile: Any, first: Any, origins: Bounds3, directions: Bounds3) -> bool:
    """Whether the rays of a packet enter mostly the same boxes. It changes no bit of a hit."""
    turn = l1_norm(get(tile, DX + first))
    return (l1_extent(origins) <= COHERENCE_LIMIT * tree.unit) & (l1_extent(directions) <= COHERENCE_LIMIT * turn)


@inlined
def l1_extent(ends: Bounds3) -> float:
    low, high = ends
    return (high[0] - low[0]) + (high[1] - low[1]) + (high[2] - low[2])


@jit
def cast_rays_singly(prims: Any, tree: Any, base: int, tile: Any, first: Any, workspace: Any, any_hit: bool) -> None:
    """Nearest hits of a packet's rays, one by one."""
    for i in range(first, first + PACKET_SIZE):
        ray = get(tile, OX + i), get(tile, DX + i), tile[T_MIN + i], tile[T_MAX + i]
        traverse_singly(SingleRay(ray, base, tile, i, any_hit), prims, tree, workspace)


@jit
def cast_packets(
    prims: Any, tree: Any, base: int, count: int, tile: Any, taken: Any, workspace: Any, any_hit: bool
) -> None:
    """Cast the first `count` rays of a tile at a kind whose places begin at `base`, in packets of LANES.

    taken: 1 for each packet to leave out, or empty. any_hit: whether to stop at any certain hit.
    """
    for packet in range(-(-count // LANES)):
        if len(taken) > 0 and taken[packet] != 0:
            continue
        first = lane(packet * LANES)
        origins, directions = packet_bounds(tile, OX, first), packet_bounds(tile, DX, first)
        if is_coherent(tree, tile, first, origins, directions):
            view = ray_box_setup(tree, origins, directions)
            limits = lane_min(tile, T_MIN + first), lane_max(tile, T_MAX + first)
            traverse(Packet(base, tile, first, any_hit), prims, tree, view, limits, workspace)
        else:
            cast_rays_singly(prims, tree, base, tile, first, workspace, any_hit)


@jit
def cast_packets_brute_force(prims: Any, number: int, base: int, count: int, tile: Any, any_hit: bool) -> None:
    """The same for all primitives of a kind without a tree."""
    for k in range(number):
        prim, prim_number = load(prims, k), float(base + k)
        for first in range(lane(0), lane(count), PACKET_SIZE):
            cast_lanes(prims, prim, prim_number, tile, first, any_hit)
