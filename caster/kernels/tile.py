"""A tile of the film: its rays and what each meets first, in one flat array that stays in a core's cache.

A field is SIZE numbers in a row, one a pixel, and `tile[T + i]` is t of pixel i. Since all fields lie in one array at
known distances, the compiler knows that a store into one changes no other, and handles several pixels at once.
"""

import math
from typing import Any

import numpy as np

from caster.kernels.jit import COMPILED, inlined, jit
from caster.kernels.protocol import ray

WIDTH, HEIGHT = 128, 64  # pixels
SIZE = WIDTH * HEIGHT

# Spans are widened to so many pixels, as many float64 as AVX-512 takes at once; uncompiled that would be in vain.
LANES = 8 if COMPILED else 1

# An index without a sign needs no look at whether it counts from the end.
lane = np.uint64 if COMPILED else int

FIELDS = 12
T, OFF, PLACE, DOUBT, T_MIN, T_MAX, DX, DY, DZ, OX, OY, OZ = (lane(SIZE * field) for field in range(FIELDS))
# T, OFF: the nearest so far, the true t within OFF; PLACE: number of the primitive, kind by kind, -1 for none;
# DOUBT: 1 where something else may come first. The rest are the ray's; T_MAX < 0: there is none.

# Once all is cast, three of them are free for normals.
NX, NY, NZ = OFF, T_MIN, T_MAX

# Behind the fields: how the rays of a bundle see boxes (kernels/bundle.py).
VIEW = lane(SIZE * FIELDS)
VIEW_SIZE = 9 * LANES

Box = tuple[int, int, int, int]  # x0, y0, x1, y1: pixels of the window, x1 and y1 just outside


def new_tile() -> np.ndarray:
    return np.zeros(FIELDS * SIZE + VIEW_SIZE)


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


@jit
def pad(tile: Any, y: int, start: int) -> None:
    """No rays in what is left of row y."""
    for i in range(lane(y * WIDTH + start), lane((y + 1) * WIDTH)):
        put_ray(tile, i, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, -1.0))


@jit
def load_rays(rays: Any, width: int, box: Box, tile: Any) -> None:
    """Begin the tile of a box, with rays of a window that is `width` pixels wide."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        first = (y0 + y) * width + x0
        for x in range(x1 - x0):
            n = first + x
            o, d = (rays.o[n, 0], rays.o[n, 1], rays.o[n, 2]), (rays.d[n, 0], rays.d[n, 1], rays.d[n, 2])
            put_ray(tile, lane(y * WIDTH + x), (o, d, rays.t_min[n], rays.t_max[n]))
        pad(tile, y, x1 - x0)


@jit
def load_run(rays: Any, start: int, stop: int, tile: Any) -> None:
    """Begin a tile with rays start..stop, filled up to whole LANES with none."""
    for n in range(start, stop):
        o, d = (rays.o[n, 0], rays.o[n, 1], rays.o[n, 2]), (rays.d[n, 0], rays.d[n, 1], rays.d[n, 2])
        put_ray(tile, lane(n - start), (o, d, rays.t_min[n], rays.t_max[n]))
    for i in range(lane(stop - start), lane(-(-(stop - start) // LANES) * LANES)):
        put_ray(tile, i, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, -1.0))


@jit
def store_run(tile: Any, ids: Any, start: int, stop: int, nearest: Any, doubt: Any) -> None:
    """Into the record of rays start..stop; ids[place] is the primitive's number in the scene."""
    for n in range(start, stop):
        i = lane(n - start)
        place = int(tile[PLACE + i])
        nearest.t[n], nearest.off[n], doubt[n] = tile[T + i], tile[OFF + i], tile[DOUBT + i] != 0.0
        nearest.prim[n] = ids[place] if place >= 0 else -1


@jit
def shoot_rays(camera: Any, window: Any, box: Box, tile: Any) -> None:
    """Begin the tile of a box, with the camera's rays through its pixel centres."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        row = window.y0 + y0 + y + 0.5
        for x in range(x1 - x0):
            aim = ray(camera, window.x0 + x0 + x + 0.5, row)
            put_ray(tile, lane(y * WIDTH + x), aim)
        pad(tile, y, x1 - x0)


@jit
def store_nearest(tile: Any, ids: Any, width: int, box: Box, nearest: Any, doubt: Any) -> None:
    """Into the record of a window `width` pixels wide; ids[place] is the primitive's number in the scene."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        first = (y0 + y) * width + x0
        for x in range(x1 - x0):
            i, n = lane(y * WIDTH + x), first + x
            place = int(tile[PLACE + i])
            nearest.t[n], nearest.off[n], doubt[n] = tile[T + i], tile[OFF + i], tile[DOUBT + i] != 0.0
            nearest.prim[n] = ids[place] if place >= 0 else -1
