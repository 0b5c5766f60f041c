"""Compiled kernels of tiles and packets agree with NumPy."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from marks import compiled_only

from caster.jit.decorators import jit
from caster.jit.simd import LANES
from caster.kernels.bvh.traversal import packet_bounds
from caster.kernels.raster import tile as tiles
from caster.kernels.raster.tile_casting import any_pixel_visible, bounds_in_tile, max_visible_t

pytestmark = compiled_only


def some_tile(rng: np.random.Generator) -> np.ndarray:
    """Numbers of many sizes in all fields, also behind the last pixel of each row."""
    tile = tiles.new_tile()
    tile[:] = 10.0 ** rng.uniform(-3.0, 3.0, tile.shape)
    return tile


def field_of(tile: np.ndarray, field: int) -> np.ndarray:
    return tile[int(field) : int(field) + tiles.PIXELS].reshape(tiles.HEIGHT, tiles.WIDTH)


def whole_lanes(start: int, stop: int) -> tuple[int, int]:
    return start - start % LANES, stop + -stop % LANES


def some_span(rng: np.random.Generator) -> tuple[int, int, int, int]:
    x, y = np.sort(rng.integers(0, 40, 2)), np.sort(rng.integers(0, 5, 2))
    return int(x[0]), int(y[0]), int(x[1]) + 1, int(y[1]) + 1


KERNELS = {
    "max_visible_t": lambda tile, box: max_visible_t(tile, box),
    "bounds_in_tile": lambda pixels, k, box, c: bounds_in_tile(pixels, k, box)[c],
    "any_pixel_visible": lambda tile, rect, near: int(any_pixel_visible(tile, rect, near)),
    "packet_bounds": lambda tile, first, end, c: packet_bounds(tile, tiles.DX, tiles.lane(first))[end][c],
}


def agrees(compiled: Callable[..., Any], name: str, rng: np.random.Generator) -> bool:
    tile, (x0, y0, x1, y1) = some_tile(rng), some_span(rng)
    box = (1000, 500, 1000 + x1, 500 + y1)
    seen = np.s_[:y1, : whole_lanes(0, x1)[1]]
    reach = (field_of(tile, tiles.T) + field_of(tile, tiles.T_ERROR))[seen]
    if name == "max_visible_t":
        return bool(compiled(tile, box) == reach.max())
    if name == "bounds_in_tile":
        pixels = np.array([[1000 + x0, 500 + y0, 1000 + x1, 500 + y1]])
        start, stop = whole_lanes(x0, x1)
        found = [compiled(pixels, 0, (1000, 500, 1128, 564), c) for c in range(4)]
        return found == [start, y0, stop, y1]
    if name == "any_pixel_visible":
        start, stop = whole_lanes(x0, x1)
        part = (field_of(tile, tiles.T) + field_of(tile, tiles.T_ERROR))[y0:y1, start:stop]
        above = np.nextafter(part.max(), math.inf)
        rect = (start, y0, stop, y1)
        return bool(compiled(tile, rect, float(part.max())) and not compiled(tile, rect, float(above)))
    first = LANES * int(rng.integers(tiles.PIXELS // LANES))
    parts = [field_of(tile, field).ravel()[first : first + LANES] for field in (tiles.DX, tiles.DY, tiles.DZ)]
    found = [[compiled(tile, first, end, c) for c in range(3)] for end in (0, 1)]
    return found == [[p.min() for p in parts], [p.max() for p in parts]]


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_of_tiles_gives_what_numpy_gives(name):
    compiled, rng = jit(KERNELS[name]), np.random.default_rng(34)
    assert all(agrees(compiled, name, rng) for _ in range(60))
