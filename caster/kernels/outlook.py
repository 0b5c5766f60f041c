"""What is known of all rays of a tile at once: how far they see, and which way they look."""

import math
from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import LANES, any_reaches
from caster.kernels.protocol import Vec3
from caster.kernels.tile import DX, DY, DZ, OFF, VIEW, WIDTH, Box, T, lane
from caster.kernels.vec import add, dot, greater, lesser, scaled, size, sub


@jit
def reach_of(tile: Any, box: Box, forward: Any) -> float:
    """By how much a depth is at least to be multiplied for a ray of the tile to be at it: t d . forward = depth."""
    for j in range(lane(LANES)):
        tile[VIEW + j] = 0.0
    for y in range(box[3] - box[1]):
        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            for j in range(lane(LANES)):  # some maxima side by side, so that several are compared at once
                i = first + j
                ahead = tile[DX + i] * forward[0] + tile[DY + i] * forward[1] + tile[DZ + i] * forward[2]
                tile[VIEW + j] = max(tile[VIEW + j], ahead)
    most = 0.0
    for j in range(lane(LANES)):
        most = max(most, tile[VIEW + j])
    return 1.0 / most if most > 0.0 else 0.0


@jit
def farthest(tile: Any, box: Box) -> float:
    """How far a tile can be seen into anywhere: inf if only at one pixel, which is soon found."""
    for j in range(lane(LANES)):
        tile[VIEW + j] = 0.0
    for y in range(box[3] - box[1]):
        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            if any_reaches(tile, T + first, OFF + first, math.inf):
                return math.inf
            for j in range(lane(LANES)):
                tile[VIEW + j] = max(tile[VIEW + j], tile[T + first + j] + tile[OFF + first + j])
    far = 0.0
    for j in range(lane(LANES)):
        far = max(far, tile[VIEW + j])
    return far


@inlined
def directions(tile: Any, box: Box, forward: Vec3) -> tuple[Vec3, Vec3]:
    """(low, high): between which the components of all d of a tile are."""
    if size(forward) > 0.0:
        return between_corners(tile, box)
    x, y, z = span_of(tile, DX, box), span_of(tile, DY, box), span_of(tile, DZ, box)
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])


# Of the lengths of four d that are 1 within a few u, and of sums and quotients of them.
ABOUT = 2.0**-45


@inlined
def between_corners(tile: Any, box: Box) -> tuple[Vec3, Vec3]:
    """The same where straight lines stay straight and |d| = 1: d = s / |s|, s between the d of a tile's corners.

    With weights w_i that add up to 1, |sum w_i d_i|^2 = 1 - sum over i < j of w_i w_j |d_i - d_j|^2, and the products
    of two of four weights are at most 3/8 together.
    """
    right, below = lane(box[2] - box[0] - 1), lane((box[3] - box[1] - 1) * WIDTH)
    a, b = vector_at(tile, lane(0)), vector_at(tile, right)
    c, d = vector_at(tile, below), vector_at(tile, below + right)
    low = lesser(lesser(a, b), lesser(c, d))
    high = greater(greater(a, b), greater(c, d))
    wide = sub(high, low)
    shrunk = 1.0 - 0.375 * dot(wide, wide)
    longer = (1.0 / math.sqrt(shrunk) if shrunk > 0.0 else math.inf) + ABOUT
    less, more = (scaled(longer, low), scaled(longer, high))
    return add(lesser(low, less), (-ABOUT, -ABOUT, -ABOUT)), add(greater(high, more), (ABOUT, ABOUT, ABOUT))


@inlined
def vector_at(tile: Any, i: Any) -> Vec3:
    return tile[DX + i], tile[DY + i], tile[DZ + i]


@inlined
def span_of(tile: Any, field: Any, box: Box) -> tuple[float, float]:
    """(least, largest) of a field, over the tile's part of a box in whole LANES."""
    least, most = VIEW, VIEW + lane(LANES)
    for j in range(lane(LANES)):
        tile[least + j], tile[most + j] = math.inf, -math.inf
    for y in range(box[3] - box[1]):
        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):
            for j in range(lane(LANES)):  # some side by side, so that several are compared at once
                d = tile[field + first + j]
                tile[least + j], tile[most + j] = min(tile[least + j], d), max(tile[most + j], d)
    low, high = math.inf, -math.inf
    for j in range(lane(LANES)):
        low, high = min(low, tile[least + j]), max(high, tile[most + j])
    return low, high
