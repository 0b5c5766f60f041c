"""The order in which rays of a fan are cast: keys, what belongs to a fan and places in a tile, by exact arithmetic."""

import math
from fractions import Fraction

import numpy as np
import pytest

from caster.kernels.bvh.fans import Fan
from caster.kernels.bvh.ray_sorting import (
    BUCKETS,
    LOWER_BITS,
    NOT_IN_FAN,
    find_keys,
    largest_deviation,
    load_sorted,
    store_sorted,
    store_sorted_blocked,
)
from caster.kernels.nearest import Rays, no_hits
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    OX,
    OY,
    OZ,
    PIXELS,
    PRIM,
    T_ERROR,
    T_MAX,
    T_MIN,
    UNCERTAIN,
    T,
    new_tile,
)

ORIGIN = (1.0, -2.0, 4.0)
NOWHERE = (0.0, 0.0, 0.0)
AXES = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
BACK = (0.5, -0.25, 1.0)
POINT_FAN = Fan(1.0, ORIGIN, NOWHERE, *AXES, 100.0, 0.0)
PARALLEL_FAN = Fan(0.0, NOWHERE, BACK, *AXES, 100.0, 0.0)


def some_rays(o, d, t_max=math.inf):
    o, d = np.broadcast_arrays(np.array(o, float), np.array(d, float))
    count = len(d)
    return Rays(o.copy(), d.copy(), np.zeros(count), np.full(count, t_max))


def keys_of(fan, rays, outward, deviation=0.0, corners=(-2.0, -2.0, 2.0, 2.0)):
    """The key of each ray; counted in its bucket, and beside the ray's number."""
    count, first = len(rays.t_min), 3
    pairs, counts = np.full(count, -1, np.int64), np.zeros(BUCKETS, np.int64)
    find_keys(fan, rays, outward, deviation, corners, first, (first, count), pairs, counts)
    keys = pairs[: count - first] >> 32
    assert (pairs[: count - first] & 0xFFFFFFFF).tolist() == list(range(first, count))
    assert (pairs[count - first :] == -1).all()
    assert counts.tolist() == np.bincount(keys >> LOWER_BITS, minlength=BUCKETS).tolist()
    return keys.tolist()


def is_in_fan(fan, o, d, t_max, outward, deviation=0.0):
    rays = some_rays(np.tile(o, (4, 1)), np.tile(d, (4, 1)), t_max)
    (key,) = keys_of(fan, rays, outward, deviation)
    return key != NOT_IN_FAN


def test_rays_belong_to_a_fan_that_start_at_its_origin_or_have_its_direction():
    assert is_in_fan(POINT_FAN, ORIGIN, (0.5, -3.0, 1.0), 0.0, True)
    assert not is_in_fan(POINT_FAN, ORIGIN, (0.5, -3.0, 1.0), -1.0, True)  # there is no ray
    assert is_in_fan(PARALLEL_FAN, (7.0, 8.0, 9.0), BACK, 5.0, False)
    assert not is_in_fan(PARALLEL_FAN, (7.0, 8.0, 9.0), BACK, -1.0, False)
    for axis in range(3):
        for way in (-math.inf, math.inf):
            o, d = list(ORIGIN), list(BACK)
            o[axis], d[axis] = math.nextafter(o[axis], way), math.nextafter(d[axis], way)
            assert not is_in_fan(POINT_FAN, o, (0.5, -3.0, 1.0), math.inf, True)
            assert not is_in_fan(PARALLEL_FAN, (7.0, 8.0, 9.0), d, math.inf, False)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_ray_to_the_origin_of_a_fan_may_pass_it_and_go_on_by_the_deviation(axis, way):
    """It takes t = 3 along an axis to where it is nearest; there it is as far off as it starts aside."""
    d = np.zeros(3)
    d[axis] = 2.0 * way
    for beside in (axis - 2, axis - 1):
        for aside in (0.25, -0.25):
            o = np.array(ORIGIN) - 3.0 * d
            o[beside] += aside
            assert is_in_fan(POINT_FAN, o, d, 3.0, False, 0.25)
            assert not is_in_fan(POINT_FAN, o, d, 3.0, False, 0.25 - 2.0**-30)
            assert is_in_fan(POINT_FAN, o, d, 3.0 + 0.125, False, 0.25)  # 0.125 lengths of d are 0.25
            assert not is_in_fan(POINT_FAN, o, d, 3.0 + 0.125 + 2.0**-30, False, 0.25)
            assert is_in_fan(POINT_FAN, o, d, 0.0, False, 0.25)  # it may end before
            assert not is_in_fan(POINT_FAN, o, -d, 0.0, False, 100.0)  # or lead away


def exact_deviation(o, d, t_max, p):
    o, d, p = ([Fraction(x) for x in v] for v in (o, d, p))
    t = sum((a - b) * c for a, b, c in zip(p, o, d, strict=True)) / sum(x * x for x in d)
    off = max(abs(a + t * b - c) for a, b, c in zip(o, d, p, strict=True))
    return max(off, (Fraction(t_max) - t) * max(map(abs, d)))


