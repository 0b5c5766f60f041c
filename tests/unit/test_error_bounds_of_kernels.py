"""Error bounds that kernels state, against inputs moved by as much as they are off; small parts by formula."""

import math
from fractions import Fraction
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from caster.aovs import AOVS, kernel_of, register
from caster.cameras import Fisheye
from caster.description.errors import SceneError
from caster.geometry.packing import pack
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.build import STACK_SIZE, open_largest
from caster.kernels.bvh.traversal import cast_packets_brute_force, cast_rays_singly
from caster.kernels.math.quadric_roots import quadric_roots, quadric_setup
from caster.kernels.math.vec import UNDECIDED, U, permanent
from caster.kernels.nearest import ALL_IN_RANGE, OUT_OF_RANGE, find_invalid_ray
from caster.kernels.protocol import exact_intersect, intersect, load, normal, prepare, surely_misses
from caster.kernels.raster.tile import PRIM, T_ERROR, UNCERTAIN, T, lane, new_tile, start_ray
from caster.kernels.raster.tile_casting import bounds_in_tile, row_bounds
from caster.kernels.raster.wide_angle import MAX_HULL_ANGLE
from caster.kernels.triangles import SHEAR_ERROR, barycentrics, barycentrics_edge_on, fast_barycentrics
from caster.rendering.bvh_construction import bvh_of
from caster.scene.model import Scene
from caster.shapes import Cylinder, Disk, Plane, Sphere, Torus, Triangle
from caster.shapes.cylinder import clip_to_height

SLACK = 1e-9  # of what is computed here in float64, far below the errors that are planted
MOVED = 12  # inputs moved at random, for each that is looked at
PLACED = [{"scale": [0.5, 2.0, 1.0]}, {"rotate": {"axis": [1, 2, 3], "degrees": 50}}, {"translate": [1, 2, 3]}]


def prims_of(shape):
    camera = Fisheye(eye=(0.0, 0.0, 0.0), look_at=(0.0, 0.0, 1.0))
    return pack(Scene(film={"width": 8, "height": 6}, camera=camera, shapes=[shape])).kinds[0].prims


def moved(rng, v, by):
    """v and a vector that differs from it by `by` in length."""
    step = rng.normal(size=len(v))
    return v + by * step / np.linalg.norm(step)


def test_roots_of_a_sphere_hold_for_every_centre_and_direction_within_their_errors():
    rng, said = np.random.default_rng(160), {"met": 0, "missed": 0}
    for _ in range(400):
        r = 10.0 ** rng.uniform(-1.0, 1.0)
        f, d = r * rng.uniform(0.0, 4.0) * moved(rng, np.zeros(3), 1.0), rng.normal(size=3)
        if rng.random() < 0.7:  # towards it
            d = -f + 0.8 * r * rng.normal(size=3)
        f_error, d_error = (10.0 ** rng.uniform(-7.0, -1.5, 2)) * (rng.random(2) < 0.7)
        f_error, d_error = f_error * r, d_error * np.linalg.norm(d)
        found = quadric_roots(quadric_setup(tuple(f), r, f_error), tuple(d), d_error)
        assert not (found.met and found.missed)
        said["met"] += found.met
        said["missed"] += found.missed
        for _ in range(MOVED):
            a_f, a_d = moved(rng, f, f_error), moved(rng, d, d_error)
            a, b, c = a_d @ a_d, -(a_f @ a_d), a_f @ a_f - r * r
            space = b * b - a * c
            size = b * b + a * (a_f @ a_f + r * r)
            if found.missed:
                assert space < SLACK * size
            if found.met:
                assert space > -SLACK * size
                roots = (b + np.array([-1.0, 1.0]) * math.sqrt(max(space, 0.0))) / a
                off = np.abs(roots - [found.near, found.far])
                assert (off <= np.array([found.near_error, found.far_error]) + SLACK * np.abs(roots).max()).all()
    assert min(said.values()) >= 60


