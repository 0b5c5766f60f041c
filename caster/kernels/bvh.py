"""Culling 2: a tree of boxes, for any rays, one after the other."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.kernels.jit import inlined, jit
from caster.kernels.protocol import Vec3, intersect, nearer, note, numbers, passes, prepare, recall

# A box is met from (low + c) / d to (high + c) / d along an axis, c being its reference point seen from the origin,
# less or more the pad, taken as low (1/d) + c (1/d). What the products round, u (|low| + |c|) in space, is in REACH;
# 1/d and the sum are off by u each of the distance itself, so the far side is pushed out by 1 + 2 gamma_3 (Ize 2013),
# gamma_3 = 3 u / (1 - 3 u), u = 2^-53.
FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)


LATEST = float(np.finfo(np.float64).max)  # for boxes that are entered at a t beyond float64


class View(NamedTuple):
    """What boxes have to do with a ray: near and far sides by the sign bit of d, so that -0.0 goes backwards."""

    near: tuple[int, int, int]  # columns of Tree.boxes
    far: tuple[int, int, int]
    inverse: Vec3  # 1/d, times the tree's unit
    enter: Vec3  # the tree's centre over d, less the pad
    leave: Vec3  # more the pad


@inlined
def inverse_of(x: float, steep: float) -> float:
    """1 / x, `steep` at most."""
    return math.copysign(steep, x) if abs(x) <= 1.0 / steep else 1.0 / x


@inlined
def pad_of(tree: Any, o: Vec3) -> float:
    """By how much boxes are widened for rays from o."""
    return tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)


@inlined
def view_along(tree: Any, o: Vec3, d: Vec3) -> View:
    """How a ray sees the boxes of a tree."""
    x, y, z = inverse_of(d[0], tree.steep), inverse_of(d[1], tree.steep), inverse_of(d[2], tree.steep)
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
def enters(boxes: Any, node: int, view: Any, t_min: float, t_max: float) -> float:
    """Where the ray, widened by the pad, enters the box of a node between t_min and t_max; inf if it does not."""
    x, y, z = view.inverse
    a = float(boxes[node, view.near[0]]) * x + view.enter[0]
    b = float(boxes[node, view.near[1]]) * y + view.enter[1]
    c = float(boxes[node, view.near[2]]) * z + view.enter[2]
    near = max(max(a, b), max(c, t_min))
    a = float(boxes[node, view.far[0]]) * x + view.leave[0]
    b = float(boxes[node, view.far[1]]) * y + view.leave[1]
    c = float(boxes[node, view.far[2]]) * z + view.leave[2]
    far = min(min(min(a, b), c) * FAR_PADDING, t_max)
    return min(near, LATEST) if near <= far else math.inf


@inlined
def traverse(mode: Any, prims: Any, tree: Any, i: int, ray: Any, best: Any, room: Any) -> Any:
    """The best of ray i (o, d, t_min, t_max) once all of a kind has been looked at; the nearer of two boxes first.

    A box at exactly the nearest t is opened, so no tie is lost.
    """
    stack, entries = room
    o, d, t_min, t_max = ray
    view = view_along(tree, o, d)
    top, stack[0], entries[0] = 1, 0, -math.inf
    while top > 0:
        top -= 1
        limit = min(t_max, best[0] + best[1])
        if entries[top] > limit:
            continue
        node = stack[top]
        start, number = tree.links[node, 0], tree.links[node, 1]
        if number < 0:
            a, b = node + 1, start
            enter_a = enters(tree.boxes, a, view, t_min, limit)
            enter_b = enters(tree.boxes, b, view, t_min, limit)
            swap = enter_b < enter_a
            # pushed whether or not it is entered; if not, the next one takes its place
            stack[top], entries[top] = a if swap else b, max(enter_a, enter_b)
            top += max(enter_a, enter_b) < math.inf
            stack[top], entries[top] = b if swap else a, min(enter_a, enter_b)
            top += min(enter_a, enter_b) < math.inf
            continue
        for at in range(start, start + number):
            k = tree.order[at]
            pre = prepare(prims, numbers(prims, k), o)
            if not passes(prims, pre, d):
                best = nearer(mode, best, i, k, intersect(prims, pre, d, t_min, t_max))
    return best


@jit
def cast_bvh(mode: Any, prims: Any, tree: Any, rays: Any, record: Any, span: Any, room: Any) -> None:
    """Rays span[0]..span[1] against one kind."""
    for i in range(span[0], span[1]):
        o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
        d = rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]
        ray = o, d, rays.t_min[i], rays.t_max[i]
        note(mode, record, i, traverse(mode, prims, tree, i, ray, recall(mode, record, i), room))
