"""The float64 filter with exact decisions gives the hits of exact arithmetic for every primitive."""

import numpy as np
import pytest
from hard_rays import hard_rays
from places import scene_of
from random_scenes import name, random_scene

from caster.cameras import Pinhole
from caster.rendering.bvh_construction import bvh_of, uses_bvh
from caster.rendering.casting import exact_nearest, find_nearest
from caster.rendering.hits import cast, packed, validated_rays
from caster.rendering.images import film_window, render, trace_film
from caster.rendering.rasterization import bin_kinds
from caster.scene.model import Film, Scene
from caster.shapes import SHAPES, Cube, Cylinder, Disk, Icosphere, Plane, Sphere, Triangle

FEW = 12  # rays of a family


SMALL = [shape for shape in SHAPES if name(shape) in ("sphere", "plane", "triangle", "disk", "cube", "cylinder")]


def test_doubt_settled_for_all_rays_changes_no_bit():
    """Rays of which float64 is certain keep primitive and t, to the bit, when they are decided exactly."""
    rng = np.random.default_rng(91)
    scene = random_scene(rng, SHAPES, Pinhole, count=2)
    for family, (o, d) in hard_rays(packed(scene), rng, 200).items():
        rays = validated_rays(o, d, 0.0, np.inf)
        quick, exact = find_nearest(packed(scene), rays), exact_nearest(packed(scene), rays)
        for a, b in zip(quick, exact, strict=True):
            assert np.array_equal(a, b), family


def test_t_keeps_its_digits_where_scaled_rays_would_lose_them():
    """A triangle with denormal coordinates, hit at exactly 2^-1074 / 1.5 lengths of 2^-1022; found by fuzzing."""
    least = float.fromhex("0x0.0000000000001p-1022")
    triangle = Triangle(vertices=((0.0, 0.0, 1.0), (0.0, -1.0, -1.0), (-least, 1.0, 0.0)))
    hits = cast(scene_of(triangle), [[0, 0, 0]], [[-(2.0**-1022), 0, 0]])
    assert hits.t[0] == float.fromhex("0x1.5555555555555p-54")


