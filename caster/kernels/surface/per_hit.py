"""Surfaces of the hits of a tile, and the loops that write AOVs to images."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import generic_inlined, implement, inlined, jit
from caster.jit.simd import ALL_LANES, LANES
from caster.kernels.math.lanes import lanes_in_range, numbers_in_range
from caster.kernels.math.vec import dot, scaled
from caster.kernels.protocol import Vec3, fast_surface, fast_uv, setup_lanes, surface, surface_setup
from caster.kernels.raster.tile import (
    CACHE_LINE,
    DX,
    LANE_LOCAL,
    LANE_N,
    LANE_NUMBER,
    LANE_P,
    LANE_SH_N,
    LANE_UNSAFE,
    LANE_UV,
    NEXT,
    NORMALS,
    ONE,
    OX,
    PRIM,
    STRIDE,
    SURFACE_LANES,
    SURFACES,
    SURFACES_WITH_UV,
    T_MIN,
    UNCERTAIN,
    WIDTH,
    Box,
    T,
    get,
    get_lane,
    lane,
    lane_count,
    put,
    put_lane,
)


class Hit(NamedTuple):
    """The nearest hit of a ray. An AOV may read o, d, t, start, and the other fields that it lists in NEEDS."""

    o: Vec3
    d: Vec3
    t: float  # in lengths of d
    start: float  # the t from which depth counts: 0 for rays of a film
    position: Vec3  # world space
    normal: Vec3  # geometric, of unit length
    shading_normal: Vec3  # of unit length
    uv: tuple[float, float]
    albedo: Vec3  # diffuse reflectance
    radiance: Vec3  # reflected towards the ray
    shape_id: int
    prim_id: int  # within the shape


RAY_FIELDS = ("o", "d", "t", "start")
NEEDED_FIELDS = tuple(name for name in Hit._fields if name not in RAY_FIELDS)
"""Fields that an AOV may list in NEEDS; they are computed only if some AOV does."""

# Fields of a surface buffer, like those of a tile. SIDES: whether both sides are lit; FLUX: the irradiance of the
# current light.
P, N, SH_N, UV, ALBEDO, SIDES, FLUX, RADIANCE = (lane(STRIDE * field) for field in (0, 3, 6, 9, 11, 14, 15, 18))
SURFACE_FIELDS = 21


class PrimitiveIds(NamedTuple):
    """Ids by the primitive's number in a tile (PRIM); empty if no AOV needs them."""

    shape: np.ndarray  # int32
    prim: np.ndarray  # int32, within the shape


NO_IDS = PrimitiveIds(np.empty(0, np.int32), np.empty(0, np.int32))


SURFACE_SIZE = SURFACE_FIELDS * STRIDE + CACHE_LINE // 8  # numbers of a surface buffer


@inlined
def ray_of(tile: Any, i: Any) -> tuple[Vec3, Vec3]:
    """(o, d) of a pixel."""
    return get(tile, OX + i), get(tile, DX + i)