def test_the_largest_deviation_is_that_of_the_ray_that_passes_a_point_farthest_or_goes_on_beyond_it():
    rng, p = np.random.default_rng(210), (0.25, 3.0, -1.5)
    for _ in range(60):
        count = 6
        d = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-1.0, 1.0, (count, 1))
        o = np.array(p) - rng.uniform(0.5, 2.0, (count, 1)) * d + 1e-2 * rng.normal(size=(count, 3))
        along = ((p - o) * d).sum(axis=1) / (d * d).sum(axis=1)
        t_max = along * rng.uniform(0.9, 1.02, count)
        each = [float(exact_deviation(*row, p)) for row in zip(o.tolist(), d.tolist(), t_max, strict=True)]
        rays = Rays(o, d, np.zeros(count), t_max)
        assert largest_deviation(rays, p, 0, count) == pytest.approx(max(each), rel=1e-9)
        assert largest_deviation(rays, p, 1, 4) == pytest.approx(max(each[1:4]), rel=1e-9)
        away = int(rng.integers(1, 5))
        rays.d[away] *= -1.0
        assert largest_deviation(rays, p, 0, count) == math.inf
        rays.t_max[away] = -1.0  # there is no ray
        del each[away]
        assert largest_deviation(rays, p, 0, count) == pytest.approx(max(each), rel=1e-9)
    assert largest_deviation(rays, p, 2, 2) == 0.0


def field(tile, at):
    return tile[int(at) : int(at) + PIXELS]


@pytest.mark.parametrize(("outward", "same_limits"), [(True, True), (False, False)])
def test_a_tile_of_sorted_rays_holds_these_alone_and_gives_back_the_hit_of_each(outward, same_limits):
    rng, count, start, stop = np.random.default_rng(212), 90, 11, 80
    rays = Rays(*rng.normal(size=(2, count, 3)), rng.uniform(0.0, 1.0, count), rng.uniform(1.0, 2.0, count))
    if outward:
        rays.o[:] = ORIGIN
    if same_limits:
        rays.t_min[:], rays.t_max[:] = 0.25, 3.0
    order, tile = rng.permutation(count).astype(np.int32), new_tile()
    tile[:] = 7.0  # from an earlier run of rays
    load_sorted(rays, order, start, stop, tile, ORIGIN, outward, same_limits)
    place = np.flatnonzero(field(tile, T_MAX) >= 0.0)
    kept = order[start:stop]
    kept = kept[np.argsort(rays.d[kept, 0])]
    place = place[np.argsort(field(tile, DX)[place])]  # of the rays of `kept`
    for fields, expected in (((DX, DY, DZ), rays.d), ((OX, OY, OZ), rays.o)):
        assert np.array_equal(np.column_stack([field(tile, f)[place] for f in fields]), expected[kept])
    for f, limit in ((T_MIN, rays.t_min), (T_MAX, rays.t_max)):
        assert field(tile, f)[place].tolist() == limit[kept].tolist()
    for f, at_first in ((T, math.inf), (T_ERROR, 0.0), (PRIM, -1.0), (UNCERTAIN, 0.0)):
        assert (field(tile, f) == at_first).all()
    none = np.setdiff1d(np.arange(PIXELS), place)
    assert (field(tile, DX)[none] == 0.0).all() and (field(tile, DZ)[none] == 1.0).all()  # harmless to cast

    t, error = rng.uniform(1.0, 2.0, (2, len(kept)))
    prim, unsure = rng.integers(-1, 4, len(kept)), rng.random(len(kept)) < 0.5
    for f, values in ((T, t), (T_ERROR, error), (PRIM, prim), (UNCERTAIN, unsure)):
        field(tile, f)[place] = values
    ids, nearest, uncertain = np.array([50, 60, 70, 80], np.int32), no_hits(count), np.zeros(count, bool)
    nearest.t[:], nearest.prim[:], nearest.error[:] = 9.0, 9, 9.0
    store_sorted(tile, order, start, stop, ids, nearest, uncertain)
    assert nearest.t[kept].tolist() == np.where(prim >= 0, t, math.inf).tolist()
    assert nearest.prim[kept].tolist() == np.where(prim >= 0, ids[prim], -1).tolist()
    assert nearest.error[kept].tolist() == error.tolist() and uncertain[kept].tolist() == unsure.tolist()
    others = np.setdiff1d(np.arange(count), kept)
    assert (nearest.t[others] == 9.0).all() and (nearest.prim[others] == 9).all() and not uncertain[others].any()

    t[: len(kept) // 2] = math.inf
    field(tile, T)[place] = t
    blocked, uncertain = np.zeros((2, count), bool)
    store_sorted_blocked(tile, order, start, stop, blocked, uncertain)
    met = (t < math.inf) & (prim >= 0)
    assert blocked[kept].tolist() == met.tolist() and not blocked[others].any()
    assert uncertain[kept].tolist() == (unsure & ~met).tolist() and not uncertain[others].any()
