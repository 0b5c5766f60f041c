"""Culling 2 for many rays: neighbours in a tile go through a tree of boxes together, LANES at a time."""

import math
from typing import Any, NamedTuple

from caster.kernels.bvh import nearest_of, next_of, pad_of, traverse
from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import LANES, enter_boxes_together, least_of, most_of, most_of_sums
from caster.kernels.nearest import Folding
from caster.kernels.protocol import Vec3, numbers
from caster.kernels.tile import (
    DOUBT,
    DX,
    DY,
    DZ,
    OFF,
    OX,
    OY,
    OZ,
    PLACE,
    STRIDE,
    T_MAX,
    T_MIN,
    T,
    cast_lanes,
    lane,
)
from caster.kernels.tree import NUMBERS

MANY = lane(LANES)

Vec3Pair = tuple[Vec3, Vec3]


class Views(NamedTuple):
    """What boxes have to do with several rays. An axis along which some go forwards, some backwards tells nothing."""

    near: tuple[int, int, int]  # rows of Tree.boxes[node]
    far: tuple[int, int, int]
    least: Vec3  # of 1/d
    most: Vec3
    enter: Vec3  # the tree's centre seen from that origin from which the near side is nearest, less the pad
    leave: Vec3  # the far side is farthest, more the pad
    unit: float


@inlined
def spread(tile: Any, field: Any, first: Any) -> Vec3Pair:
    """The least x, y, z of a bundle's origins or directions, and the largest."""
    x, y, z = field + first, field + lane(STRIDE) + first, field + lane(2 * STRIDE) + first
    return (
        (least_of(tile, x), least_of(tile, y), least_of(tile, z)),
        (most_of(tile, x), most_of(tile, y), most_of(tile, z)),
    )


# Rays go together whose directions differ by no more than this share of the first one's, and whose origins by no more
# than this share of the tree's size: about where going together takes as long as going alone.
TOGETHER = 0.25


@inlined
def is_coherent(tree: Any, tile: Any, first: Any, origins: Vec3Pair, directions: Vec3Pair) -> bool:
    """Whether the rays of a bundle meet much the same boxes. It changes no bit."""
    turn = abs(tile[DX + first]) + abs(tile[DY + first]) + abs(tile[DZ + first])
    return (distance(origins) <= TOGETHER * tree.unit) & (distance(directions) <= TOGETHER * turn)


@inlined
def distance(ends: Vec3Pair) -> float:
    low, high = ends
    return (high[0] - low[0]) + (high[1] - low[1]) + (high[2] - low[2])


@inlined
def view_together(tree: Any, origins: Vec3Pair, directions: Vec3Pair) -> Views:
    """How rays whose origins and directions lie between these see the boxes of a tree."""
    pad = max(pad_of(tree, origins[0]), pad_of(tree, origins[1]))
    x, y, z = (
        along_axis(tree, origins, directions, pad, 0),
        along_axis(tree, origins, directions, pad, 1),
        along_axis(tree, origins, directions, pad, 2),
    )
    return Views(
        (0 if x[4] else 3, 1 if y[4] else 4, 2 if z[4] else 5),
        (3 if x[4] else 0, 4 if y[4] else 1, 5 if z[4] else 2),
        (x[0], y[0], z[0]),
        (x[1], y[1], z[1]),
        (x[2], y[2], z[2]),
        (x[3], y[3], z[3]),
        tree.unit,
    )


@inlined
def along_axis(
    tree: Any, origins: Vec3Pair, directions: Vec3Pair, pad: float, axis: int
) -> tuple[float, float, float, float, bool]:
    """Of one axis: least, most, enter, leave, and whether the rays go forwards."""
    low_d, high_d = directions[0][axis], directions[1][axis]
    mixed, forwards = (low_d < 0.0) & (high_d > 0.0), low_d >= 0.0
    low_d = max(low_d, tree.flat) if forwards else min(low_d, -tree.flat)
    high_d = max(high_d, tree.flat) if forwards else min(high_d, -tree.flat)
    low = tree.center[axis] - origins[1][axis] - pad
    high = tree.center[axis] - origins[0][axis] + pad
    return (
        1.0 if mixed else 1.0 / high_d,
        1.0 if mixed else 1.0 / low_d,
        -math.inf if mixed else (low if forwards else high),
        math.inf if mixed else (high if forwards else low),
        forwards,
    )


@jit
def cast_alone(prims: Any, tree: Any, base: int, tile: Any, first: Any, room: Any, any_hit: bool) -> None:
    """The rays of a bundle one by one."""
    mode = Folding(tree.order, any_hit)  # whose numbers are not read
    for i in range(first, first + MANY):
        o, d = (tile[OX + i], tile[OY + i], tile[OZ + i]), (tile[DX + i], tile[DY + i], tile[DZ + i])
        held = tile[T + i], tile[OFF + i], -1, False
        best = traverse(mode, prims, tree, i, (o, d, tile[T_MIN + i], tile[T_MAX + i]), held, room)
        if best[2] >= 0:
            tile[T + i], tile[OFF + i], tile[PLACE + i] = best[0], best[1], float(base + best[2])
        if best[3]:
            tile[DOUBT + i] = 1.0


@jit
def cast_bundles(prims: Any, tree: Any, base: int, count: int, tile: Any, room: Any, any_hit: bool) -> None:
    """The first `count` rays of a tile against a kind whose places begin at `base`.

    any_hit: whether to stop at anything that is hit for sure.
    """
    for first in range(lane(0), lane(count), MANY):
        origins, directions = spread(tile, OX, first), spread(tile, DX, first)
        if is_coherent(tree, tile, first, origins, directions):
            view = view_together(tree, origins, directions)
            cast_together(prims, tree, base, tile, first, view, room, any_hit)
        else:
            cast_alone(prims, tree, base, tile, first, room, any_hit)


@inlined
def cast_together(
    prims: Any, tree: Any, base: int, tile: Any, first: Any, view: Views, room: Any, any_hit: bool
) -> None:
    """The rays of a bundle all at once: `traverse` for boxes that any of them may enter."""
    stack, entries, near = room
    t_min, t_max = least_of(tile, T_MIN + first), most_of(tile, T_MAX + first)
    limit = min(t_max, most_of_sums(tile, T + first, OFF + first))
    inside, top, entries[0] = 0, 1, -math.inf
    while top > 0:
        if inside >= 0:
            mask = enter_boxes_together(tree.boxes, inside, view, t_min, limit, near)
            if mask != 0:
                inside, top = nearest_of(tree.links, inside, mask, top, room)
                continue
        else:
            start, number = ~inside // NUMBERS, ~inside % NUMBERS
            for at in range(start, start + number):
                k = tree.order[at]
                cast_lanes(prims, numbers(prims, k), float(base + k), tile, first, any_hit)
            limit = min(t_max, most_of_sums(tile, T + first, OFF + first))
        top = next_of(top, limit, room) - 1
        inside = stack[top]


@jit
def cast_all(prims: Any, number: int, base: int, count: int, tile: Any, any_hit: bool) -> None:
    """The same for a kind without a tree: all of its primitives."""
    for k in range(number):
        prim, place = numbers(prims, k), float(base + k)
        for first in range(lane(0), lane(count), MANY):
            cast_lanes(prims, prim, place, tile, first, any_hit)