def test_of_many_identical_primitives_the_first_is_hit():
    """A thousand equal triangles, by brute force and through a tree: the lowest number wins."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    scene = scene_of(*(Triangle(vertices=corners) for _ in range(1000)))
    o = np.column_stack([np.linspace(0.01, 0.4, 50), np.linspace(0.4, 0.01, 50), np.ones(50)])
    o[::2] += 5.0
    rays = validated_rays(o, np.tile([0.0, 0.0, -1.0], (50, 1)), 0.0, np.inf)
    for trees in (False, True):
        hits = exact_nearest(packed(scene), rays, trees=trees)
        assert (hits.prim == np.where(np.arange(50) % 2, 0, -1)).all()
        bvh_of(packed(scene).kinds[0])


@pytest.mark.parametrize("shape", [Plane(normal=(0, 0, 1), offset=0.0), Sphere(), Cube(), Cylinder()])
def test_nothing_lies_beyond_an_infinite_t_min(shape):
    """Rays that start on the surface: float64 cannot decide at t = 0, and with t_min = inf nothing may be hit."""
    scene = scene_of(shape)
    o = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
    d = np.array([[0.0, 1.0, 5e-324], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 5e-324]])
    assert (cast(scene, o, d, t_min=np.inf).shape_id == -1).all()
    assert (cast(scene, o, d, t_min=7.0, t_max=7.0).shape_id == -1).all()
    assert (cast(scene, o - 3.0 * d, d).shape_id == 0).sum() >= 2


def test_a_hit_nearer_than_the_smallest_float64_is_a_hit():
    """t is about 2^-1127: its error bound rounds to 0, and t itself to the least positive float64."""
    tiny = float.fromhex("0x0.0000000000002p-1022")
    corners = np.array([[8.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 1.0, -tiny]])
    scene = scene_of(Triangle(vertices=corners))
    along = np.array([[8.0 * tiny, 0.0, -(2.0**53)], [8.0 * tiny, 0.0, 2.0**53]])
    hits = cast(scene, np.zeros((2, 3)), along)
    assert hits.shape_id.tolist() == [0, -1] and hits.t[0] == np.nextafter(0.0, 1.0)


@pytest.mark.parametrize("shape", [Plane(normal=(0, 0, 1), offset=0.0), Sphere(), Cube(), Cylinder(), Disk()])
@pytest.mark.parametrize("length", [1e160, 1e250, 1e300])
def test_directions_whose_squares_overflow_hit_what_they_should(shape, length):
    """A denormal component keeps `cast` from bringing d to length 1; the tree is asked, too."""
    scene = scene_of(*5 * [shape])
    o = np.array([[0.25, 0.25, 2.0], [5.0, 0.25, 2.0], [0.25, 3.0, 0.5]])
    d = length * np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, -0.35], [0.0, -1.0, 0.0]])
    long, plain = cast(scene, o, np.where(d == 0.0, 5e-324, d)), cast(scene, o, d)
    assert (long.shape_id == plain.shape_id).all() and (plain.shape_id == 0).sum() >= 1
    assert np.allclose(long.t * length, plain.t * length, rtol=1e-12, atol=0)


def test_two_ellipsoids_whose_inverses_round_alike_are_two():
    """Their transforms differ by one ulp; the second shape is nearer, so this is no tie."""
    wide = [Sphere(to_world={"scale": [x, 1.0, 1.0]}) for x in (1.9, np.nextafter(1.9, 2.0))]
    scene = scene_of(*wide)
    prims = packed(scene).kinds[0].prims
    assert (prims.to_object[0] == prims.to_object[1]).all() and (prims.to_world[0] != prims.to_world[1]).any()
    assert cast(scene, [[3.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]).shape_id.tolist() == [1]


def test_t_is_known_where_squares_of_short_directions_and_small_spheres_underflow():
    ball = Sphere(radius=1.1 * 2.0**-285)
    scene = scene_of(ball)
    o = np.array([[-1.3 * 2.0**-284, 0.3 * 2.0**-285, 0.0]])
    rays = validated_rays(o, np.array([[1.2 * 2.0**-250, 0.0, 0.0]]), 0.0, np.inf)
    exact = (2.6 - (1.1**2 - 0.3**2) ** 0.5) / 1.2 * 2.0**-35  # all lengths times 2^285
    for culling in ("brute-force", "bvh"):
        assert np.isclose(find_nearest(packed(scene), rays, culling).t[0], exact, rtol=1e-14, atol=0)


def test_a_corner_nearer_than_the_inverse_of_the_largest_number_is_in_the_image():
    corners = [(0, 0, 1e-310), (1, 0, 1.1), (1, 0.5, 1)]
    eye = Pinhole(eye=(0, 0, 0), look_at=(0, 0, 1), up=(0, 1, 0), fov=90)
    scene = Scene(camera=eye, film=Film(width=32, height=32), shapes=[Triangle(vertices=corners)])
    seen = [render(scene, ("hit",), culling=culling).hit.sum() for culling in ("raster", "brute-force")]
    assert seen[0] == seen[1] > 50


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e160, 1e307])
def test_trees_are_left_alone_where_they_leave_float64(size):
    balls = [Sphere(center=(size * (1.0 + 0.1 * i), 0.1 * size, 0.0), radius=0.05 * size) for i in range(6)]
    scene = scene_of(*balls)
    hits = cast(scene, [[-size, 0.1 * size, 0.0]], [[1.0, 0.0, 0.0]])
    assert hits.shape_id.tolist() == [0] and np.isclose(hits.t[0], 1.95 * size, rtol=1e-3)
    assert not uses_bvh(packed(scene).kinds[0])


def test_what_lies_behind_the_eye_is_looked_for_nowhere():
    scene = Scene(camera=Pinhole(eye=(0.1, 0.2, 0.3), look_at=(9, 1, 0)), shapes=[Icosphere(subdivisions=4)])
    (kind,) = bin_kinds(packed(scene), scene.camera.pack(256, 256), film_window(scene), 1.0)
    bounds = kind.bounds.pixels
    nowhere = ((bounds[:, 0] >= bounds[:, 2]) | (bounds[:, 1] >= bounds[:, 3])).mean()
    assert nowhere > 0.8 and (trace_film(scene).hit).all()


@pytest.mark.parametrize("shape", SMALL, ids=name)
@np.errstate(all="ignore")  # of kernels in plain Python
def test_a_hit_at_an_end_of_the_range_lies_within_the_range(shape):
    """Exact arithmetic decides there, and t is rounded into the ray's range."""
    rng, at_ends = np.random.default_rng([91, SHAPES.index(shape)]), 0
    scene = random_scene(rng, [shape], Pinhole, count=2)
    for o, d in hard_rays(packed(scene), rng, FEW).values():
        ends = cast(scene, o, d).t
        for i in np.flatnonzero(np.isfinite(ends) & (ends > 0.0)):
            for t_min, t_max in ((0.0, ends[i]), (ends[i], np.inf), (np.nextafter(ends[i], 0.0), ends[i])):
                found = cast(scene, o[i : i + 1], d[i : i + 1], t_min=t_min, t_max=t_max).t[0]
                assert t_min < found <= t_max or np.isinf(found)
                at_ends += bool(np.isfinite(found))
    assert at_ends > 10
