"""A tile: rays and their nearest hits, in one flat array that stays in a core's cache.

A field has a number for each pixel: `tile[T + i]` is t of pixel i. Since all fields lie in one array at known
distances, the compiler knows that a store to one changes no other, and handles several pixels at once.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.jit.command_list import Column
from caster.jit.decorators import inlined, jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import LANES
from caster.kernels.math.vec import row
from caster.kernels.nearest import any_hit_result
from caster.kernels.protocol import Vec3, camera_ray, intersect, prepare

WIDTH, HEIGHT = 128, 64  # pixels
PIXELS = WIDTH * HEIGHT

# An unsigned index is not checked for counting from the end.
lane = np.uint64 if COMPILED else int

# From one field to the next: a cache line more than SIZE, or a pixel's twelve numbers, at distances of a power of two,
# would all compete for one place in the cache.
STRIDE = PIXELS + 8
ONE, TWO = lane(STRIDE), lane(2 * STRIDE)

FIELDS = 12
T, T_ERROR, PRIM, UNCERTAIN, T_MIN, T_MAX, DX, DY, DZ, OX, OY, OZ = (lane(STRIDE * field) for field in range(FIELDS))
# T, T_ERROR: the nearest hit so far, the true t within T_ERROR; PRIM: number of its primitive, kind by kind, or -1;
# UNCERTAIN: 1 if another hit may come first. The others are those of the ray; T_MAX < 0: there is none.

# After the fields: bounds of rays, and the projections of rays by their fan (caster/kernels/bvh/fans.py).
SCRATCH = lane(STRIDE * FIELDS)
SCRATCH_SIZE = 9 * LANES
FAN_X = SCRATCH + lane(SCRATCH_SIZE)
FAN_Y = FAN_X + lane(STRIDE)
TILE_SIZE = FIELDS * STRIDE + SCRATCH_SIZE + 2 * STRIDE

Box = tuple[int, int, int, int]  # x0, y0, x1, y1: pixels of the window, x1 and y1 just outside


def tile_boxes(width: int, height: int) -> Iterator[Box]:
    """The tiles of a film, row by row."""
    for y in range(0, height, HEIGHT):
        for x in range(0, width, WIDTH):
            yield x, y, min(x + WIDTH, width), min(y + HEIGHT, height)


# Arguments of commands for a tile (caster/jit/command_list.py): a row for each tile of a film.
BOX = slice(0, 4)
COUNT, LINES = Column(4), Column(5)  # rays of the tile, in whole rows, and the number of rows
TILE_NUMBERS = 6


class KindNumbers(NamedTuple):
    """Places in a row for one kind of primitive."""

    run: slice  # of BinnedKind.order: where its primitives begin, and how many there are
    present: int  # the second of these


def kind_numbers(k: int) -> KindNumbers:
    at = TILE_NUMBERS + 2 * k
    return KindNumbers(slice(at, at + 2), at + 1)


def tile_rows(width: int, height: int, kinds: int, runs: Sequence[np.ndarray] | None = None) -> np.ndarray:
    """Arguments of commands (tiles, numbers) int64. runs: (tiles + 1,) of each kind; None: all kinds in all tiles."""
    boxes = np.array(list(tile_boxes(width, height)), np.int64).reshape(-1, 4)
    rows = np.zeros((len(boxes), TILE_NUMBERS + 2 * kinds), np.int64)
    rows[:, BOX], rows[:, LINES] = boxes, boxes[:, 3] - boxes[:, 1]
    rows[:, COUNT] = rows[:, LINES] * WIDTH
    for k in range(kinds):
        rows[:, kind_numbers(k).run] = (0, 1) if runs is None else np.column_stack([runs[k][:-1], np.diff(runs[k])])
    return rows


CACHE_LINE = 64  # bytes


def aligned(size: int, new: Callable[[int], np.ndarray]) -> np.ndarray:
    """Allocate `size` float64 by `new`, from a cache line on, so that no vector of LANES numbers crosses one."""
    buffer = new(size + CACHE_LINE // 8)
    first = -buffer.ctypes.data % CACHE_LINE // 8
    return buffer[first : first + size]


def new_tile(new: Callable[[int], np.ndarray] = np.zeros) -> np.ndarray:
    return aligned(TILE_SIZE, new)


@inlined
def get(fields: Any, at: Any) -> Vec3:
    """Three fields of a pixel, of a tile or a surface buffer."""
    return fields[at], fields[at + ONE], fields[at + TWO]


@inlined
def put(fields: Any, at: Any, v: Vec3) -> None:
    fields[at], fields[at + ONE], fields[at + TWO] = v[0], v[1], v[2]


@inlined
def update_nearest(tile: Any, i: Any, prim_number: float, t: float, error: float) -> None:
    """Update the nearest hit of pixel i by the result of `intersect` for a primitive, without a branch."""
    ahead, margin = tile[T + i] - t if t < math.inf else -math.inf, tile[T_ERROR + i] + error
    nearer = ahead > margin
    tile[UNCERTAIN + i] = 1.0 if abs(ahead) <= margin else tile[UNCERTAIN + i]
    tile[T + i] = t if nearer else tile[T + i]
    tile[PRIM + i] = prim_number if nearer else tile[PRIM + i]
    tile[T_ERROR + i] = error if nearer else tile[T_ERROR + i]


@inlined
def start_ray(tile: Any, i: Any, aim: Any) -> None:
    """Set the ray (o, d, t_min, t_max) of pixel i, without a hit."""
    o, d, t_min, t_max = aim
    tile[T + i], tile[T_ERROR + i], tile[PRIM + i], tile[UNCERTAIN + i] = math.inf, 0.0, -1.0, 0.0
    tile[T_MIN + i], tile[T_MAX + i] = t_min, t_max
    put(tile, DX + i, d)
    put(tile, OX + i, o)


@inlined
def cast_lanes(prims: Any, prim: Any, prim_number: float, tile: Any, first: Any, any_hit: bool) -> None:
    """Cast LANES rays from `first` on, of any origins, at a primitive; prim: the result of `load`."""
    for i in range(first, first + lane(LANES)):
        pre = prepare(prims, prim, get(tile, OX + i))
        t, error = intersect(prims, pre, get(tile, DX + i), tile[T_MIN + i], tile[T_MAX + i])
        t, error = any_hit_result(t, error, any_hit)
        update_nearest(tile, i, prim_number, t, error)


@jit
def clear_rays(tile: Any, start: int, stop: int) -> None:
    """Remove the rays at start..stop."""
    for i in range(lane(start), lane(stop)):
        start_ray(tile, i, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, -1.0))


@jit
def load_rays(rays: Any, numbers: Any, tile: Any) -> None:
    """Fill a tile with ray numbers[i] at place i; a negative number stands for no ray."""
    for i in range(lane(len(numbers))):
        k = lane(max(numbers[i], 0))
        t_max = rays.t_max[k] if numbers[i] >= 0 else -1.0
        start_ray(tile, i, (row(rays.o, k), row(rays.d, k), rays.t_min[k], t_max))


@jit
def generate_camera_rays(camera: Any, window: Any, box: Box, tile: Any) -> None:
    """Fill the tile of a box with the camera's rays through its pixel centres."""
    x0, y0, x1, y1 = box
    for y in range(y1 - y0):
        row, left, first = window.y0 + y0 + y + 0.5, window.x0 + x0 + 0.5, lane(y * WIDTH)
        for x in range(lane(WIDTH)):  # a constant count, so that LLVM uses vectors
            start_ray(tile, first + x, camera_ray(camera, left + x, row))
        clear_rays(tile, y * WIDTH + x1 - x0, (y + 1) * WIDTH)