def test_a_sphere_is_hit_or_missed_at_its_rim_as_exact_arithmetic_decides():
    """Lines that pass the centre at the radius, up to some units of float64: where rounding decides."""
    rng, said = np.random.default_rng(163), {"met": 0, "missed": 0, "neither": 0}
    for number in range(900):
        f = rng.normal(size=3) * 10.0 ** rng.uniform(-1.0, 3.0)
        d = rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 2.0)
        aside = np.linalg.norm(np.cross(f, d)) / np.linalg.norm(d)
        r = float(aside * (1.0 + rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-16.0, -12.0)))
        f_error = 0.0 if number % 2 else r * 1e-13
        found = quadric_roots(quadric_setup(tuple(f), r, f_error), tuple(d), 0.0)
        fx, dx = ([Fraction(float(x)) for x in v] for v in (f, d))
        a, b = sum(x * x for x in dx), sum(x * y for x, y in zip(fx, dx, strict=True))
        inside = (Fraction(r) ** 2 - sum(x * x for x in fx)) * a + b * b  # a quarter of the discriminant
        assert not (found.met and inside <= 0) and not (found.missed and inside >= 0)
        away = abs(float(inside / a)) / (r * r)  # of the squared radius
        if f_error == 0.0:
            said["met"] += found.met
            said["missed"] += found.missed
            said["neither"] += not (found.met or found.missed)
            assert found.met or found.missed or away < 1e-14 * (1.0 + (f @ f) / (r * r)) * 10.0
        elif not (found.met or found.missed):
            assert away < 1e-11 * (1.0 + np.linalg.norm(f) / r)
    assert min(said.values()) > 40, said


@pytest.mark.parametrize("f", [(-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)])
def test_roots_are_known_where_the_larger_one_is_known_to_half_of_itself(f):
    """q = b +- sqrt(a within), 3 in length here; its error is stated by `b_error`."""
    setup, d = quadric_setup(f, 1.0, 0.0), (1.0, 0.0, 0.0)
    for b_error, met in ((1e-3, True), (1.4999, True), (1.5001, False), (2.9, False), (3.1, False), (9.0, False)):
        found = quadric_roots(setup._replace(b_error=b_error), d, 0.0)
        assert (found.met, found.missed) == (met, False)


def known_without_a_branch(a, b, c, d) -> bool:
    return fast_barycentrics(a, b, c, d)[0]


def known_from_the_shear(a, b, c, d) -> bool:
    """Whether they are not those of an edge-on triangle, which depend on t: it is 0 here, and so another point."""
    return barycentrics(a, b, c, d, 0.0) != barycentrics_edge_on(a, b, c, (0.0, 0.0, 0.0))


def smallest_known(known, of_height) -> float:
    """The least height, up to rounding, of a triangle whose barycentrics are known from its sheared corners."""
    low, high = 0.0, 1.0
    assert known(*of_height(high)) and not known(*of_height(low))
    for _ in range(60):
        middle = math.sqrt(low * high) if low else high * 1e-6
        low, high = (low, middle) if known(*of_height(middle)) else (middle, high)
    return high


