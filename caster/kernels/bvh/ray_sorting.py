"""The rays of a fan sorted by their projection: neighbours in a tile then meet much the same primitives.

A key is the cell of a ray in the fan's projection (Morton order). The order of rays in a tile changes no bit of a hit.
"""

import math
from typing import Any

from caster.jit.decorators import inlined, jit
from caster.kernels.bvh.fans import FAN_LIMIT, Fan
from caster.kernels.math.vec import dot, max_norm, point_at, row, sub
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import lane

HALF_BITS = 8  # of a cell's number along x and along y, where the first fan has the ray
OTHER_FANS = 1 << (2 * HALF_BITS)  # least key of rays that one of the other five fans has
OTHER_HALF_BITS = HALF_BITS - 2
KEYS = OTHER_FANS + (6 << (2 * OTHER_HALF_BITS))


@inlined
def in_front(fan: Fan, o: Vec3, d: Vec3, outward: bool) -> Vec3:
    """(across, up, forward) of a point of the ray other than the fan's origin, for its projection."""
    a = d if outward else sub(o, fan.origin)
    return dot(fan.across, a), dot(fan.up, a), dot(fan.forward, a)


@jit
def count_strays(fan: Any, rays: Any, outward: bool, deviation: float, start: int, stop: int) -> int:
    """How many of rays start..stop neither start at the fan's origin, nor end there, nor are parallel."""
    strays, p = 0, fan.origin
    if outward:
        for i in range(lane(start), lane(stop)):
            there = (rays.o[i, 0] == p[0]) & (rays.o[i, 1] == p[1]) & (rays.o[i, 2] == p[2])
            strays += 0 if there | (rays.t_max[i] < 0.0) else 1
    else:
        for i in range(lane(start), lane(stop)):
            there = leads_there(fan, row(rays.o, i), row(rays.d, i), rays.t_max[i], deviation)
            strays += 0 if there | (rays.t_max[i] < 0.0) else 1
    return strays


@inlined
def leads_there(fan: Fan, o: Vec3, d: Vec3, t_max: float, deviation: float) -> bool:
    """Whether a ray is parallel to the fan, or ends at its origin within `deviation`.

    A ray to the origin p is nearest to it at t = (p - o).d / d.d. It ends there if o + t d lies within `deviation` of
    p along each axis and the ray goes on no farther than that: then each of its points is as near to the segment from
    o to p.
    """
    if fan.perspective == 0.0:
        return (d[0] == fan.back[0]) & (d[1] == fan.back[1]) & (d[2] == fan.back[2])
    t = dot(sub(fan.origin, o), d) / dot(d, d)
    off = max_norm(sub(point_at(o, t, d), fan.origin))
    beyond = (t_max - t) * max_norm(d)
    return (t > 0.0) & (off <= deviation) & (beyond <= deviation)


@jit
def project_rays(fan: Any, rays: Any, outward: bool, points: Any) -> None:
    """points (n, 2): the projection of each ray by the first fan, NaN for a ray of another fan."""
    for i in range(len(points)):
        x, y, z = in_front(fan, row(rays.o, i), row(rays.d, i), outward)
        over = z if fan.perspective != 0.0 else 1.0
        there = (over > 0.0) & ((fan.perspective == 0.0) | (max(abs(x), abs(y)) <= FAN_LIMIT * over))
        over = over if there else 1.0
        points[i, 0], points[i, 1] = x / over if there else math.nan, y / over if there else math.nan


@inlined
def spread_bits(n: int) -> int:
    """The lower 16 bits of n with a zero after each."""
    n = (n | (n << 8)) & 0x00FF00FF
    n = (n | (n << 4)) & 0x0F0F0F0F
    n = (n | (n << 2)) & 0x33333333
    return (n | (n << 1)) & 0x55555555


@inlined
def cell(x: float, low: float, scale: float, last: int) -> int:
    """The number of a cell along an axis, 0..last."""
    return int(min(max((x - low) * scale, 0.0), float(last)))


@inlined
def projection_key(fan: Fan, a: Vec3, low: Any, scale: Any) -> int:
    """The key of a ray from the result of `in_front`."""
    x, y, z = a
    over = z if fan.perspective != 0.0 else 1.0
    if (over > 0.0) & ((fan.perspective == 0.0) | (max(abs(x), abs(y)) <= FAN_LIMIT * over)):
        last = (1 << HALF_BITS) - 1
        i, j = cell(x / over, low[0], scale[0], last), cell(y / over, low[1], scale[1], last)
        return (spread_bits(j) << 1) | spread_bits(i)
    face, u, v, w = 0, x, y, z  # the side of a cube around the origin, and a point of it
    if (abs(x) >= abs(y)) & (abs(x) >= abs(z)):
        face, u, v, w = 2, y, z, x
    elif abs(y) >= abs(z):
        face, u, v, w = 4, z, x, y
    face += 1 if w < 0.0 else 0
    w = abs(w) if w != 0.0 else 1.0
    last = (1 << OTHER_HALF_BITS) - 1
    i, j = cell(u / w, -1.0, 0.5 * (last + 1), last), cell(v / w, -1.0, 0.5 * (last + 1), last)
    return OTHER_FANS + (face << (2 * OTHER_HALF_BITS)) + ((spread_bits(j) << 1) | spread_bits(i))


@jit
def find_keys(fan: Any, rays: Any, outward: bool, corners: Any, first: int, piece: Any, keys: Any, counts: Any) -> None:
    """keys[i - first]: that of ray i, for rays piece[0]..piece[1]; counts (KEYS,): how many have each.

    corners: least x, y and largest x, y in the projection of the first fan; what lies outside is in the cells at its
    rim.
    """
    x0, y0, x1, y1 = corners
    cells = float(1 << HALF_BITS)
    low, scale = (x0, y0), (cells / (x1 - x0) if x1 > x0 else 0.0, cells / (y1 - y0) if y1 > y0 else 0.0)
    for i in range(piece[0], piece[1]):
        key = projection_key(fan, in_front(fan, row(rays.o, i), row(rays.d, i), outward), low, scale)
        keys[i - first] = key
        counts[key] += 1


@jit
def order_by_keys(keys: Any, places: Any, first: int, piece: Any, order: Any) -> None:
    """Write the numbers of rays piece[0]..piece[1] to order[places[key]:], moving that place on."""
    for i in range(piece[0], piece[1]):
        key = keys[i - first]
        order[places[key]] = i
        places[key] += 1
