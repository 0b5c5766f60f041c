"""Colours of textures at uv in float64, and what errors of uv make of them (docs/method.md, "Textures").

An independent implementation: pictures are decoded and looked up again.
"""

import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import Image

from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.intersections import largest_of_columns, without_float_warnings
from mitsuba_ref.error_model.tolerances import KU, SRGB_DECODING_ROUNDINGS, U32


@without_float_warnings
def color_ratios(
    textures: Sequence[Any], shape: np.ndarray, uv: np.ndarray, colors: np.ndarray, ku: float
) -> np.ndarray:
    """(n,) error over bound of reflectances (n, 3) that one side computed at its own uv (n, 2); 0 without a texture."""
    ratios = np.zeros(len(shape))
    for k, texture in enumerate(textures):
        rows = np.flatnonzero(shape == k) if texture is not None else ()
        if len(rows):
            ratios[rows] = _ratio(texture, uv[rows], colors[rows], ku)
    return ratios


def _ratio(texture: Any, uv: np.ndarray, colors: np.ndarray, ku: float) -> np.ndarray:
    """As color_ratios; formulas (24) to (26)."""
    texels = texels_of(texture)
    size = np.array(texels.shape[1::-1])
    blends = getattr(texture, "filter", "") == "bilinear"
    linear, move = texture.uv_matrix[:, :2], texture.uv_matrix[:, 2]
    place = (uv @ linear.T + move) * size  # in texels from the corner of the picture
    off = 3.0 * ku * (np.abs(uv) @ np.abs(linear).T + np.abs(move)) * size
    low, high = place - off, place + off
    bend = np.clip(np.floor(place) + 0.5, low, high) if blends else place  # where the slope may change
    values = np.array(
        [_lookup(texture, texels, x[:, 0], y[:, 1]) for x in (low, bend, high) for y in (low, bend, high)]
    )
    exact = _lookup(texture, texels, place[:, 0], place[:, 1])
    decoding = SRGB_DECODING_ROUNDINGS * U32 if ku == KU and texture.type == "bitmap" and not texture.raw else 0.0
    rounding = (3.0 * ku + decoding) * values
    change = np.abs(values - exact).max(axis=0) if blends else np.zeros_like(exact)
    change[(off >= 0.5).any(axis=1)] = np.ptp(texels, axis=(0, 1))  # any texel may be meant
    ratio = largest_of_columns(error_over_bound(np.abs(colors - exact), change + rounding.max(axis=0)))
    return ratio if blends else np.minimum(ratio, _nearest_ratio(colors, values, rounding))


def _nearest_ratio(colors: np.ndarray, values: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """(m,) smallest error over bound among the colours (9, m, 3) of the cells that may be meant."""
    each = [largest_of_columns(error_over_bound(np.abs(colors - v), r)) for v, r in zip(values, rounding, strict=True)]
    found: np.ndarray = np.min(each, axis=0)
    return found


def texels_of(texture: Any) -> np.ndarray:
    """(h, w, 3) linear reflectances."""
    if texture.type == "checkerboard":
        return np.array([[texture.color0, texture.color1], [texture.color1, texture.color0]])
    if texture.file is None:
        return np.asarray(texture.data)
    return _decoded(texture.file, texture.raw, os.stat(texture.file).st_mtime_ns)


@lru_cache(maxsize=4)
def _decoded(file: str, raw: bool, _changed: int) -> np.ndarray:
    """The texels of a PNG file, decoded from sRGB unless raw (IEC 61966-2-1)."""
    with Image.open(file) as image:
        encoded = np.asarray(image.convert("RGB")) / 255.0
    low = encoded <= 0.04045
    return encoded if raw else np.where(low, encoded / 12.92, np.power((encoded + 0.055) / 1.055, 2.4))


def _lookup(texture: Any, texels: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(m, 3) reflectances at places in texels."""
    wrap = getattr(texture, "wrap", "repeat")

    def texel(column: np.ndarray, line: np.ndarray) -> np.ndarray:
        height, width, _ = texels.shape
        found: np.ndarray = texels[_wrapped(line, height, wrap), _wrapped(column, width, wrap)]
        return found

    if getattr(texture, "filter", "") != "bilinear":
        return texel(np.floor(x), np.floor(y))
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    a, b = (x - 0.5 - left)[:, None], (y - 0.5 - top)[:, None]
    upper = texel(left, top) * (1.0 - a) + texel(left + 1.0, top) * a
    return upper * (1.0 - b) + (texel(left, top + 1.0) * (1.0 - a) + texel(left + 1.0, top + 1.0) * a) * b


def _wrapped(i: np.ndarray, count: int, wrap: str) -> np.ndarray:
    """The numbers of the texels in place of whole numbers; any for one that is not finite."""
    if wrap != "clamp":
        i = np.mod(i, 2 * count if wrap == "mirror" else count)
        i = np.minimum(i, 2 * count - 1 - i) if wrap == "mirror" else i
    return np.clip(np.nan_to_num(i), 0, count - 1).astype(np.int64)