@pytest.mark.parametrize("known", [known_without_a_branch, known_from_the_shear])
@pytest.mark.parametrize("far", [1.0, 2.0**12])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("corner", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
def test_barycentrics_are_known_where_the_area_is_beyond_its_error_by_the_largest_coordinate(
    known, far, axis, corner, side
):
    """Flat triangles around a ray, whose largest coordinate is of one corner, along one side, where the ray leans."""
    wide, lean = 8.0, 2.0**-6
    others = [k for k in range(3) if k != corner]

    def of_height(height):
        flat = np.zeros((3, 2))
        flat[corner, side] = -wide
        flat[others, side] = 1.0, 0.5
        flat[others[0], 1 - side] = height
        d = np.array([0.0, 0.0, 1.0])
        d[side] = lean
        corners, d = np.column_stack([flat, np.zeros(3)]) + far * d, np.roll(d, axis - 2)
        turned = np.roll(corners, axis - 2, axis=1)
        return (*(tuple(each.tolist()) for each in turned), tuple(d.tolist()))

    error = SHEAR_ERROR * max(wide - lean * far, far)
    limit = 2.0 * (12.0 * wide * error + 6.0 * error * error + 15.0 * U * wide * wide)
    area = smallest_known(known, of_height) * (wide + 0.5)  # base times height: twice the triangle's
    assert area == pytest.approx(limit, rel=1e-6, abs=0.0)


def test_a_ray_is_none_where_any_number_is_not_finite_or_no_direction_is_there():
    o, d = np.zeros((6, 3)), np.ones((6, 3))
    for bad in (np.nan, np.inf, -np.inf):
        for rows in (o, d):
            for axis in range(3):
                rows[3, axis], kept = bad, rows[3, axis]
                assert find_invalid_ray(o, d, 0, 6) == 3 and find_invalid_ray(o, d, 4, 6) == ALL_IN_RANGE
                assert find_invalid_ray(o, d, 0, 3) == ALL_IN_RANGE
                rows[3, axis] = kept
    assert find_invalid_ray(o, d, 0, 6) == ALL_IN_RANGE
    d[4] = 0.0
    assert find_invalid_ray(o, d, 0, 6) == 4
    for length, expected in ((5e-324, OUT_OF_RANGE), (1e300, OUT_OF_RANGE), (-1.0, ALL_IN_RANGE)):
        d[4] = (0.0, length, 0.0)
        assert find_invalid_ray(o, d, 0, 6) == expected


def test_a_disk_is_hit_or_missed_for_every_input_within_its_errors_and_both_occur():
    prims = prims_of(Disk(to_world=PLACED))
    m, f, _, _ = prepare(prims, load(prims, 0), (0.0, 0.0, 0.0))
    to_object = np.array(m)
    rng, said = np.random.default_rng(161), {"hit": 0, "missed": 0}
    for _ in range(600):
        e = np.array([*rng.uniform(-1.5, 1.5, 2), -1.0]) * rng.uniform(0.3, 2.0)
        f = np.array([*rng.uniform(-1.1, 1.1, 2), 0.0]) - rng.uniform(0.2, 3.0) * e
        d = np.linalg.solve(to_object, e)
        f_error, e_off = 10.0 ** rng.uniform(-8.0, -1.0, (2, 3)) * (rng.random((2, 3)) < 0.6)
        steps = e_off * np.abs(d).sum()
        t, error = intersect(prims, (m, tuple(f), tuple(f_error), tuple(e_off)), tuple(d), 0.0, math.inf)
        if t == 0.0:
            continue
        said["missed" if t == math.inf else "hit"] += 1
        for _ in range(MOVED):
            a_f, a_e = f + f_error * rng.choice([-1, 1], 3), e + steps * rng.choice([-1, 1], 3)
            at = -a_f[2] / a_e[2]
            rho = math.hypot(*(a_f + at * a_e)[:2])
            assert rho >= 1.0 - SLACK if t == math.inf else rho <= 1.0 + SLACK
            assert t == math.inf or abs(at - t) <= error + SLACK * t
    assert min(said.values()) >= 60


def test_a_disk_without_errors_is_decided_up_to_rounding():
    prims = prims_of(Disk(to_world=PLACED))
    m, *_ = prepare(prims, load(prims, 0), (0.0, 0.0, 0.0))
    rng, none = np.random.default_rng(162), (0.0, 0.0, 0.0)
    for _ in range(200):
        f, e = np.array([*rng.uniform(-2.0, 2.0, 2), 1.0]), np.array([*rng.uniform(-1.5, 1.5, 2), -1.0])
        d = np.linalg.solve(np.array(m), e)
        t, error = intersect(prims, (m, tuple(f), none, none), tuple(d), 0.0, math.inf)
        rho = math.hypot(*(f + e)[:2])
        if abs(rho - 1.0) > 1e-12:
            assert (t == math.inf) == (rho > 1.0) and error < 1e-14
            assert t == math.inf or t == pytest.approx(1.0, abs=1e-14)


def test_a_plane_or_disk_whose_slope_is_beyond_float64_is_left_to_exact_arithmetic():
    """It is hit at t = 2^-7: a height of 2^1023 over a slope of 2^1030."""
    n, d, height, limits, none = ((0.0, 0.0, 2.0**1000), (0.0, 0.0, 2.0**30), 2.0**1023, (2.0**-9, 1.0), (0.0,) * 3)
    plane, disk = prims_of(Plane(normal=(0.0, 0.0, 1.0), offset=0.0)), prims_of(Disk())
    assert intersect(plane, (n, height, 0.0, 0.0), d, *limits) == UNDECIDED
    rows = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), n
    assert intersect(disk, (rows, (0.25, 0.5, -height), none, none), d, *limits) == UNDECIDED


