"""Hits of a tile as the per-hit kernels of AOVs read them, and the loops that write AOVs to images."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import generic_inlined, implement, inlined, jit
from caster.jit.simd import ALL_LANES, LANES, lanes_in_range, numbers_in_range
from caster.kernels.protocol import Vec3, fast_surface, fast_uv, setup_lanes, surface, surface_setup
from caster.kernels.raster.tile import (
    CACHE_LINE,
    DX,
    DY,
    DZ,
    LANE_LOCAL,
    LANE_N,
    LANE_NUMBER,
    LANE_P,
    LANE_SH_N,
    LANE_UNSAFE,
    LANE_UV,
    NEXT,
    OX,
    OY,
    OZ,
    PRIM,
    STRIDE,
    SURFACE_LANES,
    UNCERTAIN,
    WIDTH,
    Box,
    T,
    get_lane,
    lane,
    lane_count,
    put_lane,
)


class Hit(NamedTuple):
    """The nearest hit of one ray. An AOV may read o, d, t, start, and those of the others that it lists in NEEDS."""

    o: Vec3
    d: Vec3
    t: float  # in lengths of d
    start: float  # depth counts from here, beyond o: 0 for rays of a film
    position: Vec3  # world space
    normal: Vec3  # geometric, of unit length
    shading_normal: Vec3  # of unit length
    uv: tuple[float, float]
    albedo: Vec3  # diffuse reflectance
    radiance: Vec3  # reflected towards the ray
    shape_id: int
    prim_id: int  # within the shape


UNKNOWN = (0.0, 0.0, 0.0)  # fields that the AOV does not need

RAY_FIELDS = ("o", "d", "t", "start")
NEEDED_FIELDS = tuple(name for name in Hit._fields if name not in RAY_FIELDS)
"""What an AOV may list in NEEDS: it is computed for a render only if some AOV lists it."""

# Fields of a surface buffer, like those of a tile; SIDES: whether both sides are lit, FLUX: what arrives from the light
# at hand.
P, N, SH_N, UV, ALBEDO, SIDES, FLUX, RADIANCE = (lane(STRIDE * field) for field in (0, 3, 6, 9, 11, 14, 15, 18))
SURFACE_FIELDS = 21
ONE, TWO = lane(STRIDE), lane(2 * STRIDE)


class PrimitiveIds(NamedTuple):
    """By the primitive's number in a tile (PRIM); without members where no AOV needs them."""

    shape: np.ndarray  # int32
    prim: np.ndarray  # int32, within the shape


NO_IDS = PrimitiveIds(np.empty(0, np.int32), np.empty(0, np.int32))


