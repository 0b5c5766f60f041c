"""A tile of the film: its rays and what each meets first, in one flat array that stays in a core's cache.

A field is numbers in a row, one a pixel, and `tile[T + i]` is t of pixel i. Since all fields lie in one array at
known distances, the compiler knows that a store into one changes no other, and handles several pixels at once.
"""

import math
from typing import Any

import numpy as np

from caster.kernels.compiling.kernel_cache import COMPILED
from caster.kernels.jit import inlined, jit
from caster.kernels.lanes import LANES
from caster.kernels.nearest import at_once
from caster.kernels.protocol import intersect, prepare, ray

WIDTH, HEIGHT = 128, 64  # pixels
SIZE = WIDTH * HEIGHT

# An index without a sign needs no look at whether it counts from the end.
lane = np.uint64 if COMPILED else int

# From one field to the next: a cache line more than SIZE, or a pixel's twelve numbers, at distances of a power of two,
# would all compete for one place in the cache.
STRIDE = SIZE + 8

FIELDS = 12
T, OFF, PLACE, DOUBT, T_MIN, T_MAX, DX, DY, DZ, OX, OY, OZ = (lane(STRIDE * field) for field in range(FIELDS))
# T, OFF: the nearest so far, the true t within OFF; PLACE: number of the primitive, kind by kind, -1 for none;
# DOUBT: 1 where something else may come first. The rest are the ray's; T_MAX < 0: there is none.

# Once all is cast, three of them are free for normals.
NX, NY, NZ = OFF, T_MIN, T_MAX

# Behind the fields: how the rays of a bundle see boxes (kernels/bundle.py).
VIEW = lane(STRIDE * FIELDS)
VIEW_SIZE = 9 * LANES

Box = tuple[int, int, int, int]  # x0, y0, x1, y1: pixels of the window, x1 and y1 just outside


CACHE_LINE = 64  # bytes


def new_tile() -> np.ndarray:
    """Zeros, from the beginning of a cache line, so that LANES numbers never lie in two."""
    room = np.zeros(FIELDS * STRIDE + VIEW_SIZE + CACHE_LINE // 8)
    first = -room.ctypes.data % CACHE_LINE // 8
    return room[first : first + FIELDS * STRIDE + VIEW_SIZE]


@inlined
def keep_first(tile: Any, i: Any, place: float, t: float, off: float) -> None:
    """Fold what `intersect` said of a primitive into the record of pixel i. Without a branch."""
    ahead, margin = tile[T + i] - t if t < math.inf else -math.inf, tile[OFF + i] + off
    nearer = ahead > margin
    tile[DOUBT + i] = 1.0 if abs(ahead) <= margin else tile[DOUBT + i]
    tile[T + i] = t if nearer else tile[T + i]
    tile[PLACE + i] = place if nearer else tile[PLACE + i]
    tile[OFF + i] = off if nearer else tile[OFF + i]


@inlined
def put_ray(tile: Any, i: Any, aim: Any) -> None:
    """Begin pixel i: its ray (o, d, t_min, t_max), and nothing met."""
    o, d, t_min, t_max = aim
    tile[T + i], tile[OFF + i], tile[PLACE + i], tile[DOUBT + i] = math.inf, 0.0, -1.0, 0.0
    tile[T_MIN + i], tile[T_MAX + i] = t_min, t_max
    tile[DX + i], tile[DY + i], tile[DZ + i] = d[0], d[1], d[2]
    tile[OX + i], tile[OY + i], tile[OZ + i] = o[0], o[1], o[2]


@inlined
def cast_lanes(prims: Any, prim: Any, place: float, tile: Any, first: Any, any_hit: bool) -> None:
    """LANES rays from `first` on, wherever they start, against a primitive given by its `numbers`."""
    for i in range(first, first + lane(LANES)):
        o = tile[OX + i], tile[OY + i], tile[OZ + i]
        d = tile[DX + i], tile[DY + i], tile[DZ + i]
        t, off = intersect(prims, prepare(prims, prim, o), d, tile[T_MIN + i], tile[T_MAX + i])
        t, off = at_once(t, off, any_hit)
        keep_first(tile, i, place, t, off)


@jit
def put_none(tile: Any, start: int, stop: int) -> None:
    """No rays at start..stop."""
    for i in range(lane(start), lane(stop)):
        put_ray(tile, i, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, -1.0))


@jit
def load_run(rays: Any, start: int, stop: int, tile: Any, at: int) -> None:
    """Begin a tile from `at` on, with rays start..stop."""
    for n in range(start, stop):
        o, d = (rays.o[n, 0], rays.o[n, 1], rays.o[n, 2]), (rays.d[n, 0], rays.d[n, 1], rays.d[n, 2])
        put_ray(tile, lane(at + n - start), (o, d, rays.t_min[n], rays.t_max[n]))


@jit
def load_rays(rays: Any, width: int, box: Box, tile: Any) -> None:
    """Begin the tile of a box, with rays of a window that is `width` pixels wide."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        first = (y0 + y) * width + x0
        load_run(rays, first, first + x1 - x0, tile, y * WIDTH)
        put_none(tile, y * WIDTH + x1 - x0, (y + 1) * WIDTH)


@jit
def shoot_rays(camera: Any, window: Any, box: Box, tile: Any) -> None:
    """Begin the tile of a box, with the camera's rays through its pixel centres."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        row = window.y0 + y0 + y + 0.5
        for x in range(x1 - x0):
            aim = ray(camera, window.x0 + x0 + x + 0.5, row)
            put_ray(tile, lane(y * WIDTH + x), aim)
        put_none(tile, y * WIDTH + x1 - x0, (y + 1) * WIDTH)


@jit
def store_run(tile: Any, at: int, ids: Any, start: int, stop: int, nearest: Any, doubt: Any) -> None:
    """From `at` on into the record of rays start..stop; ids[place] is the primitive's number in the scene."""
    for n in range(start, stop):
        i = lane(at + n - start)
        place = int(tile[PLACE + i])
        nearest.t[n], nearest.off[n], doubt[n] = tile[T + i], tile[OFF + i], tile[DOUBT + i] != 0.0
        nearest.prim[n] = ids[place] if place >= 0 else -1


@jit
def store_blocked(tile: Any, count: int, first: int, blocked: Any, doubt: Any) -> None:
    """Whether the first so many rays of a tile have met anything, into the record of rays first.. ."""
    for n in range(count):
        i = lane(n)
        blocked[first + n] = tile[T + i] < math.inf
        doubt[first + n] = (tile[DOUBT + i] != 0.0) & (tile[T + i] == math.inf)


@jit
def store_nearest(tile: Any, ids: Any, width: int, box: Box, nearest: Any, doubt: Any) -> None:
    """The same for the rays of a window that is `width` pixels wide."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        first = (y0 + y) * width + x0
        store_run(tile, y * WIDTH, ids, first, first + x1 - x0, nearest, doubt)