def test_a_cylinder_is_clipped_for_every_height_within_its_errors():
    rng, said = np.random.default_rng(163), {"inside": 0, "outside": 0}
    for _ in range(600):
        t, error, f_error, e_off = rng.uniform(0.1, 4.0), *(10.0 ** rng.uniform(-7.0, -1.0, 3))
        e, z = rng.uniform(-2.0, 2.0), rng.uniform(-0.5, 1.5)
        f = z - t * e
        found, found_error = clip_to_height((t, error), (f, f_error, e, e_off))
        if found == 0.0:
            assert min(abs(z), abs(1.0 - z)) <= 4.0 * (f_error + t * e_off + abs(e) * error)
            continue
        said["outside" if found == math.inf else "inside"] += 1
        assert (found, found_error) in ((t, error), (math.inf, 0.0))
        for step in np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T:
            height = f + f_error * step[0] + (t + error * step[1]) * (e + e_off * step[2])
            assert (0.0 <= height <= 1.0) == (found == t)
    assert min(said.values()) >= 60
    assert clip_to_height((math.inf, 0.0), (0.5, 0.0, 0.0, 0.0))[0] == math.inf  # a miss stays one


@pytest.mark.parametrize("axis", [0, 1])
def test_the_wall_of_a_prepared_cylinder_is_off_by_both_coordinates_across(axis):
    """One coordinate is stretched by 1000, along the axis by 1/1000: the height's own error cannot stand for it."""
    prims = prims_of(Cylinder(radius=0.4, to_world=PLACED))
    center, m = load(prims, 0)[0], np.diag([1e-3] * 3)
    m[axis, axis] = 1e3
    rows = tuple(map(tuple, m))
    found = prepare(prims, (center, rows, 0.0, 0.0), tuple(np.array(center) + 1.0))
    exact = quadric_setup(found.wall.f, 1.0, 0.0)
    assert found.wall.moved - exact.moved > 1e5 * found.height_error > 0.0
    assert found.wall.f == (m[0, 0], m[1, 1], 0.0) and found.height == m[2, 2]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plane_is_hit_for_every_input_within_its_errors(axis):
    n = [0.0, 0.0, 0.0]
    n[axis] = 1.0
    prims = prims_of(Plane(normal=tuple(n), offset=2.0))
    found = prepare(prims, load(prims, 0), (0.5, 0.25, -0.125))
    point = load(prims, 0)[1]
    away = np.abs(np.array(point) - [0.5, 0.25, -0.125]).sum()
    assert found[3] >= 5.0 * 2.0**-53 and found[2] >= 5.0 * 2.0**-53 * away > 0.0
    rng, hits = np.random.default_rng([169, axis]), 0
    for _ in range(300):
        d = rng.normal(size=3)
        height, (height_error, slope_error) = rng.uniform(-3.0, 3.0), 10.0 ** rng.uniform(-7.0, -1.0, 2)
        pre = (tuple(n), height, height_error, slope_error)
        t, error = intersect(prims, pre, tuple(d), 0.0, math.inf)
        if 0.0 < t < math.inf:
            hits += 1
            for up in (-1, 1):
                for more in (-1, 1):
                    slope = d[axis] + more * slope_error * np.abs(d).sum()
                    assert abs((height + up * height_error) / slope - t) <= error + SLACK * t
    assert hits >= 60
    d = tuple(np.roll([0.25, 0.5, 0.25], axis - 1).tolist())  # an error of more than half of the slope says nothing
    for share, known in ((0.9, False), (0.501, False), (0.499, True)):
        pre = (tuple(n), 1.0, 0.0, share * 0.5)  # slopes are 0.5, for a d whose components have a sum of 1
        assert (intersect(prims, pre, d, 0.0, math.inf)[0] > 0.0) == known
        t, _ = intersect(prims, pre, d, 10.0, math.inf)  # 2 at the least slope's own, 20 where it is 0.05
        assert t == (math.inf if known else 0.0)


