"""The order in which rays of a fan are cast: keys, what belongs to a fan and places in a tile, by exact arithmetic."""

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from caster.kernels.bvh.fans import FAN_LIMIT, Fan
from caster.kernels.bvh.ray_sorting import (
    BUCKETS,
    HALF_BITS,
    LOWER_BITS,
    LOWER_CELLS,
    MAX_SORTED_BY_INSERTION,
    NOT_IN_FAN,
    OTHER_FANS,
    find_keys,
    largest_deviation,
    load_sorted,
    project_rays,
    rays_of_other_limits,
    scatter_to_buckets,
    sort_buckets,
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
CORNERS = [(-2.0, -2.0, 2.0, 2.0), (-0.5, 0.25, 0.5, 0.75), (0.25, -1.0, 0.25, -1.0)]
INTEGERS = np.array([d for d in product(range(-5, 6), repeat=3) if any(d)], float)


def some_rays(o, d, t_max=math.inf):
    o, d = np.broadcast_arrays(np.array(o, float), np.array(d, float))
    count = len(d)
    return Rays(o.copy(), d.copy(), np.zeros(count), np.full(count, t_max))


def keys_of(fan, rays, outward, deviation=0.0, corners=CORNERS[0]):
    """The key of each ray; counted in its bucket, and beside the ray's number."""
    count, first = len(rays.t_min), 3
    pairs, counts = np.full(count, -1, np.int64), np.zeros(BUCKETS, np.int64)
    find_keys(fan, rays, outward, deviation, corners, first, (first, count), pairs, counts)
    keys = pairs[: count - first] >> 32
    assert (pairs[: count - first] & 0xFFFFFFFF).tolist() == list(range(first, count))
    assert (pairs[count - first :] == -1).all()
    assert counts.tolist() == np.bincount(keys >> LOWER_BITS, minlength=BUCKETS).tolist()
    return keys.tolist()


def interleaved(i, j, bits):
    """The bits of j and i in turns, as text."""
    return int("".join(b + a for a, b in zip(f"{i:0{bits}b}", f"{j:0{bits}b}", strict=True)), 2)


def exact_cell(x, low, high, cells):
    """Which of so many equal parts of low..high holds x, or is next to it; the first where there are none."""
    if low == high:
        return 0
    return min(max(math.floor((x - low) * cells / (high - low)), 0), cells - 1)


def exact_key(place, perspective, corners):
    x, y, z = map(Fraction, place)
    low_x, low_y, high_x, high_y = map(Fraction, corners)
    if not perspective or (z > 0 and max(abs(x), abs(y)) <= FAN_LIMIT * z):
        over, cells = z if perspective else 1, 2**HALF_BITS
        i, j = exact_cell(x / over, low_x, high_x, cells), exact_cell(y / over, low_y, high_y, cells)
        return interleaved(i, j, HALF_BITS)
    # the side of a cube: across z, x or y, the first of x, y, z on a tie; coordinates there in cyclic order
    largest = max(abs(x), abs(y), abs(z))
    axis = [abs(x), abs(y), abs(z)].index(largest)
    u, v, w = (y, z, x) if axis == 0 else (z, x, y) if axis == 1 else (x, y, z)
    side, bits = 2 * (axis + 1) % 6 + (w < 0), HALF_BITS - 2
    i, j = (exact_cell(each / largest, -1, 1, 2**bits) for each in (u, v))
    return OTHER_FANS + side * 4**bits + interleaved(i, j, bits)


@pytest.mark.parametrize("corners", CORNERS)
@pytest.mark.parametrize("outward", [True, False])
def test_a_key_is_the_projected_cell_of_a_ray_in_morton_order(corners, outward):
    """That of the direction from the origin, or of where a ray to it starts."""
    begin, d = (ORIGIN, INTEGERS) if outward else (np.array(ORIGIN) + INTEGERS, -INTEGERS)
    rays = some_rays(begin, d, 1.0)
    keys = keys_of(POINT_FAN, rays, outward, corners=corners)
    assert keys == [exact_key(d, True, corners) for d in INTEGERS[3:].tolist()]
    assert max(keys) < NOT_IN_FAN < BUCKETS << LOWER_BITS


@pytest.mark.parametrize("corners", CORNERS)
def test_a_key_of_a_parallel_ray_is_the_cell_of_its_origin(corners):
    keys = keys_of(PARALLEL_FAN, some_rays(INTEGERS / 8.0, BACK), False, corners=corners)
    assert keys == [exact_key(o, False, corners) for o in (INTEGERS[3:] / 8.0).tolist()]


def test_every_cell_of_a_projection_has_a_key_of_its_own():
    x = (np.arange(2**HALF_BITS) + 0.5) / 2**HALF_BITS
    for axis in range(2):
        d = np.ones((len(x), 3))
        d[:, axis] = x
        keys = keys_of(POINT_FAN, some_rays(ORIGIN, d), True, corners=(0.0, 0.0, 1.0, 1.0))
        other = interleaved(*((0, 2**HALF_BITS - 1), (2**HALF_BITS - 1, 0))[axis], HALF_BITS)
        expected = [interleaved(*((n, 0), (0, n))[axis], HALF_BITS) | other for n in range(3, len(x))]
        assert keys == expected


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


@pytest.mark.parametrize("field", ["t_min", "t_max"])
def test_limits_are_the_same_where_none_differs_from_those_of_the_first_ray(field):
    rays = some_rays(ORIGIN, INTEGERS[:7])
    assert rays_of_other_limits(rays, 0, 7) == 0
    for n in range(1, 7):
        getattr(rays, field)[n] = 9.0
        assert rays_of_other_limits(rays, 0, 7) > 0 and rays_of_other_limits(rays, n, 7) > 0
        assert rays_of_other_limits(rays, 0, n) == 0 and rays_of_other_limits(rays, n + 1, 7) == 0
        getattr(rays, field)[n] = getattr(rays, field)[0]
    getattr(rays, field)[0] = 3.0
    assert rays_of_other_limits(rays, 2, 4) > 0


@pytest.mark.parametrize("outward", [True, False])
def test_rays_are_projected_from_the_origin_of_a_fan_or_belong_to_another(outward):
    o, d = (ORIGIN, INTEGERS) if outward else (np.array(ORIGIN) + INTEGERS, np.ones(3))
    points = np.zeros((len(INTEGERS), 2))
    project_rays(POINT_FAN, some_rays(o, d), outward, points)
    x, y, z = INTEGERS.T
    inside = (z > 0.0) & (np.maximum(np.abs(x), np.abs(y)) <= FAN_LIMIT * z)
    assert np.isnan(points[~inside]).all() and 0 < inside.sum() < len(inside)
    assert points[inside].tolist() == (INTEGERS[inside][:, :2] / INTEGERS[inside][:, 2:]).tolist()


def test_parallel_rays_are_projected_along_their_direction():
    points = np.zeros((len(INTEGERS), 2))
    project_rays(PARALLEL_FAN, some_rays(INTEGERS, BACK), False, points)
    assert points.tolist() == INTEGERS[:, :2].tolist()


def test_buckets_are_scattered_in_order_and_sorted_by_the_rest_of_their_keys():
    """Few rays by pairs, many by their keys alone, so that those with one key stay in order."""
    rng = np.random.default_rng(211)
    sizes = {7: 1, 8: MAX_SORTED_BY_INSERTION, 9: MAX_SORTED_BY_INSERTION + 1, 2000: 300, BUCKETS - 1: 5}
    buckets = rng.permutation(np.repeat(list(sizes), list(sizes.values())))
    lower = rng.choice([0, 1, 511, LOWER_CELLS - 2, LOWER_CELLS - 1], len(buckets))
    pairs = (((buckets << LOWER_BITS) + lower) << 32) + np.arange(len(buckets))
    edges = np.concatenate([[0], np.cumsum(np.bincount(buckets, minlength=BUCKETS))])
    places, scattered = edges[:-1].copy(), np.full(len(pairs), -1, np.int64)
    for start, stop in ((0, 100), (100, len(pairs))):
        scatter_to_buckets(pairs, places, start, stop, scattered)
    assert places.tolist() == edges[1:].tolist()
    assert scattered.tolist() == pairs[np.argsort(buckets, kind="stable")].tolist()
    order = np.full(len(pairs), -1, np.int32)
    sort_buckets(scattered, edges, (8, BUCKETS - 1), np.full(LOWER_CELLS, 99, np.int64), order)
    expected = (np.sort(pairs) & 0xFFFFFFFF).tolist()
    assert order[:1].tolist() == [-1] and order[-5:].tolist() == [-1] * 5  # buckets of others
    assert order[1:-5].tolist() == expected[1:-5]


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
