"""Rays that tiles load, and hits that they keep and store."""

import math

import numpy as np
import pytest

from caster.kernels.nearest import Rays, no_hits
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    HEIGHT,
    LANE_FIELDS,
    OX,
    OY,
    OZ,
    PIXELS,
    PRIM,
    SURFACE_LANES,
    T_ERROR,
    T_MAX,
    T_MIN,
    TILE_SIZE,
    UNCERTAIN,
    WIDTH,
    T,
    lane,
    load_rays,
    new_lanes,
    new_tile,
    store_nearest,
    tile_rows,
    update_nearest,
)

RAY_FIELDS = (OX, OY, OZ, DX, DY, DZ, T_MIN, T_MAX)
BEGUN = {T: math.inf, T_ERROR: 0.0, PRIM: -1.0, UNCERTAIN: 0.0}


def whole(tile, at):
    """A field as rows of the tile, which can be written."""
    return tile[int(at) : int(at) + PIXELS].reshape(HEIGHT, WIDTH)


def some_rays(rng, count):
    return Rays(*rng.normal(size=(2, count, 3)), rng.uniform(0.0, 1.0, count), rng.uniform(1.0, 2.0, count))


def as_rows(rays):
    """(n, 8): o, d, t_min, t_max."""
    return np.column_stack([rays.o, rays.d, rays.t_min, rays.t_max])


def used_tile():
    tile = new_tile()
    tile[:] = 7.0
    return tile


def test_a_tile_takes_the_rays_it_is_given_and_gives_back_the_hit_of_each():
    rng, count = np.random.default_rng(250), 320
    rays, tile, ids = some_rays(rng, count), used_tile(), np.array([50, 60, 70, 80], np.int32)
    numbers = np.where(rng.random(200) < 0.8, rng.permutation(count)[:200], -1).astype(np.int32)
    here, kept = np.flatnonzero(numbers >= 0), numbers[numbers >= 0]
    load_rays(rays, numbers, tile)
    flat = np.stack([whole(tile, f).ravel() for f in RAY_FIELDS], axis=1)
    assert np.array_equal(flat[here], as_rows(rays)[kept])
    assert (flat[np.flatnonzero(numbers < 0), -1] == -1.0).all() and (flat[200:] == 7.0).all()
    for f, number in BEGUN.items():
        assert (whole(tile, f).ravel()[:200] == number).all()
    values = {f: v.ravel()[here] for f, v in met(rng, tile).items()}
    nearest, uncertain = no_hits(count), np.zeros(count, bool)
    store_nearest(tile, numbers, ids, nearest, uncertain)
    prim, unsure = values[PRIM], values[UNCERTAIN] == 1.0
    assert np.array_equal(nearest.prim[kept], np.where(prim < 0, -1, ids[prim]))
    assert np.array_equal(nearest.t[kept], values[T]) and np.array_equal(nearest.error[kept], values[T_ERROR])
    assert np.array_equal(uncertain[kept], unsure)
    others = np.setdiff1d(np.arange(count), kept)
    assert (nearest.prim[others] == -1).all() and not uncertain[others].any()


def met(rng, tile, shape=(HEIGHT, WIDTH)):
    """Fill in random hits of primitives 0 to 3, or misses; returns the fields."""
    prim = rng.integers(-1, 4, shape)
    values = {T: np.where(prim < 0, math.inf, rng.random(shape)), T_ERROR: rng.random(shape), PRIM: prim}
    values[UNCERTAIN] = np.where(rng.random(shape) < 0.3, 1.0, 0.0)
    for at, numbers in values.items():
        whole(tile, at)[: shape[0], : shape[1]] = numbers
    return values


@pytest.mark.parametrize("t", [math.inf, math.nan, 2.0, 2.25, 2.5, 3.0, 3.5, 3.75, 4.0, -1.0])
@pytest.mark.parametrize("error", [0.0, 0.25, 0.5])
def test_an_answer_is_nearer_where_both_errors_allow_it_and_uncertain_where_they_do_not(t, error):
    """The nearest hit so far is at 3 within 0.25, or missing; at a distance of exactly both errors it is uncertain."""
    for held, held_error in ((3.0, 0.25), (math.inf, 0.0)):
        for unsure in (0.0, 1.0):
            tile = used_tile()
            fields = {T: held, T_ERROR: held_error, PRIM: 4.0, UNCERTAIN: unsure}
            for at, number in fields.items():
                tile[int(at) + 9] = number
            before = tile.copy()
            update_nearest(tile, lane(9), 6.0, t, error)
            nearer = t < held - held_error - error
            near = t < math.inf and held < math.inf and abs(held - t) <= held_error + error
            expected = (t, error, 6.0) if nearer else (held, held_error, 4.0)
            assert tuple(tile[int(at) + 9] for at in (T, T_ERROR, PRIM)) == expected
            assert tile[int(UNCERTAIN) + 9] == float(unsure or near)
            changed = np.flatnonzero(tile != before)
            assert set(changed.tolist()) <= {int(at) + 9 for at in fields}


@pytest.mark.parametrize("new", [new_tile, new_lanes])
def test_fields_begin_at_a_cache_line(new):
    for _ in range(3):
        assert new().ctypes.data % 64 == 0 and new().flags.c_contiguous
    assert len(new_tile()) == TILE_SIZE and len(new_lanes()) == LANE_FIELDS * SURFACE_LANES


@pytest.mark.parametrize(("width", "height"), [(1, 1), (WIDTH, HEIGHT), (3 * WIDTH + 5, 2 * HEIGHT + 1), (130, 200)])
def test_tiles_cover_each_pixel_of_a_window_once_row_by_row(width, height):
    covered = np.zeros((height, width), int)
    corners = []
    for x0, y0, x1, y1 in tile_rows(width, height, 0)[:, :4]:
        assert 0 < x1 - x0 <= WIDTH and 0 < y1 - y0 <= HEIGHT
        covered[y0:y1, x0:x1] += 1
        corners.append((y0, x0))
    assert (covered == 1).all() and corners == sorted(corners)