def new_surface_buffer() -> np.ndarray:
    return np.zeros(SURFACE_FIELDS * STRIDE + CACHE_LINE // 8)


@inlined
def get(buffer: Any, at: Any) -> Vec3:
    """Three fields of a pixel."""
    return buffer[at], buffer[at + ONE], buffer[at + TWO]


@inlined
def put(buffer: Any, at: Any, v: Vec3) -> None:
    buffer[at], buffer[at + ONE], buffer[at + TWO] = v[0], v[1], v[2]


@inlined
def ray_of(tile: Any, i: Any) -> tuple[Vec3, Vec3]:
    """(o, d) of a pixel."""
    return (tile[OX + i], tile[OY + i], tile[OZ + i]), (tile[DX + i], tile[DY + i], tile[DZ + i])


@jit
def surfaces_in_tile(prims: Any, numbers: Any, tile: Any, box: Box, buffer: Any, wants_uv: bool) -> None:
    """P, N, SH_N and UV of the hits on one kind; its primitives are numbers[0] to numbers[1] in the tile."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            prim = int(tile[PRIM + i])
            if numbers[0] <= prim < numbers[1]:
                o, d = ray_of(tile, i)
                p, n, sh_n, u, v = surface(prims, prim - numbers[0], o, d, tile[T + i], wants_uv)
                put(buffer, P + i, p)
                put(buffer, N + i, n)
                put(buffer, SH_N + i, sh_n)
                buffer[UV + i], buffer[UV + i + ONE] = u, v


@jit
def surfaces_in_tile_by_lanes(
    prims: Any, numbers: Any, tile: Any, box: Box, buffer: Any, scratch: Any, wants_uv: bool
) -> None:
    """`surfaces_in_tile` of a kind with a body for `fast_surface`: SURFACE_LANES pixels at a time."""
    for y in range(box[3] - box[1]):
        for at in range(0, box[2] - box[0], SURFACE_LANES):
            first = lane(y * WIDTH + at)
            shown = gather_primitives(prims, numbers, tile, first, scratch, wants_uv)
            if shown == 0:
                continue
            unsafe = compute_lanes(prims, numbers, tile, first, scratch)
            if wants_uv:
                compute_uv(prims, scratch)
            if unsafe > 0:
                recompute_unsafe(prims, numbers, tile, first, scratch, wants_uv)
            stop = LANE_UNSAFE if wants_uv else LANE_UV
            if shown == ALL_SHOWN:
                keep_all_lanes(first, scratch, buffer, stop)
            else:
                keep_lanes(numbers, tile, first, scratch, buffer, stop)


ALL_SHOWN = (1 << SURFACE_LANES) - 1


@inlined
def gather_primitives(prims: Any, numbers: Any, tile: Any, first: Any, scratch: Any, wants_uv: bool) -> int:
    """What `fast_surface` reads, for the lanes that show the kind; a bit for each of these."""
    least, end, one = float(numbers[0]), float(numbers[1]), tile[PRIM + first]
    shown, alike = 0, ALL_SHOWN
    for group in range(SURFACE_LANES // LANES):
        at = PRIM + first + lane(group * LANES)
        shown |= lanes_in_range(tile, at, least, end) << (group * LANES)
        alike &= lanes_in_range(tile, at, one, one + 1.0) << (group * LANES) | ~(ALL_LANES << (group * LANES))
    if shown == 0:
        return 0
    if alike == ALL_SHOWN:
        surface_setup(prims, int(one) - numbers[0], lane(0), lane_count(scratch), scratch, wants_uv)
        return shown
    for x in range(lane(0), lane(SURFACE_LANES), lane(LANES)):  # other lanes get any primitive, the first
        numbers_in_range(tile, PRIM + first + x, least, end, scratch, LANE_NUMBER + x)
    setup_lanes(prims, scratch, wants_uv)
    return shown


@implement(setup_lanes, object)
def _setup_runs(prims: Any, scratch: Any, wants_uv: bool) -> None:
    """Run by run of lanes with one primitive."""
    start: Any = lane(0)
    while start < lane(SURFACE_LANES):
        number, end = scratch[LANE_NUMBER + start], start + lane(1)
        while end < lane(SURFACE_LANES) and scratch[LANE_NUMBER + end] == number:
            end += lane(1)
        surface_setup(prims, int(number), start, end, scratch, wants_uv)
        start = end


@inlined
def compute_lanes(prims: Any, numbers: Any, tile: Any, first: Any, scratch: Any) -> int:
    """Surfaces of all lanes but for uv, whatever they show; how many of the kind are not safe."""
    unsafe, least, most = 0, float(numbers[0]), float(numbers[1])
    for x in range(lane(SURFACE_LANES)):
        prim, (o, d) = tile[PRIM + first + x], ray_of(tile, first + x)
        mine = (least <= prim) & (prim < most)
        t = tile[T + first + x] if mine else 0.0  # that of a miss is infinite
        safe, p, n, sh_n, local = fast_surface(prims, scratch, x, o, d, t)
        put_lane(scratch, LANE_P + x, p)
        put_lane(scratch, LANE_N + x, n)
        put_lane(scratch, LANE_SH_N + x, sh_n)
        put_lane(scratch, LANE_LOCAL + x, local)
        fails = (not safe) & mine
        scratch[LANE_UNSAFE + x] = 1.0 if fails else 0.0
        unsafe += 1 if fails else 0  # of integers: a sum of floats keeps LLVM from using vectors
    return unsafe


@inlined
def compute_uv(prims: Any, scratch: Any) -> None:
    """uv of all lanes; in the loop above, a flag would keep LLVM from using vectors."""
    for x in range(lane(SURFACE_LANES)):
        u, v = fast_uv(prims, scratch, x, get_lane(scratch, LANE_LOCAL + x))
        scratch[LANE_UV + x], scratch[LANE_UV + NEXT + x] = u, v


@inlined
def recompute_unsafe(prims: Any, numbers: Any, tile: Any, first: Any, scratch: Any, wants_uv: bool) -> None:
    """Surfaces that `fast_surface` leaves open."""
    for x in range(lane(SURFACE_LANES)):
        if scratch[LANE_UNSAFE + x] != 0.0:
            i = first + x
            o, d = ray_of(tile, i)
            k = int(tile[PRIM + i]) - numbers[0]
            p, n, sh_n, u, v = surface(prims, k, o, d, tile[T + i], wants_uv)
            put_lane(scratch, LANE_P + x, p)
            put_lane(scratch, LANE_N + x, n)
            put_lane(scratch, LANE_SH_N + x, sh_n)
            scratch[LANE_UV + x], scratch[LANE_UV + NEXT + x] = u, v


@inlined
def keep_lanes(numbers: Any, tile: Any, first: Any, scratch: Any, buffer: Any, stop: Any) -> None:
    """The fields before `stop` into the surface buffer, but for lanes that show another kind."""
    least, most = float(numbers[0]), float(numbers[1])
    for field in range(stop // NEXT):
        into, out = lane(STRIDE) * field + first, NEXT * field
        for x in range(lane_count(scratch)):
            prim = tile[PRIM + first + x]
            mine = (least <= prim) & (prim < most)
            buffer[into + x] = scratch[out + x] if mine else buffer[into + x]


@inlined
def keep_all_lanes(first: Any, scratch: Any, buffer: Any, stop: Any) -> None:
    """The same where all lanes show the kind."""
    for field in range(stop // NEXT):
        into, out = lane(STRIDE) * field + first, NEXT * field
        for x in range(lane_count(scratch)):
            buffer[into + x] = scratch[out + x]


@inlined
def load_hit(tile: Any, buffer: Any, ids: Any, start: float, i: Any) -> Hit:
    """The hit of pixel i. What its AOV does not read costs nothing once compiled."""
    o, d = ray_of(tile, i)
    k = int(tile[PRIM + i])
    return Hit(
        o,
        d,
        tile[T + i],
        start,
        get(buffer, P + i),
        get(buffer, N + i),
        get(buffer, SH_N + i),
        (buffer[UV + i], buffer[UV + i + ONE]),
        get(buffer, ALBEDO + i),
        get(buffer, RADIANCE + i),
        int(ids.shape[k]) if len(ids.shape) > 0 else -1,
        int(ids.prim[k]) if len(ids.prim) > 0 else -1,
    )


@generic_inlined
def per_hit(aov: Any, hit: Any) -> Any:
    """The value of an AOV at a hit: a number, or a tuple with one for each channel.

    aov: what `caster.aovs.register` made for it; `aov.miss` is the value where nothing is hit, `aov.misses` that of
    each channel.
    """


@inlined
def store_value(image: Any, y: Any, x: Any, value: Any) -> None:
    if image.ndim == 2:
        image[y, x] = value
        return
    numbers, n = image.flat, (lane(y) * lane(image.shape[1]) + lane(x)) * lane(len(value))
    if len(value) == 3:  # vectors and pairs are written out: several pixels at a time once compiled
        numbers[n], numbers[n + lane(1)], numbers[n + lane(2)] = value[0], value[1], value[2]
    elif len(value) == 2:
        numbers[n], numbers[n + lane(1)] = value[0], value[1]
    else:
        for c in range(len(value)):
            numbers[n + lane(c)] = value[c]


@inlined
def store_misses(image: Any, y: Any, start: Any, stop: Any, miss: Any) -> None:
    """Pixels start..stop of a row: numbers one after the other, whatever the channels, so that several are written."""
    if image.size == 0:
        return
    if image.ndim == 2:
        for x in range(lane(start), lane(stop)):
            image[y, x] = miss
    else:
        channels, numbers = lane(image.shape[2]), image.flat
        row = lane(y) * lane(image.shape[1]) * channels
        for n in range(row + lane(start) * channels, row + lane(stop) * channels):
            numbers[n] = miss


@inlined
def store_pixel(aov: Any, tile: Any, buffer: Any, ids: Any, start: float, i: Any, image: Any, y: Any, x: Any) -> None:
    """The AOV of pixel i of the tile, at y, x of the image."""
    inside, hit = tile[PRIM + i] >= 0.0, load_hit(tile, buffer, ids, start, i)
    # without a branch once compiled, so that several pixels are written at once
    if image.ndim == 2:
        image[y, x] = per_hit(aov, hit) if inside else aov.miss
    else:
        store_value(image, y, x, per_hit(aov, hit) if inside else aov.misses)


@jit
def write_aov(aov: Any, tile: Any, box: Box, buffer: Any, ids: Any, start: Any, image: Any) -> None:
    """An AOV in the pixels of a box: its per-hit kernel where something is hit, its miss value elsewhere.

    image: (h, w) or (h, w, c) of the whole window. start: (h, w), or without members for 0 everywhere.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first = lane((y - y0) * WIDTH)
        if start.size > 0:
            for x in range(lane(x1 - x0)):
                begin = start[y, lane(x0) + x]
                store_pixel(aov, tile, buffer, ids, begin, first + x, image, y, lane(x0) + x)
        else:
            for x in range(lane(x1 - x0)):
                store_pixel(aov, tile, buffer, ids, 0.0, first + x, image, y, lane(x0) + x)


@jit
def aovs_in_tile_by_lanes(prims: Any, numbers: Any, tile: Any, box: Box, scratch: Any, misses: bool, out: Any) -> None:
    """AOVs that need one field of the surface each, of hits on one kind with a body for `fast_surface`.

    out: for position, normal and shading normal an AOV and its image; without size: not written. misses: whether to
    write the pixels of all else as misses; other kinds have to follow.
    """
    (position, p_image), (normal, n_image), (shading_normal, sh_n_image) = out
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for at in range(0, x1 - x0, SURFACE_LANES):
            first, count = lane((y - y0) * WIDTH + at), min(SURFACE_LANES, x1 - x0 - at)
            if gather_primitives(prims, numbers, tile, first, scratch, False) != 0:
                if compute_lanes(prims, numbers, tile, first, scratch) > 0:
                    recompute_unsafe(prims, numbers, tile, first, scratch, False)
                run = y, x0 + at, count, misses
                store_lanes(position, numbers, tile, first, scratch, p_image, run)
                store_lanes(normal, numbers, tile, first, scratch, n_image, run)
                store_lanes(shading_normal, numbers, tile, first, scratch, sh_n_image, run)
            elif misses:
                store_misses(p_image, y, x0 + at, x0 + at + count, position.miss)
                store_misses(n_image, y, x0 + at, x0 + at + count, normal.miss)
                store_misses(sh_n_image, y, x0 + at, x0 + at + count, shading_normal.miss)


@jit
def aovs_in_tile(prims: Any, numbers: Any, tile: Any, box: Box, misses: bool, out: Any) -> None:
    """The same of any kind, pixel by pixel."""
    (position, p_image), (normal, n_image), (shading_normal, sh_n_image) = out
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x0, x1):
            i = lane((y - y0) * WIDTH + x - x0)
            prim = int(tile[PRIM + i])
            if numbers[0] <= prim < numbers[1]:
                o, d = ray_of(tile, i)
                p, n, sh_n, _, _ = surface(prims, prim - numbers[0], o, d, tile[T + i], False)
                hit = Hit(o, d, tile[T + i], 0.0, p, n, sh_n, (0.0, 0.0), UNKNOWN, UNKNOWN, -1, -1)
                if p_image.size > 0:
                    store_value(p_image, y, x, per_hit(position, hit))
                if n_image.size > 0:
                    store_value(n_image, y, x, per_hit(normal, hit))
                if sh_n_image.size > 0:
                    store_value(sh_n_image, y, x, per_hit(shading_normal, hit))
            elif misses:
                store_misses(p_image, y, x, x + 1, position.miss)
                store_misses(n_image, y, x, x + 1, normal.miss)
                store_misses(sh_n_image, y, x, x + 1, shading_normal.miss)


