"""Culling 2 for many rays: neighbours in a tile go through a tree of boxes together, LANES at a time."""

from typing import Any

from caster.kernels.bvh import FAR_PADDING, inverse_of, pad_of, traverse
from caster.kernels.jit import LANES, inlined, jit
from caster.kernels.nearest import Folding
from caster.kernels.protocol import numbers
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
    T_MAX,
    T_MIN,
    VIEW,
    T,
    cast_lanes,
    lane,
)

# How the rays of a bundle see the boxes: 1/d times the tree's unit, and where the tree's centre is along each axis,
# less and more the pad (kernels/bvh.py).
(IX, IY, IZ, LX, LY, LZ, HX, HY, HZ) = (lane(int(VIEW) + LANES * field) for field in range(9))
MANY = lane(LANES)


@inlined
def view_bundle(tree: Any, tile: Any, first: Any) -> None:
    """Fill the bundle's view. Along an axis a box is met between the lesser and the larger of two numbers."""
    for j in range(MANY):
        i = first + j
        o = tile[OX + i], tile[OY + i], tile[OZ + i]
        x, y = inverse_of(tile[DX + i], tree.steep), inverse_of(tile[DY + i], tree.steep)
        z = inverse_of(tile[DZ + i], tree.steep)
        a, b, c = tree.center[0] - o[0], tree.center[1] - o[1], tree.center[2] - o[2]
        pad = pad_of(tree, o)
        tile[IX + j], tile[IY + j], tile[IZ + j] = tree.unit * x, tree.unit * y, tree.unit * z
        tile[LX + j], tile[LY + j], tile[LZ + j] = (a - pad) * x, (b - pad) * y, (c - pad) * z
        tile[HX + j], tile[HY + j], tile[HZ + j] = (a + pad) * x, (b + pad) * y, (c + pad) * z


@inlined
def entering(low: Any, high: Any, tile: Any, first: Any) -> int:
    """How many rays of the bundle enter a box before what they have met."""
    count = 0
    for j in range(MANY):
        i = first + j
        a, b = low[0] * tile[IX + j] + tile[LX + j], high[0] * tile[IX + j] + tile[HX + j]
        near, far = min(a, b), max(a, b)
        a, b = low[1] * tile[IY + j] + tile[LY + j], high[1] * tile[IY + j] + tile[HY + j]
        near, far = max(near, min(a, b)), min(far, max(a, b))
        a, b = low[2] * tile[IZ + j] + tile[LZ + j], high[2] * tile[IZ + j] + tile[HZ + j]
        near, far = max(near, min(a, b)), min(far, max(a, b))
        limit = min(tile[T_MAX + i], tile[T + i] + tile[OFF + i])
        count += 1 if max(near, tile[T_MIN + i]) <= min(far * FAR_PADDING, limit) else 0
    return count


# Rays go together whose directions differ by no more than this share of the first one's, and whose origins by no more
# than this share of the tree's size: about where going together takes as long as going alone.
TOGETHER = 0.25


@inlined
def is_coherent(tree: Any, tile: Any, first: Any) -> bool:
    """Whether the rays of a bundle meet much the same boxes. It changes no bit."""
    turn = TOGETHER * (abs(tile[DX + first]) + abs(tile[DY + first]) + abs(tile[DZ + first]))
    step, apart = TOGETHER * tree.unit, 0
    for i in range(first, first + MANY):
        x, y, z = (
            tile[DX + i] - tile[DX + first],
            tile[DY + i] - tile[DY + first],
            tile[DZ + i] - tile[DZ + first],
        )
        p, q, r = (
            tile[OX + i] - tile[OX + first],
            tile[OY + i] - tile[OY + first],
            tile[OZ + i] - tile[OZ + first],
        )
        far = (abs(x) + abs(y) + abs(z) > turn) | (abs(p) + abs(q) + abs(r) > step)
        apart += 1 if far & (tile[T_MAX + i] >= 0.0) else 0
    return apart == 0


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
    stack = room[0]
    for first in range(lane(0), lane(count), MANY):
        if not is_coherent(tree, tile, first):
            cast_alone(prims, tree, base, tile, first, room, any_hit)
            continue
        view_bundle(tree, tile, first)
        forward = tile[IX] > 0.0, tile[IY] > 0.0, tile[IZ] > 0.0
        top, stack[0] = 1, 0
        while top > 0:
            top -= 1
            node = stack[top]
            low = float(tree.boxes[node, 0]), float(tree.boxes[node, 1]), float(tree.boxes[node, 2])
            high = float(tree.boxes[node, 3]), float(tree.boxes[node, 4]), float(tree.boxes[node, 5])
            if entering(low, high, tile, first) == 0:
                continue
            start, number = tree.links[node, 0], tree.links[node, 1]
            if number < 0:
                axis = -1 - number
                onwards = forward[0] if axis == 0 else (forward[1] if axis == 1 else forward[2])
                stack[top] = start if onwards else node + 1
                stack[top + 1] = node + 1 if onwards else start
                top += 2
                continue
            for at in range(start, start + number):
                k = tree.order[at]
                cast_lanes(prims, numbers(prims, k), float(base + k), tile, first, any_hit)


@jit
def cast_all(prims: Any, number: int, base: int, count: int, tile: Any, any_hit: bool) -> None:
    """The same for a kind without a tree: all of its primitives."""
    for k in range(number):
        prim, place = numbers(prims, k), float(base + k)
        for first in range(lane(0), lane(count), MANY):
            cast_lanes(prims, prim, place, tile, first, any_hit)
