"""Colours of textures in float64, and what errors of uv and barycentrics make of them (docs/method.md, "Textures").

An independent implementation: pictures are decoded and looked up again.
"""

import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.intersections import Array, largest_of_columns, norm, without_float_warnings
from mitsuba_ref.error_model.tolerances import BARYCENTRIC_ROUNDINGS, KU, SRGB_DECODING_ROUNDINGS, U32


class ColoredPoints(NamedTuple):
    """What one side says of n hits."""

    shape: Array  # (n,), -1 on a miss
    prim: Array  # (n,), within the shape
    uv: Array  # (n, 2)
    p: Array  # (n, 3)
    colors: Array  # (n, 3), reflectances


@without_float_warnings
def color_ratios(textures: Sequence[Any], parts: Sequence[Any], at: ColoredPoints, ku: float) -> Array:
    """(n,) error over bound of reflectances that one side computed at its own uv or p; 0 without a texture.

    parts: the packed arrays of each shape.
    """
    ratios = np.zeros(len(at.shape))
    for k, texture in enumerate(textures):
        rows = np.flatnonzero(at.shape == k) if texture is not None else ()
        if len(rows):
            here = ColoredPoints(*(each[rows] for each in at))
            of_mesh = texture.type == "mesh_colors"
            ratios[rows] = _mesh_ratio(texture, parts[k], here, ku) if of_mesh else _ratio(texture, *here[2::2], ku)
    return ratios


def _mesh_ratio(texture: Any, part: Any, at: ColoredPoints, ku: float) -> Array:
    """As color_ratios, of colours of a mesh; formulas (24) to (26)."""
    faces = part.faces[at.prim]
    corners = part.vertices[faces]
    colors = np.asarray(texture.vertices)[faces] if texture.faces is None else np.asarray(texture.faces)[at.prim, None]
    colors = np.broadcast_to(colors, corners.shape)
    first, others = colors[:, 0], colors[:, 1:]
    edges, x = corners[:, 1:] - corners[:, :1], at.p - corners[:, 0]
    gram, along = np.einsum("nik,njk->nij", edges, edges), np.einsum("nik,nk->ni", edges, x)
    (uu, uv), vv = gram[:, 0].T, gram[:, 1, 1]
    area, most = uu * vv - uv * uv, uu * vv + uv * uv
    adjugate = np.stack([vv, -uv, -uv, uu], axis=1).reshape(-1, 2, 2)
    b = np.einsum("nij,nj->ni", adjugate, along) / area[:, None]
    unit = BARYCENTRIC_ROUNDINGS * ku * norm(x) * most / area / area
    off = unit[:, None] * np.einsum("nij,nj->ni", np.abs(adjugate), np.sqrt(np.stack([uu, vv], axis=1)))
    change = np.einsum("ni,nik->nk", off, np.abs(others - first[:, None]))
    rounding = 6.0 * ku * (first + np.einsum("ni,nik->nk", np.abs(b), others + first[:, None]))
    bound = np.where((BARYCENTRIC_ROUNDINGS * ku * most < 0.5 * area)[:, None], change + rounding, np.inf)
    expected = first + np.einsum("ni,nik->nk", b, others - first[:, None])
    return largest_of_columns(error_over_bound(np.abs(at.colors - expected), bound))


def _ratio(texture: Any, uv: Array, colors: Array, ku: float) -> Array:
    """As color_ratios; formulas (21) to (23)."""
    texels, blends = texels_of(texture), texture.filter == "bilinear"
    size, linear, move = texels.shape[1::-1], texture.uv_matrix[:, :2], texture.uv_matrix[:, 2]
    place = (uv @ linear.T + move) * size  # in texels from the corner of the picture
    off = 3.0 * ku * (np.abs(uv) @ np.abs(linear).T + np.abs(move)) * size
    low, high = place - off, place + off
    bend = np.clip(np.floor(place) + 0.5, low, high)  # where the slope changes
    values = [_lookup(texture, texels, x[:, 0], y[:, 1]) for x in (low, bend, high) for y in (low, bend, high)]
    exact = _lookup(texture, texels, *place.T)
    decoding = SRGB_DECODING_ROUNDINGS * U32 if ku == KU and getattr(texture, "file", None) and not texture.raw else 0.0
    rounding = (3.0 * ku + decoding) * np.max(values, axis=0)
    change = np.max(np.abs(values - exact), axis=0) * blends
    change[(off >= 0.5).any(axis=1)] = np.ptp(texels, axis=(0, 1))  # any texel may be meant
    allowed = [exact] if blends else values
    ratios = [largest_of_columns(error_over_bound(np.abs(colors - value), change + rounding)) for value in allowed]
    found: Array = np.min(ratios, axis=0)
    return found


def texels_of(texture: Any) -> Array:
    """(h, w, 3) linear reflectances."""
    if texture.type == "checkerboard":
        return np.array([[texture.color0, texture.color1], [texture.color1, texture.color0]])
    if texture.file is None:
        return np.asarray(texture.data)
    return _decoded(texture.file, texture.raw, os.stat(texture.file).st_mtime_ns)


@lru_cache(maxsize=4)
def _decoded(file: str, raw: bool, _changed: int) -> Array:
    """The texels of a PNG file, decoded from sRGB unless raw (IEC 61966-2-1)."""
    with Image.open(file) as image:
        encoded = np.asarray(image.convert("RGB")) / 255.0
    low = encoded <= 0.04045
    return encoded if raw else np.where(low, encoded / 12.92, np.power((encoded + 0.055) / 1.055, 2.4))


def _lookup(texture: Any, texels: Array, x: Array, y: Array) -> Array:
    """(m, 3) reflectances at places in texels."""
    if texture.filter == "nearest":
        return _texels_at(texture, texels, np.floor(x), np.floor(y))
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    found = np.zeros((len(x), 3))
    for column, line in ((0, 0), (1, 0), (0, 1), (1, 1)):
        share = (1.0 - np.abs(x - 0.5 - left - column)) * (1.0 - np.abs(y - 0.5 - top - line))
        found += share[:, None] * _texels_at(texture, texels, left + column, top + line)
    return found


def _texels_at(texture: Any, texels: Array, *place: Array) -> Array:
    """(m, 3) of columns and lines, whole numbers; any texel for one that is not finite."""
    numbers = []
    for i, count in zip(place, texels.shape[1::-1], strict=True):
        if texture.wrap != "clamp":
            i = np.mod(i, 2 * count if texture.wrap == "mirror" else count)
        if texture.wrap == "mirror":
            i = np.minimum(i, 2 * count - 1 - i)
        numbers.append(np.clip(np.nan_to_num(i), 0, count - 1).astype(np.int64))
    found: Array = texels[numbers[1], numbers[0]]
    return found
