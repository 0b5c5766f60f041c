"""From the hits of a tile to their surfaces, and to what they send back of each light."""

import math
from typing import Any

import numpy as np

from caster.kernels.jit import inlined, jit
from caster.kernels.light import arriving, shadow_ray
from caster.kernels.protocol import Vec3, surface
from caster.kernels.tile import (
    CACHE_LINE,
    DOUBT,
    DX,
    DY,
    DZ,
    OX,
    OY,
    OZ,
    PLACE,
    STRIDE,
    T_MAX,
    WIDTH,
    Box,
    T,
    lane,
    put_none,
    put_ray,
)

# Fields like those of a tile: position, normals, uv, reflectance, whether both sides are lit, what arrives from the
# light at hand, and the radiance of all lights so far.
P, N, SH_N, UV, ALBEDO, SIDES, FLUX, RADIANCE = (
    lane(STRIDE * field) for field in (0, 3, 6, 9, 11, 14, 15, 18)
)
SHADE_FIELDS = 21
ONE, TWO = lane(STRIDE), lane(2 * STRIDE)


def new_shade() -> np.ndarray:
    return np.zeros(SHADE_FIELDS * STRIDE + CACHE_LINE // 8)


@inlined
def get(shade: Any, at: Any) -> Vec3:
    """Three fields of a pixel."""
    return shade[at], shade[at + ONE], shade[at + TWO]


@inlined
def put(shade: Any, at: Any, v: Vec3) -> None:
    shade[at], shade[at + ONE], shade[at + TWO] = v[0], v[1], v[2]


@inlined
def ray_of(tile: Any, i: Any) -> tuple[Vec3, Vec3]:
    """(o, d) of a pixel."""
    return (tile[OX + i], tile[OY + i], tile[OZ + i]), (tile[DX + i], tile[DY + i], tile[DZ + i])


@jit
def find_surfaces_in_tile(prims: Any, places: Any, tile: Any, box: Box, shade: Any, wants_uv: bool) -> None:
    """P, N, SH_N and UV of the hits on one kind, whose places are places[0] to places[1]."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            place = int(tile[PLACE + i])
            if places[0] <= place < places[1]:
                o, d = ray_of(tile, i)
                p, n, sh_n, u, v = surface(prims, place - places[0], o, d, tile[T + i], wants_uv)
                put(shade, P + i, p)
                put(shade, N + i, n)
                put(shade, SH_N + i, sh_n)
                shade[UV + i], shade[UV + i + ONE] = u, v


@jit
def find_materials(tile: Any, box: Box, shapes: Any, reflectance: Any, two_sided: Any, shade: Any) -> None:
    """ALBEDO and SIDES of the hits, from tables by shape; shapes[place] is a primitive's. And no RADIANCE yet."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            place = int(tile[PLACE + i])
            if place >= 0:
                shape = shapes[place]
                put(shade, ALBEDO + i, (reflectance[shape, 0], reflectance[shape, 1], reflectance[shape, 2]))
                shade[SIDES + i] = two_sided[shape]
                put(shade, RADIANCE + i, (0.0, 0.0, 0.0))


@jit
def aim_at_light(light: Any, tile: Any, box: Box, shade: Any, beam: Any) -> int:
    """Begin the tile `beam`: a ray to the light from each hit that faces it; how many.

    FLUX: what arrives if nothing is in between.
    """
    width, count = box[2] - box[0], 0
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + width)):
            seen = False
            if tile[PLACE + i] >= 0.0:
                o, d = ray_of(tile, i)
                p = get(shade, P + i)
                seen, flux = arriving(light, p, get(shade, SH_N + i), d, shade[SIDES + i] != 0.0)
                if seen:
                    put(shade, FLUX + i, flux)
                    put_ray(beam, i, shadow_ray(light, p, get(shade, N + i), o, d, tile[T + i]))
                    count += 1
            if not seen:
                put_ray(beam, i, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, -1.0))
        put_none(beam, y * WIDTH + width, (y + 1) * WIDTH)
    return count


@jit
def add_light(tile: Any, box: Box, shade: Any, beam: Any) -> None:
    """RADIANCE of what is lit, once the beam has been cast; doubt where it may be in a shadow."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            if beam[T_MAX + i] >= 0.0 and beam[T + i] == math.inf:
                albedo, flux, sum_ = get(shade, ALBEDO + i), get(shade, FLUX + i), get(shade, RADIANCE + i)
                r, g, b = (
                    albedo[0] / math.pi * flux[0],
                    albedo[1] / math.pi * flux[1],
                    albedo[2] / math.pi * flux[2],
                )
                put(shade, RADIANCE + i, (sum_[0] + r, sum_[1] + g, sum_[2] + b))
                if beam[DOUBT + i] != 0.0:
                    tile[DOUBT + i] = 1.0


@jit
def add_ambient(tile: Any, box: Box, shade: Any, ambient: Any) -> None:
    """RADIANCE of what comes evenly from everywhere; ambient: (k, 3) radiances."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            if tile[PLACE + i] >= 0.0:
                for c in range(3):
                    field, sum_ = lane(c) * ONE + i, 0.0
                    for k in range(len(ambient)):
                        sum_ += shade[ALBEDO + field] * ambient[k, c]
                    shade[RADIANCE + field] += sum_


@jit
def paint_fields(tile: Any, box: Box, shade: Any, first: Any, image: Any) -> None:
    """The fields from `first` on, as many as the image has channels; 0 on a miss."""
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x1 - x0):
            i = lane((y - y0) * WIDTH + x)
            there = tile[PLACE + i] >= 0.0
            for c in range(image.shape[2]):
                image[y, x0 + x, c] = shade[lane(first) + lane(c) * ONE + i] if there else 0.0