@pytest.mark.parametrize("any_hit", [False, True])
def test_rays_of_a_packet_that_go_singly_hit_what_brute_force_does(any_hit):
    rng = np.random.default_rng(172)
    camera = Fisheye(eye=(0.0, 0.0, 0.0), look_at=(0.0, 0.0, 1.0))
    balls = [Sphere(center=tuple(rng.uniform(-3.0, 3.0, 3)), radius=rng.uniform(0.1, 0.5)) for _ in range(70)]
    (kind,) = pack(Scene(film={"width": 8, "height": 6}, camera=camera, shapes=balls)).kinds
    tree, singly, brute = bvh_of(kind), new_tile(), new_tile()
    count, workspace = 32, (np.zeros(STACK_SIZE, np.int32), np.empty(STACK_SIZE), np.empty(CHILDREN))
    for i in range(count):
        o, d = 4.0 * rng.normal(size=3), rng.normal(size=3)
        d = d - 0.4 * o
        if i % 8 == 3:  # at the first one, from close by
            d, first = moved(rng, np.zeros(3), 1.0), balls[0]
            o = np.array(first.center) - 1.01 * first.radius * d
        for tile in (singly, brute):
            start_ray(tile, lane(i), (tuple(o), tuple(d), 0.0, math.inf))
    for first in range(0, count, LANES):
        cast_rays_singly(kind.prims, tree, 5, singly, lane(first), workspace, any_hit)
    cast_packets_brute_force(kind.prims, len(balls), 5, count, brute, any_hit)
    met = brute[int(T) : int(T) + count] < math.inf
    assert 4 <= met.sum() < count
    assert ((singly[int(T) : int(T) + count] < math.inf) == met).all()
    if not any_hit:
        for field in (T, T_ERROR, PRIM, UNCERTAIN):
            part = slice(int(field), int(field) + count)
            assert singly[part].tobytes() == brute[part].tobytes()
    assert (singly[int(PRIM) : int(PRIM) + count][met] >= 5.0).all()
    assert any_hit or (brute[int(PRIM) : int(PRIM) + count] == 5.0).any()


def test_the_permanent_is_the_cross_product_of_magnitudes_with_every_minus_a_plus():
    rng = np.random.default_rng(164)
    for _ in range(20):
        a, b = rng.normal(size=(2, 3))
        p, q = np.abs(a), np.abs(b)
        expected = [p[i - 2] * q[i - 1] + p[i - 1] * q[i - 2] for i in range(3)]
        assert permanent(tuple(a), tuple(b)) == pytest.approx(expected, rel=1e-15)


def whole_lanes(start, stop):
    return start - start % LANES, stop + -stop % LANES


