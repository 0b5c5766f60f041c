"""Reflectances of textures at the hits of a tile."""

from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import jit
from caster.kernels.math.vec import add, row, scaled
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import ONE, PRIM, WIDTH, Box, lane, put
from caster.kernels.surface.per_hit import ALBEDO, UV

NO_TEXTURE, CHECKERBOARD, NEAREST, BILINEAR = range(4)
REPEAT, MIRROR, CLAMP = range(3)


class Textures(NamedTuple):
    """The textures of all shapes."""

    settings: np.ndarray  # (shapes, 5) int64: filter, wrap, width, height, the first texel
    to_uv: np.ndarray  # (shapes, 2, 3) float64
    texels: np.ndarray  # (n, 3) float64, row by row


@jit
def textures_in_tile(tile: Any, box: Box, shapes: Any, textures: Any, buffer: Any) -> None:
    """Write ALBEDO of the hits on shapes with a texture, from their UV; shapes[prim]: the shape of a primitive."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            if tile[PRIM + i] >= 0.0:
                k = shapes[lane(tile[PRIM + i])]
                if textures.settings[k, 0] != NO_TEXTURE:
                    put(buffer, ALBEDO + i, color_at(textures, k, buffer[UV + i], buffer[UV + i + ONE]))


@jit
def color_at(textures: Any, k: int, u: float, v: float) -> Vec3:
    """The reflectance at uv of the surface."""
    m, how = textures.to_uv[k], textures.settings[k, 0]
    x, y = m[0, 0] * u + m[0, 1] * v + m[0, 2], m[1, 0] * u + m[1, 1] * v + m[1, 2]
    if how == CHECKERBOARD:
        differ = (x - np.floor(x) > 0.5) != (y - np.floor(y) > 0.5)
        return texel(textures, k, 1.0 if differ else 0.0, 0.0)
    x, y = x * textures.settings[k, 2], y * textures.settings[k, 3]
    if how == NEAREST:
        return texel(textures, k, np.floor(x), np.floor(y))
    x, y = x - 0.5, y - 0.5  # texels have their values at their centres
    left, top = np.floor(x), np.floor(y)
    a, b = x - left, y - top
    upper = add(scaled(1.0 - a, texel(textures, k, left, top)), scaled(a, texel(textures, k, left + 1.0, top)))
    lower = add(
        scaled(1.0 - a, texel(textures, k, left, top + 1.0)), scaled(a, texel(textures, k, left + 1.0, top + 1.0))
    )
    return add(scaled(1.0 - b, upper), scaled(b, lower))


@jit
def texel(textures: Any, k: int, column: float, line: float) -> Vec3:
    """The texel of a column and line, whole numbers that may lie beyond the picture."""
    how, width, height = textures.settings[k, 1], textures.settings[k, 2], textures.settings[k, 3]
    place = wrapped(line, height, how) * width + wrapped(column, width, how)
    return row(textures.texels, textures.settings[k, 4] + place)


@jit
def wrapped(i: float, count: int, how: int) -> int:
    """The number of the texel in place of the whole number i, among `count`; 0 for NaN."""
    if how != CLAMP:
        period = float(2 * count if how == MIRROR else count)
        i -= period * np.floor(i / period)
    if how == MIRROR and i >= count:
        i = 2.0 * count - 1.0 - i
    i = min(max(i, 0.0), count - 1.0)
    return int(i) if i >= 0.0 else 0
