"""Culling 2: a tree of boxes, for any rays, one after the other."""

import math
from typing import Any, NamedTuple

from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import enter_boxes, lowest_bit
from caster.kernels.protocol import Vec3, intersect, nearer, note, numbers, passes, prepare, recall
from caster.kernels.tree import NUMBERS

# A box is met from (low + c) / d to (high + c) / d along an axis, c being its reference point seen from the origin,
# less or more the pad, taken as low (1/d) + c (1/d). What the products round, u (|low| + |c|) in space, is in REACH;
# what 1/d and the sum do is in FAR_PADDING.


class View(NamedTuple):
    """What boxes have to do with a ray: near and far sides by the sign bit of d, so that -0.0 goes backwards."""

    near: tuple[int, int, int]  # rows of Tree.boxes[node]
    far: tuple[int, int, int]
    inverse: Vec3  # 1/d, times the tree's unit
    enter: Vec3  # the tree's centre over d, less the pad
    leave: Vec3  # more the pad


@inlined
def inverse_of(x: float, flat: float) -> float:
    """1 / x, 1 / `flat` at most. Without a branch."""
    return 1.0 / math.copysign(max(abs(x), flat), x)


@inlined
def pad_of(tree: Any, o: Vec3) -> float:
    """By how much boxes are widened for rays from o."""
    return tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)


@inlined
def view_along(tree: Any, o: Vec3, d: Vec3) -> View:
    """How a ray sees the boxes of a tree."""
    x, y, z = inverse_of(d[0], tree.flat), inverse_of(d[1], tree.flat), inverse_of(d[2], tree.flat)
    a, b, c = tree.center[0] - o[0], tree.center[1] - o[1], tree.center[2] - o[2]
    pad = pad_of(tree, o)
    near = 0 if x > 0.0 else 3, 1 if y > 0.0 else 4, 2 if z > 0.0 else 5
    p, q, r = math.copysign(pad, x), math.copysign(pad, y), math.copysign(pad, z)
    return View(
        near,
        (3 - near[0], 5 - near[1], 7 - near[2]),
        (tree.unit * x, tree.unit * y, tree.unit * z),
        ((a - p) * x, (b - q) * y, (c - r) * z),
        ((a + p) * x, (b + q) * y, (c + r) * z),
    )


@inlined
def nearest_of(links: Any, node: int, mask: int, top: int, room: Any) -> tuple[int, int]:
    """(what is in the box that is entered first, top), the other boxes of a mask that is not 0 put onto the stack."""
    stack, entries, near = room
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
def next_of(top: int, limit: float, room: Any) -> int:
    """The top of the stack without what is entered beyond the limit."""
    entries = room[1]
    while entries[top - 1] > limit:
        top -= 1
    return top


@inlined
def traverse(mode: Any, prims: Any, tree: Any, i: int, ray: Any, best: Any, room: Any) -> Any:
    """The best of ray i (o, d, t_min, t_max) once all of a kind has been looked at; the nearest of the boxes first.

    A box at exactly the nearest t is opened, so no tie is lost. room: the stack, where its boxes are entered, and
    where a node's are.
    """
    stack, entries, near = room
    o, d, t_min, t_max = ray
    view = view_along(tree, o, d)
    limit = min(t_max, best[0] + best[1])
    inside, top, entries[0] = 0, 1, -math.inf  # under all that waits lies what is always entered
    while top > 0:
        if inside >= 0:
            mask = enter_boxes(tree.boxes, inside, view, t_min, limit, near)
            if mask != 0:
                inside, top = nearest_of(tree.links, inside, mask, top, room)
                continue
        else:
            start, number = ~inside // NUMBERS, ~inside % NUMBERS
            for at in range(start, start + number):
                k = tree.order[at]
                pre = prepare(prims, numbers(prims, k), o)
                if not passes(prims, pre, d):
                    best = nearer(mode, best, i, k, intersect(prims, pre, d, t_min, t_max))
            limit = min(t_max, best[0] + best[1])
        top = next_of(top, limit, room) - 1
        inside = stack[top]
    return best


@jit
def cast_bvh(mode: Any, prims: Any, tree: Any, rays: Any, record: Any, span: Any, room: Any) -> None:
    """Rays span[0]..span[1] against one kind."""
    for i in range(span[0], span[1]):
        o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
        d = rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]
        ray = o, d, rays.t_min[i], rays.t_max[i]
        note(mode, record, i, traverse(mode, prims, tree, i, ray, recall(mode, record, i), room))