def test_the_part_of_a_span_in_a_tile_is_what_both_hold():
    rng = np.random.default_rng(165)
    for _ in range(60):
        x, y = np.sort(rng.integers(0, 400, (2, 2)), axis=1) + np.array([0, 1])
        box = 128, 64, 256, 128
        pixels = np.array([[0, 0, 0, 0], [x[0], y[0], x[1], y[1]]], np.int32)
        start, stop = whole_lanes(max(x[0] - 128, 0), min(x[1], 256) - 128)
        expected = start, max(y[0] - 64, 0), stop, min(y[1], 128) - 64
        assert tuple(map(int, bounds_in_tile(pixels, 1, box))) == expected


class Projected(NamedTuple):
    """What `row_bounds` reads of the bounds of triangles."""

    faces: np.ndarray
    projected: np.ndarray


def test_the_part_of_a_row_holds_what_lies_in_a_triangle_and_little_else():
    rng, inside = np.random.default_rng(166), 0
    faces = np.array([[0, 0, 0], [2, 0, 1]], np.int32)
    box, whole = (128, 64, 256, 128), (0, 0, 128, 64)
    for _ in range(150):
        corners = np.array([128.0, 64.0]) + rng.uniform([-40.0, -20.0], [170.0, 90.0], (3, 2))
        wide = float(rng.choice([0.0, 0.3, 4.0]))
        bounds = Projected(faces, np.column_stack([corners, [[wide, 1.0]] * 3]))
        y = int(rng.integers(64))
        start, stop = row_bounds(bounds, 1, box, whole, y)
        across = []  # where the edges are met by the row, or by lines within `wide` of it
        for line in np.linspace(-wide, wide, 5) + 64 + y + 0.5:
            for a, b in zip(corners, np.roll(corners, 1, axis=0), strict=True):
                if min(a[1], b[1]) <= line <= max(a[1], b[1]):
                    across.append(a[0] + (line - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
        if not across:
            continue
        low, high = min(across) - wide - 128, max(across) + wide - 128
        held = [x for x in range(128) if low <= x + 0.5 <= high]
        inside += bool(held)
        if held:
            first, last = whole_lanes(held[0], held[-1] + 1)
            assert start <= held[0] and stop > held[-1]
            assert start >= max(whole_lanes(held[0] - 2, 0)[0], 0) or wide > 0.0
            assert stop <= whole_lanes(0, held[-1] + 3)[1] or wide > 0.0
            assert (start, stop) >= (0, 0) and first >= 0 and last <= 128
    assert inside >= 40
    unknown = Projected(faces, np.full((3, 4), math.inf))
    assert tuple(row_bounds(unknown, 1, box, (8, 0, 96, 64), 5)) == (8, 96)


def test_a_node_takes_the_children_of_its_largest_until_it_is_full():
    """A chain: box k holds the leaf k + 1 and the box k + 2, and the first is the largest that is left."""
    links = np.full((41, 2), -1, np.int32)  # second child, or -1 - ...; first leaf
    boxes = np.zeros((41, 6), np.float32)
    for k in range(0, 39, 2):
        links[k] = k + 2, -1
        boxes[k] = 0, 0, 0, *([50.0 - k] * 3)
        links[k + 1] = 0, 1
        boxes[k + 1] = 0, 0, 0, 60.0, 60.0, 60.0  # a leaf is not opened, however large it is
    links[40] = 0, 1
    inside = np.zeros(CHILDREN, np.int64)
    assert open_largest(boxes, links, inside) == CHILDREN
    assert sorted(inside) == [*range(1, 2 * CHILDREN - 2, 2), 2 * CHILDREN - 2]
    few = np.zeros(CHILDREN, np.int64)
    few[0] = 36
    assert open_largest(boxes, links, few) == 3 and sorted(few[:3]) == [37, 39, 40]
    one = np.full(CHILDREN, 40, np.int64)
    assert open_largest(boxes, links, one) == 1


def test_the_normal_of_an_ellipsoid_is_that_of_its_matrix():
    prims = prims_of(Sphere(to_world=PLACED))
    to_object, center = np.linalg.inv(prims.to_world[0]), prims.center[0]
    rng = np.random.default_rng(167)
    for _ in range(40):
        q = moved(rng, np.zeros(3), 1.0)
        o = center + 6.0 * rng.normal(size=3)
        d = center + prims.to_world[0] @ q - o
        expected = to_object.T @ q
        found = normal(prims, 0, tuple(o), tuple(d), 1.0)
        assert found == pytest.approx(expected / np.linalg.norm(expected), abs=1e-10)


@pytest.mark.parametrize("minor", [1.0, 1.0 + 1e-15, 2.0])
def test_a_torus_without_a_hole_is_refused(minor):
    assert Torus(minor_radius=1.0 - 1e-15).minor_radius < 1.0
    with pytest.raises(SceneError, match=r"minor_radius must be < major_radius 1.0, got"):
        Torus(minor_radius=minor)


@pytest.mark.parametrize("fov", [30.0, 180.0, 250.0, 300.0])
def test_the_bend_of_a_fisheye_bounds_second_derivatives_beyond_its_film_as_well(fov):
    """Along great circles, by differences; up to MAX_HULL_ANGLE outside of the film."""
    bend = Fisheye(eye=(0.0, 0.0, 0.0), look_at=(0.0, 0.0, 1.0), fov=fov).pack(80, 60).bend
    rng, step, most = np.random.default_rng(168), 1e-3, 0.0
    limit = math.radians(fov) / 2.0 + MAX_HULL_ANGLE

    def place(d):
        angle = math.atan2(math.hypot(d[0], d[1]), d[2])
        return angle * np.array(d[:2]) / math.hypot(d[0], d[1])

    for _ in range(400):
        angle, turn = limit * rng.uniform(0.8, 0.995), rng.uniform(0.0, math.pi)
        p = np.array([math.sin(angle), 0.0, math.cos(angle)])
        v = np.array([math.cos(angle) * math.cos(turn), math.sin(turn), -math.sin(angle) * math.cos(turn)])
        before, at, after = (place(p * math.cos(s) + v * math.sin(s)) for s in (-step, 0.0, step))
        most = max(most, float(np.linalg.norm(before - 2.0 * at + after)) / step**2)
    assert most <= bend * (1.0 + 1e-2) and (bend <= 3.0 * most or fov < 60.0)


def aov(**changed):
    declared = {"NAME": "an aov", "CHANNELS": ("an.aov",), "DTYPE": np.float64, "MISS": 0.0, "NEEDS": ()}
    return SimpleNamespace(**{**declared, "PREVIEW": "gray", "evaluate": lambda hit: 0.0, **changed})


@pytest.mark.parametrize("changed", [{"DTYPE": np.float32}, {"DTYPE": np.int64}, {"CHANNELS": ()}])
def test_an_aov_of_another_type_or_without_channels_is_refused(changed):
    with pytest.raises(ValueError, match="DTYPE must be float64 or int32, and CHANNELS not empty"):
        register(aov(**changed))


@pytest.mark.parametrize(
    "changed", [{"NAME": "depth"}, {"CHANNELS": ("new.X", "depth.Z")}, {"CHANNELS": ("A",)}, {"CHANNELS": ("R",)}]
)
def test_an_aov_whose_name_or_channel_is_taken_is_refused(changed):
    with pytest.raises(ValueError, match=r"this name or one of its channels .* is taken"):
        register(aov(**changed))


@pytest.mark.parametrize("name", ["NAME", "CHANNELS", "DTYPE", "MISS", "NEEDS", "PREVIEW", "evaluate"])
def test_an_aov_that_does_not_declare_all_is_refused(name):
    incomplete = aov()
    delattr(incomplete, name)
    with pytest.raises(ValueError, match=f"does not declare {name}"):
        register(incomplete)
    with pytest.raises(ValueError, match=r"needs \['what'\]; known are "):
        register(aov(NEEDS=("normal", "what")))


def test_the_class_of_an_aov_belongs_to_the_module_that_declares_it():
    for each in AOVS:
        assert type(kernel_of(each.NAME)).__module__ == each.__name__
        assert getattr(each, type(kernel_of(each.NAME)).__name__) is type(kernel_of(each.NAME))


def at_the_rim(prims, rng, q, tangent, length):
    """A ray whose line touches an image of a unit shape at q, but for so little that rounding decides."""
    center, to_world = prims.center[0], prims.to_world[0]
    q = q * (1.0 + rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-16.0, -11.0))
    d = to_world @ tangent
    d *= length / np.abs(d).sum()
    return tuple(center + to_world @ q - rng.uniform(1.0, 9.0) / length * d), tuple(d)


def through_an_edge(prims, rng, length):
    """The same of a point of an edge of a triangle, or so near to one."""
    a, b, c = prims.vertices[prims.faces[0]][rng.permutation(3)]
    aside = rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-15.0, -10.0)
    o = 5.0 * rng.normal(size=3)
    d = a + rng.uniform(0.1, 0.9) * (b - a) + aside * (c - a) - o
    return tuple(o), tuple(d * (length / np.abs(d).sum()))


