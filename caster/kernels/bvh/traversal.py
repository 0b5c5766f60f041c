"""Culling 2: a tree of boxes, for any rays, one after the other."""

import math
from typing import Any, NamedTuple

from caster.jit.decorators import inlined, jit
from caster.jit.simd import intersect_boxes, lowest_bit
from caster.kernels.bvh.build import LEAF_SIZE_BASE
from caster.kernels.protocol import (
    Vec3,
    intersect,
    load,
    load_best,
    prepare,
    store_best,
    surely_misses,
    update_best,
)

# A box is met from (low + c) / d to (high + c) / d along an axis, c being its reference point relative to the origin,
# less or more the pad, taken as low (1/d) + c (1/d). What the products round, u (|low| + |c|) in space, is in REACH;
# what 1/d and the sum do is in FAR_PADDING.


class RayBoxSetup(NamedTuple):
    """What boxes have to do with a ray: near and far sides by the sign bit of d, so that -0.0 goes backwards."""

    near: tuple[int, int, int]  # rows of Tree.boxes[node]
    far: tuple[int, int, int]
    inverse: Vec3  # 1/d, times the tree's unit
    enter: Vec3  # the tree's centre over d, less the pad
    leave: Vec3  # more the pad


@inlined
def safe_inverse(x: float, flat: float) -> float:
    """1 / x, 1 / `flat` at most. Without a branch."""
    return 1.0 / math.copysign(max(abs(x), flat), x)


@inlined
def box_padding(tree: Any, o: Vec3) -> float:
    """By how much boxes are widened for rays from o."""
    return tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)


@inlined
def ray_box_setup(tree: Any, o: Vec3, d: Vec3) -> RayBoxSetup:
    """Precomputed reciprocals and error bounds of a ray for box tests."""
    x, y, z = safe_inverse(d[0], tree.flat), safe_inverse(d[1], tree.flat), safe_inverse(d[2], tree.flat)
    a, b, c = tree.center[0] - o[0], tree.center[1] - o[1], tree.center[2] - o[2]
    pad = box_padding(tree, o)
    near = 0 if x > 0.0 else 3, 1 if y > 0.0 else 4, 2 if z > 0.0 else 5
    p, q, r = math.copysign(pad, x), math.copysign(pad, y), math.copysign(pad, z)
    return RayBoxSetup(
        near,
        (3 - near[0], 5 - near[1], 7 - near[2]),
        (tree.unit * x, tree.unit * y, tree.unit * z),
        ((a - p) * x, (b - q) * y, (c - r) * z),
        ((a + p) * x, (b + q) * y, (c + r) * z),
    )


@inlined
def push_children(links: Any, node: int, mask: int, top: int, workspace: Any) -> tuple[int, int]:
    """(what is in the box that is entered first, top), the other boxes of a mask that is not 0 put onto the stack."""
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
    """The top of the stack without what is entered beyond the limit."""
    entries = workspace[1]
    while entries[top - 1] > limit:
        top -= 1
    return top


@inlined
def traverse(mode: Any, prims: Any, tree: Any, i: int, ray: Any, best: Any, workspace: Any) -> Any:
    """The best of ray i (o, d, t_min, t_max) once all of a kind has been looked at; the nearest of the boxes first.

    A box at exactly the nearest t is opened, so no tie is lost. room: the stack, where its boxes are entered, and
    where a node's are.
    """
    stack, entries, near = workspace
    o, d, t_min, t_max = ray
    view = ray_box_setup(tree, o, d)
    limit = min(t_max, best[0] + best[1])
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
                k = tree.order[at]
                pre = prepare(prims, load(prims, k), o)
                if not surely_misses(prims, pre, d):
                    best = update_best(mode, best, i, k, intersect(prims, pre, d, t_min, t_max))
            limit = min(t_max, best[0] + best[1])
        top = pop_beyond(top, limit, workspace) - 1
        inside = stack[top]
    return best


@jit
def cast_bvh(
    mode: Any, prims: Any, tree: Any, rays: Any, record: Any, ray_range: Any, workspace: Any
) -> None:
    """Rays ray_range[0]..ray_range[1] against one kind."""
    for i in range(ray_range[0], ray_range[1]):
        o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
        d = rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]
        ray = o, d, rays.t_min[i], rays.t_max[i]
        store_best(
            mode, record, i, traverse(mode, prims, tree, i, ray, load_best(mode, record, i), workspace)
        )
