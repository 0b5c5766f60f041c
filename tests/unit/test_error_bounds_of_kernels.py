"""Error bounds of kernels hold for all inputs within their errors."""

import math

import numpy as np
import pytest
from places import scene_of

from caster.geometry.packing import pack
from caster.kernels.math.quadric_roots import quadric_roots, quadric_setup
from caster.kernels.math.vec import UNDECIDED
from caster.kernels.protocol import exact_intersect, intersect, load, prepare, surely_misses
from caster.shapes import Cylinder, Disk, LinearCurve, Plane, Sphere, Triangle
from caster.shapes.cylinder import clip_to_height

SLACK = 1e-9  # of what is computed here in float64, far below the errors that are planted
MOVED = 12  # inputs moved at random, for each that is looked at
PLACED = [{"scale": [0.5, 2.0, 1.0]}, {"rotate": {"axis": [1, 2, 3], "degrees": 50}}, {"translate": [1, 2, 3]}]


def prims_of(shape):
    return pack(scene_of(shape)).kinds[0].prims


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


def hits_exactly(prims, o, d):
    return exact_intersect(prims, 0, o, d, -1e9, 1e9).hit


@pytest.mark.parametrize("grow", [3, -3])
def test_a_ray_along_a_line_of_a_cone_enters_it_at_the_one_root_that_is_left(grow):
    """|P|^2 - dr^2 = 16, |d|^2 = 25 and (d.P)^2 = 400, so that A t^2 + 2 B t + C has A = 0: t = -C / (2 B)."""
    start = 2 if grow > 0 else 5
    prims = prims_of(LinearCurve(points=((0, 0, 0), (0, 0, 5)), radii=(start, start + grow)))
    d, rng, tried, beside = (-3, 0, 4 if grow > 0 else -4), np.random.default_rng(174), 0, 0
    for x, y, z in rng.integers([-9, -4, -9], [10, 5, 15], (1200, 3)).tolist():
        lift = 5 * z + start * grow
        b = 16 * (x * d[0] + z * d[2]) - 5 * d[2] * lift
        c = 16 * (x * x + y * y + z * z - start * start) - lift * lift
        t = -c / (2.0 * b) if b < 0 else -1.0
        if t > 0.0 and 0.01 < lift + 5 * d[2] * t < 15.99:  # within the circles of the cone
            tried += 1
            o, near = (float(x), float(y), float(z)), 1e-12 * t
            assert exact_intersect(prims, 0, o, d, t - near, t + near).hit
            assert not exact_intersect(prims, 0, o, d, 0.0, t - near).hit
        elif b == 0 and c > 0:  # in the plane that touches the cone along that line
            beside += 1
            assert not hits_exactly(prims, (float(x), float(y), float(z)), d)
    assert tried >= 60 and beside >= 5


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
        assert not (missed and hits_exactly(prims, o, d))
        said[missed] += 1
    assert min(said.values()) > 60