@jit
def store_nearest(tile: Any, numbers: Any, ids: Any, nearest: Any, uncertain: Any) -> None:
    """Nearest hits of a tile's rays, numbered as for `load_rays`; ids[place] is the primitive's number in the scene.

    A fan leaves a t where there is no ray and no hit.
    """
    for i in range(lane(len(numbers))):
        if numbers[i] >= 0:
            k, prim = lane(numbers[i]), tile[PRIM + i]
            nearest.t[k] = tile[T + i] if prim >= 0.0 else math.inf
            nearest.prim[k] = ids[lane(prim)] if prim >= 0.0 else -1
            nearest.error[k], uncertain[k] = tile[T_ERROR + i], tile[UNCERTAIN + i] != 0.0


# The primitives of each tile of the film, near ones first.


# In a tile, primitives are sorted into depth buckets by the exponent of their least depth and 4 bits of its fraction.
# The farthest 8 powers of two have buckets of their own; nearer ones, and those behind, share the first.
DEPTH_BUCKETS, DEPTH_BUCKET_SHIFT = 128, 52 - 4


@jit
def bin_into_tiles(
    pixels: Any, bits: Any, last: int, queue: Any, across: int, ends: Any, order: Any, start: int, stop: int
) -> None:
    """Append primitives queue[start:stop] to the list of each tile that they overlap, by depth bucket.

    bits, last: the bits, as int64, of the depth of each primitive, and of the largest depth.
    The list of tile n and a bucket ends at order[ends[n * DEPTH_BUCKETS + bucket]]. With an empty `order` primitives
    are only counted, in `ends`. Tiles are numbered row by row, `across` in a row. An empty queue stands for all
    primitives in their own order.
    """
    for prim_number in range(start, stop):
        k = queue[prim_number] if len(queue) > 0 else prim_number
        if (pixels[k, 0] < pixels[k, 2]) & (pixels[k, 1] < pixels[k, 3]):
            nearer = (last >> DEPTH_BUCKET_SHIFT) - (bits[k] >> DEPTH_BUCKET_SHIFT)
            into = min(max(DEPTH_BUCKETS - 1 - nearer, 0), DEPTH_BUCKETS - 1)
            for y in range(pixels[k, 1] // HEIGHT, (pixels[k, 3] - 1) // HEIGHT + 1):
                for x in range(pixels[k, 0] // WIDTH, (pixels[k, 2] - 1) // WIDTH + 1):
                    n = (y * across + x) * DEPTH_BUCKETS + into
                    if len(order) > 0:
                        order[ends[n]] = k
                    ends[n] += 1


# Surfaces of many hits at once: SURFACE_LANES pixels of a tile, in a scratch that stays in a core's first-level cache.
# Field f of lane x is scratch[f * SURFACE_LANES + x]: the computed surface, then the numbers of the lane's primitive,
# which `setup_lanes` puts there.

SURFACE_LANES = 32  # 16, 64 and 128 are slower or no faster; a row of a tile is whole scratches

# The first 11 are those of a surface buffer (surface/per_hit.py), in its order; LANE_LOCAL: what `fast_uv` reads;
# LANE_NUMBER: the primitive, within its kind.
LANE_P, LANE_N, LANE_SH_N, LANE_UV, LANE_UNSAFE, LANE_LOCAL, LANE_NUMBER, LANE_SETUP = (
    lane(SURFACE_LANES * field) for field in (0, 3, 6, 9, 11, 12, 15, 16)
)
LANE_FIELDS = 42  # with the largest `surface_setup`, that of triangles
NEXT, NEXT_BUT_ONE = lane(SURFACE_LANES), lane(2 * SURFACE_LANES)

# Which fields of a surface are wanted: each number includes those before it.
NORMALS, SURFACES, SURFACES_WITH_UV = 0, 1, 2


def new_lanes() -> np.ndarray:
    return aligned(LANE_FIELDS * SURFACE_LANES, np.zeros)


@inlined
def lane_count(scratch: Any) -> Any:
    """SURFACE_LANES, but not as a constant, since LLVM would unroll loops of so few steps into scalar code."""
    return lane(len(scratch)) // lane(LANE_FIELDS)


@inlined
def get_lane(scratch: Any, at: Any) -> Vec3:
    """Three fields of a lane."""
    return scratch[at], scratch[at + NEXT], scratch[at + NEXT_BUT_ONE]


@inlined
def put_lane(scratch: Any, at: Any, v: Vec3) -> None:
    scratch[at], scratch[at + NEXT], scratch[at + NEXT_BUT_ONE] = v[0], v[1], v[2]


# Kinds that are images of a unit shape (`center`, `to_world`, `to_object`) have these numbers in a lane.
LANE_CENTER, LANE_TO_OBJECT, LANE_TO_WORLD, LANE_MORE = (
    LANE_SETUP + lane(SURFACE_LANES * field) for field in (0, 3, 12, 21)
)


@inlined
def put_affine_lanes(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    """`surface_setup` for images of a unit shape: the centre and both matrices of primitive k."""
    center = row(prims.center, k)
    for x in range(start, stop):
        put_lane(scratch, LANE_CENTER + x, center)
    put_matrix(scratch, LANE_TO_OBJECT, prims.to_object, k, start, stop)
    put_matrix(scratch, LANE_TO_WORLD, prims.to_world, k, start, stop)


@inlined
def put_matrix(scratch: Any, at: Any, m: Any, k: int, start: Any, stop: Any) -> None:
    """Write the rows of the matrix m[k] to lanes start..stop."""
    for i in range(3):
        v = m[k, i, 0], m[k, i, 1], m[k, i, 2]
        for x in range(start, stop):
            put_lane(scratch, at + lane(3 * i) * NEXT + x, v)


@inlined
def get_matrix(scratch: Any, at: Any) -> tuple[Vec3, Vec3, Vec3]:
    """The rows of a matrix of a lane."""
    return get_lane(scratch, at), get_lane(scratch, at + lane(3) * NEXT), get_lane(scratch, at + lane(6) * NEXT)