@jit
def surfaces_in_tile(prims: Any, numbers: Any, tile: Any, box: Box, buffer: Any, scratch: Any, wants: int) -> None:
    """Compute N of the hits on one kind, and if wanted P and SH_N, and UV, SURFACE_LANES pixels at a time.

    numbers: of the kind's primitives in the tile, first and last + 1 (`span`). wants: NORMALS, SURFACES or
    SURFACES_WITH_UV.
    """
    span = float(numbers[0]), float(numbers[1])
    start, stop = (LANE_N, LANE_SH_N) if wants == NORMALS else (LANE_P, LANE_UV if wants == SURFACES else LANE_UNSAFE)
    for y in range(box[3] - box[1]):
        for at in range(0, box[2] - box[0], SURFACE_LANES):
            first = lane(y * WIDTH + at)
            shown = gather_primitives(prims, span, tile, first, scratch, wants)
            if shown == 0:
                continue
            if wants == NORMALS:  # a constant, so that LLVM leaves out the rest
                unsafe = compute_surfaces(prims, span, tile, first, scratch, True)
            else:
                unsafe = compute_surfaces(prims, span, tile, first, scratch, False)
            if wants == SURFACES_WITH_UV:
                compute_uv(prims, scratch)
            if unsafe > 0:
                recompute_unsafe(prims, numbers, tile, first, scratch, wants)
            keep_lanes(span, tile, first, scratch, buffer, (start // NEXT, stop // NEXT), shown == ALL_SHOWN)


@jit
def flip_normals_in_tile(tile: Any, box: Box, flipped: Any, buffer: Any) -> None:
    """Reverse N and SH_N of the hits on primitives that are `flipped`, by the primitive's number in the tile."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            prim = tile[PRIM + i]
            if prim >= 0.0 and flipped[lane(prim)]:
                put(buffer, N + i, scaled(-1.0, get(buffer, N + i)))
                put(buffer, SH_N + i, scaled(-1.0, get(buffer, SH_N + i)))


ALL_SHOWN = (1 << SURFACE_LANES) - 1


@inlined
def gather_primitives(prims: Any, span: Any, tile: Any, first: Any, scratch: Any, wants: int) -> int:
    """Write the numbers that `fast_surface` reads to the lanes that show the kind; returns a bit for each of these."""
    least, end, one = span[0], span[1], tile[PRIM + first]
    shown, alike = 0, ALL_SHOWN
    for group in range(SURFACE_LANES // LANES):
        at = PRIM + first + lane(group * LANES)
        shown |= lanes_in_range(tile, at, least, end) << (group * LANES)
        alike &= lanes_in_range(tile, at, one, one + 1.0) << (group * LANES) | ~(ALL_LANES << (group * LANES))
    if shown == 0:
        return 0
    if alike == ALL_SHOWN:
        surface_setup(prims, int(one - least), lane(0), lane_count(scratch), scratch, wants)
        return shown
    for x in range(lane(0), lane(SURFACE_LANES), lane(LANES)):  # other lanes get the first primitive
        numbers_in_range(tile, PRIM + first + x, least, end, scratch, LANE_NUMBER + x)
    setup_lanes(prims, scratch, wants)
    return shown


@implement(setup_lanes, object)
def _setup_runs(prims: Any, scratch: Any, wants: int) -> None:
    """Set up runs of lanes that show the same primitive."""
    start: Any = lane(0)
    while start < lane(SURFACE_LANES):
        number, end = scratch[LANE_NUMBER + start], start + lane(1)
        while end < lane(SURFACE_LANES) and scratch[LANE_NUMBER + end] == number:
            end += lane(1)
        surface_setup(prims, int(number), start, end, scratch, wants)
        start = end


@inlined
def compute_surfaces(prims: Any, span: Any, tile: Any, first: Any, scratch: Any, normals_only: bool) -> int:
    """Surfaces of all lanes but for uv, or geometric normals only; how many lanes of the kind are not safe."""
    unsafe = 0
    for x in range(lane(SURFACE_LANES)):
        prim, (o, d) = tile[PRIM + first + x], ray_of(tile, first + x)
        mine = (span[0] <= prim) & (prim < span[1])
        t = tile[T + first + x] if mine else 0.0  # that of a miss is infinite
        normal_is_safe, all_is_safe, p, n, sh_n, local = fast_surface(prims, scratch, x, o, d, t)
        put_lane(scratch, LANE_N + x, n)
        if not normals_only:
            put_lane(scratch, LANE_P + x, p)
            put_lane(scratch, LANE_SH_N + x, sh_n)
            put_lane(scratch, LANE_LOCAL + x, local)
        fails = (not (normal_is_safe if normals_only else all_is_safe)) & mine
        scratch[LANE_UNSAFE + x] = 1.0 if fails else 0.0
        unsafe += 1 if fails else 0  # of integers: a sum of floats keeps LLVM from using vectors
    return unsafe


@inlined
def compute_uv(prims: Any, scratch: Any) -> None:
    """uv of all lanes; a flag in the loop above would keep LLVM from using vectors."""
    for x in range(lane(SURFACE_LANES)):
        u, v = fast_uv(prims, scratch, x, get_lane(scratch, LANE_LOCAL + x))
        scratch[LANE_UV + x], scratch[LANE_UV + NEXT + x] = u, v


@inlined
def recompute_unsafe(prims: Any, numbers: Any, tile: Any, first: Any, scratch: Any, wants: int) -> None:
    """Compute the surfaces for which `fast_surface` is not safe."""
    for x in range(lane(SURFACE_LANES)):
        if scratch[LANE_UNSAFE + x] != 0.0:
            i = first + x
            o, d = ray_of(tile, i)
            k = int(tile[PRIM + i]) - numbers[0]
            p, n, sh_n, u, v = surface(prims, k, o, d, tile[T + i], wants == SURFACES_WITH_UV)
            put_lane(scratch, LANE_P + x, p)
            put_lane(scratch, LANE_N + x, n)
            put_lane(scratch, LANE_SH_N + x, sh_n)
            scratch[LANE_UV + x], scratch[LANE_UV + NEXT + x] = u, v


@inlined
def keep_lanes(
    span: Any, tile: Any, first: Any, scratch: Any, buffer: Any, fields: tuple[Any, Any], all_shown: bool
) -> None:
    """Copy a range of fields to the surface buffer, except lanes that show another kind."""
    for field in range(fields[0], fields[1]):
        into, out = lane(STRIDE) * field + first, NEXT * field
        if all_shown:
            for x in range(lane_count(scratch)):
                buffer[into + x] = scratch[out + x]
        else:
            for x in range(lane_count(scratch)):
                prim = tile[PRIM + first + x]
                mine = (span[0] <= prim) & (prim < span[1])
                buffer[into + x] = scratch[out + x] if mine else buffer[into + x]


@inlined
def load_hit(tile: Any, buffer: Any, ids: Any, start: float, i: Any) -> Hit:
    """The hit of pixel i. The compiler leaves out fields that the AOV does not read."""
    o, d = ray_of(tile, i)
    k = int(tile[PRIM + i])
    # Variables, because Numba unifies their types, but not those of two return statements, which CPython 3.12 makes of
    # a conditional expression inside of one.
    shape = int(ids.shape[k]) if len(ids.shape) > 0 else -1
    prim = int(ids.prim[k]) if len(ids.prim) > 0 else -1
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
        shape,
        prim,
    )


@generic_inlined
def per_hit(aov: Any, hit: Any) -> Any:
    """The value of an AOV at a hit: a number, or a tuple with one for each channel.

    aov: the kernel argument that `caster.aovs.register` made; `aov.miss` is the value on a miss, `aov.misses` that of
    each channel.
    """


@inlined
def store_channels(image: Any, y: Any, x: Any, value: Any) -> None:
    numbers, n = image.flat, (lane(y) * lane(image.shape[1]) + lane(x)) * lane(len(value))
    if len(value) == 3:  # unrolled, so that LLVM writes several pixels at once
        numbers[n], numbers[n + lane(1)], numbers[n + lane(2)] = value[0], value[1], value[2]
    else:
        for c in range(len(value)):
            numbers[n + lane(c)] = value[c]


@inlined
def store_pixel(aov: Any, tile: Any, buffer: Any, ids: Any, start: float, i: Any, image: Any, y: Any, x: Any) -> None:
    """Write the AOV of pixel i of a tile to y, x of the image."""
    inside, hit = tile[PRIM + i] >= 0.0, load_hit(tile, buffer, ids, start, i)
    # compiled without a branch, so that several pixels are written at once
    if image.ndim == 2:
        image[y, x] = per_hit(aov, hit) if inside else aov.miss
    else:
        store_channels(image, y, x, per_hit(aov, hit) if inside else aov.misses)


@jit
def write_aov(aov: Any, tile: Any, box: Box, buffer: Any, ids: Any, from_t_min: bool, image: Any) -> None:
    """Write an AOV to the pixels of a box: its per-hit kernel at hits, its miss value elsewhere.

    image: (h, w) or (h, w, c) of the whole window. from_t_min: whether depth counts from T_MIN; else from 0.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first = lane((y - y0) * WIDTH)
        for x in range(lane(x1 - x0)):
            start = tile[T_MIN + first + x] if from_t_min else 0.0
            store_pixel(aov, tile, buffer, ids, start, first + x, image, y, lane(x0) + x)


@jit
def store_hits(tile: Any, box: Box, hit: Any, uncertain: Any) -> None:
    """Write whether each pixel of a box hits anything, and whether it has to be decided exactly."""
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first, count = lane((y - y0) * WIDTH), lane(x1 - x0)
        for x in range(count):
            hit[y, lane(x0) + x] = tile[PRIM + first + x] >= 0.0
            uncertain[y, lane(x0) + x] = tile[UNCERTAIN + first + x] != 0.0


@inlined
def length(v: Vec3) -> float:
    """The Euclidean length."""
    return math.sqrt(dot(v, v))