RIMS = {
    "ellipsoid": Sphere(to_world=PLACED),
    "cylinder": Cylinder(to_world=PLACED),
    "triangle": Triangle(vertices=((0, 0, 1), (3, 0.5, 0), (1, 2, 0.25)), to_world=PLACED),
}


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("name", RIMS)
def test_a_line_is_sure_to_miss_just_where_its_intersection_is_a_miss(name, length):
    """At rims, where error bounds decide, for directions of any length; and exact arithmetic finds no hit there."""
    prims, rng, said = prims_of(RIMS[name]), np.random.default_rng(173), {True: 0, False: 0}
    for _ in range(400):
        if name == "triangle":
            o, d = through_an_edge(prims, rng, length)
        else:
            turn, rise = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-1.0, 1.0)
            q, tangent = (math.cos(turn), math.sin(turn), 0.0), (-math.sin(turn), math.cos(turn), 0.05 * rise)
            if name == "ellipsoid":
                q, tangent = rng.permutation(np.stack([q, tangent]), axis=1)
                tangent -= (tangent @ q) * q
            else:
                q = (*q[:2], 0.5)
            o, d = at_the_rim(prims, rng, np.array(q), np.array(tangent), length)
        pre = prepare(prims, load(prims, 0), o)
        missed = surely_misses(prims, pre, d)
        assert missed == (intersect(prims, pre, d, -1e9, 1e9) == (math.inf, 0.0))
        assert not (missed and exact_intersect(prims, 0, o, d, -1e9, 1e9).hit)
        said[missed] += 1
    assert min(said.values()) > 60


def test_a_disk_is_decided_at_its_rim_as_exact_arithmetic_decides_in_every_direction():
    """Rays across it, up to some units of float64 from the rim: only what x^2 + y^2 - 1 rounds is in between."""
    prims, rng, none = prims_of(Disk()), np.random.default_rng(174), (0.0, 0.0, 0.0)
    rows, said = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), {"hit": 0, "missed": 0, "neither": 0}
    for _ in range(6000):
        x = float(rng.uniform(-0.7, 0.7))
        y = math.copysign(math.sqrt(1.0 - x * x) + rng.integers(-12, 13) * 2.0**-53, rng.normal())
        x, y = (x, y) if rng.random() < 0.5 else (y, x)
        t, error = intersect(prims, (rows, (x, y, 1.0), none, none), (0.0, 0.0, -1.0), 0.0, math.inf)
        beyond = Fraction(x) ** 2 + Fraction(y) ** 2 - 1
        if error == math.inf:
            said["neither"] += 1
            assert abs(beyond) <= 16 * Fraction(2) ** -53
        else:
            said["missed" if t == math.inf else "hit"] += 1
            assert (t == math.inf) == (beyond > 0)
    assert min(said.values()) > 300, said
