"""Reflectances of textures at the hits of a tile."""

from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import jit
from caster.kernels.math.vec import add, dot, row, scaled, sub
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import ONE, PRIM, WIDTH, Box, get, lane, put
from caster.kernels.surface.per_hit import ALBEDO, UV, P

NO_TEXTURE, NEAREST, BILINEAR, OF_MESH = range(4)
REPEAT, MIRROR, CLAMP = range(3)
ROWS_PER_FACE = 5  # of colours of a mesh: a corner, its colour, the gradients of red, green and blue


class Textures(NamedTuple):
    """The textures of all shapes."""

    settings: np.ndarray  # (shapes, 5) int64: filter, wrap, width, height, the first texel or row of primitive 0
    to_texels: np.ndarray  # (shapes, 2, 3) float64: maps (u, v, 1) to columns and lines
    texels: np.ndarray  # (n, 3) float64, row by row; ROWS_PER_FACE rows a face for colours of a mesh


@jit
def textures_in_tile(tile: Any, box: Box, shapes: Any, textures: Any, buffer: Any) -> None:
    """Write ALBEDO of the hits on shapes with a texture, from UV or P; shapes[prim]: the shape of a primitive."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            if tile[PRIM + i] >= 0.0:
                prim = lane(tile[PRIM + i])
                k = shapes[prim]
                how = textures.settings[k]
                if how[0] == OF_MESH:
                    first = how[4] + ROWS_PER_FACE * prim
                    put(buffer, ALBEDO + i, color_on_face(textures.texels, first, get(buffer, P + i)))
                elif how[0] != NO_TEXTURE:
                    put(buffer, ALBEDO + i, color_at(textures, k, buffer[UV + i], buffer[UV + i + ONE]))


@jit
def color_on_face(rows: Any, first: int, p: Vec3) -> Vec3:
    """The colour of a mesh at p, linear on the face whose rows begin at `first`."""
    x = sub(p, row(rows, first))
    change = dot(row(rows, first + 2), x), dot(row(rows, first + 3), x), dot(row(rows, first + 4), x)
    return add(row(rows, first + 1), change)


@jit
def color_at(textures: Any, k: int, u: float, v: float) -> Vec3:
    """The reflectance at uv of the surface: a texel, or a blend of four by the distances from their centres."""
    m, blends = textures.to_texels[k], textures.settings[k, 0] == BILINEAR
    x, y = m[0, 0] * u + m[0, 1] * v + m[0, 2], m[1, 0] * u + m[1, 1] * v + m[1, 2]
    left, top = np.floor(x), np.floor(y)
    a, b = x - left if blends else 0.0, y - top if blends else 0.0
    upper = blended(a, texel(textures, k, left, top), texel(textures, k, left + 1.0, top))
    lower = blended(a, texel(textures, k, left, top + 1.0), texel(textures, k, left + 1.0, top + 1.0))
    return blended(b, upper, lower)


@jit
def blended(share: float, first: Vec3, second: Vec3) -> Vec3:
    """A mean of which `share` is the second."""
    return add(scaled(1.0 - share, first), scaled(share, second))


@jit
def texel(textures: Any, k: int, column: float, line: float) -> Vec3:
    """The texel of a column and line, whole numbers that may lie beyond the picture."""
    how = textures.settings[k]
    return row(textures.texels, how[4] + wrapped(line, how[3], how[1]) * how[2] + wrapped(column, how[2], how[1]))


@jit
def wrapped(i: float, count: int, wrap: int) -> int:
    """The number of the texel in place of the whole number i, among `count`; 0 for NaN."""
    if wrap != CLAMP:
        period = 2.0 * count if wrap == MIRROR else 1.0 * count
        i -= period * np.floor(i / period)
    if wrap == MIRROR and i >= count:
        i = 2.0 * count - 1.0 - i
    i = min(max(i, 0.0), count - 1.0)
    return int(i) if i >= 0.0 else 0