@inlined
def store_lanes(aov: Any, numbers: Any, tile: Any, first: Any, scratch: Any, image: Any, run: Any) -> None:
    """An AOV of lanes that show the kind. run: row and column of the first, how many, whether to write misses."""
    y, x0, count, misses = run
    if image.size == 0:
        return
    least, most = float(numbers[0]), float(numbers[1])
    if misses:
        for x in range(lane(count)):
            prim = tile[PRIM + first + x]
            value = per_hit(aov, hit_of_lane(tile, first, scratch, x))
            if image.ndim == 2:
                image[y, lane(x0) + x] = value if (least <= prim) & (prim < most) else aov.miss
            else:
                store_value(image, y, lane(x0) + x, value if (least <= prim) & (prim < most) else aov.misses)
    else:
        for x in range(lane(count)):
            prim = tile[PRIM + first + x]
            if (least <= prim) & (prim < most):
                store_value(image, y, lane(x0) + x, per_hit(aov, hit_of_lane(tile, first, scratch, x)))


@inlined
def hit_of_lane(tile: Any, first: Any, scratch: Any, x: Any) -> Hit:
    """The hit of a lane, with its ray, position and normals alone."""
    o, d = ray_of(tile, first + x)
    p, n, sh_n = (get_lane(scratch, LANE_P + x), get_lane(scratch, LANE_N + x), get_lane(scratch, LANE_SH_N + x))
    return Hit(o, d, tile[T + first + x], 0.0, p, n, sh_n, (0.0, 0.0), UNKNOWN, UNKNOWN, -1, -1)


@jit
def fill_miss(aov: Any, box: Box, image: Any) -> None:
    """The same where no ray of a box hits anything."""
    for y in range(box[1], box[3]):
        store_misses(image, y, box[0], box[2], aov.miss)


@jit
def store_hits(tile: Any, box: Box, hit: Any, uncertain: Any) -> None:
    """Whether each pixel of a box hits anything, and whether that has to be decided exactly.

    uncertain: false everywhere before.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first, count = lane((y - y0) * WIDTH), lane(x1 - x0)
        any_uncertain = 0  # a whole number: of floats, the order of a sum keeps LLVM from using vectors
        for x in range(count):
            hit[y, lane(x0) + x] = tile[PRIM + first + x] >= 0.0
            any_uncertain += 1 if tile[UNCERTAIN + first + x] != 0.0 else 0
        if any_uncertain > 0:
            for x in range(count):
                uncertain[y, lane(x0) + x] = tile[UNCERTAIN + first + x] != 0.0


@inlined
def length(v: Vec3) -> float:
    """Euclidean."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
