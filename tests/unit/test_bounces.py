"""Secondary rays: known paths, origins against rational numbers, and rays that rounding leaves undecided."""

from fractions import Fraction

import numpy as np
import pytest

from caster import Directional, Glass, Mirror, Panorama, Plane, Point, Scene, Sphere
from caster.geometry.packing import packed
from caster.geometry.world_space import as_float32
from caster.rendering.bounces import CRITICAL, GRAZING, RAY_KINDS, bounces, spawn
from caster.rendering.hits import trace
from mitsuba_ref.subjects.bounce_films import bounce_films

MATERIALS = {"mirror": Mirror(), "glass": Glass(ior=1.25)}
CAMERA = Panorama(eye=(0, 0, 5), direction=(0, 0, -1))
FLOOR = Plane(offset=0.0, material="glass")


def scene_of(*shapes, lights=()):
    return Scene(camera=CAMERA, shapes=shapes, materials=MATERIALS, lights=lights)


def paths(scene, o, d, depth=1):
    """The bounces of rays of float32 values."""
    o, d = (np.atleast_2d(np.asarray(a, float)) for a in (o, d))
    first = trace(scene, o, d, np.full(len(o), np.inf), np.zeros(len(o)), rounded=as_float32)
    return list(bounces(first, depth))


def kinds_of(bounce):
    return [RAY_KINDS[kind] for kind in bounce.rays.kind]


def test_a_ray_into_glass_is_reflected_and_refracted_and_totally_reflected_on_its_way_out():
    """Angles of the triangle 3-4-5: sin 0.8 outside is 0.64 within, and sin 0.96 within is beyond the critical 0.8."""
    (into,) = paths(scene_of(FLOOR), (0, 0, 3), (4, 0, -3))
    assert kinds_of(into) == ["reflected", "refracted"]
    np.testing.assert_allclose(into.rays.d, [[0.8, 0, 0.6], [0.64, 0, -np.sqrt(1 - 0.64**2)]], atol=1e-7)
    (within,) = paths(scene_of(FLOOR), (0, 0, -7), (24, 0, 7))
    assert kinds_of(within) == ["reflected"] and not within.left_out


@pytest.mark.parametrize(
    ("d", "why", "kinds"),
    [((4, 0, 3), CRITICAL, ["reflected"]), ((2.0**40, 0, 1), GRAZING, [])],
    ids=["critical", "grazing"],
)
def test_rays_that_rounding_leaves_undecided_are_counted(d, why, kinds):
    ball = Sphere(center=(0, 0, -9), material="mirror")
    (found,) = paths(scene_of(FLOOR, ball), [(0, 0, -3), (0, 0, -3)], [d, (0, 0, -1)])
    assert kinds_of(found) == [*kinds, "reflected"] and found.left_out == {why: 1}


def test_shadow_rays_end_at_the_lights_in_front():
    lights = [Point(position=(0, 3, 4), intensity=(1, 1, 1)), Directional(direction=(0, 0, 1), irradiance=(1, 1, 1))]
    (found,) = paths(scene_of(Plane(offset=0.0), lights=lights), (0, 0, 1), (0, 0, -1), depth=3)
    assert kinds_of(found) == ["shadow"]
    np.testing.assert_allclose([*found.rays.d[0], found.rays.t_max[0]], [0, 0.6, 0.8, 5.0], rtol=1e-6)


SPHERES = [(0.0, 1.0), (1000.0, 1.0), (-3.0, 0.01), (1e5, 3.0), (0.5, 1e4), (1e-3, 1e-6)]


@pytest.mark.parametrize(("center", "radius"), SPHERES)
def test_origins_are_on_their_side_of_a_sphere_exactly_and_no_farther_than_a_few_roundings(center, radius):
    rng = np.random.default_rng(5)
    sphere = Sphere(center=as_float32(np.array([center, -0.3 * center, 0.1 * center])), radius=radius, material="glass")
    scene = scene_of(sphere)
    middle, r = (a[0] for a in packed(scene, as_float32).parts[0][:2])
    targets = middle + r * rng.normal(size=(200, 3)) / 3.0
    starts = as_float32(middle + 5.0 * r * rng.normal(size=(200, 3)))
    for found in paths(scene, starts, as_float32(targets - starts), depth=3):
        hits, parent = found.parents, found.rays.parent
        points = (hits.rays.o + hits.nearest.t[:, None] * hits.rays.d)[parent]
        outside = np.einsum("ij,ij->i", found.rays.d, hits.normal[parent]) > 0.0
        for q, out in zip(found.rays.o.tolist(), outside, strict=True):
            beyond = sum((Fraction(a) - Fraction(float(c))) ** 2 for a, c in zip(q, middle, strict=True))
            assert (beyond > Fraction(float(r)) ** 2) == out
        step = np.spacing(np.abs(points).max(axis=1).astype(np.float32)).astype(float)
        assert (np.linalg.norm(found.rays.o - points, axis=1) <= 4.0 * step).all()


def test_no_offset_is_added_where_nothing_is_rounded():
    p, up = np.array([[1024.0, 2.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    q = spawn(p, up, -up, np.zeros((1, 3)))
    assert (q[:, :2] == p[:, :2]).all() and -1e-44 < q[0, 2] < 0.0


def test_the_first_ray_of_each_pixel_is_at_it_and_the_others_follow():
    scene = scene_of(Sphere(material="glass"), lights=[Point(position=(0, 9, 0), intensity=(1, 1, 1))])
    scene = scene.with_film(width=12, height=10, crop=(2, 1, 10, 8)).with_camera(eye=(0, 0, 1.5))
    for film in bounce_films(scene, 3):
        assert len(np.unique(film.row)) == len(film.row) and film.place == (2, 1, 7)
        assert film.scene.film.width == 8
        seen = set()
        for pixel, row in zip(film.bounce.rays.pixel.tolist(), film.row.tolist(), strict=True):
            assert film.pixel(row % 8, row // 8) == (2 + pixel % 8, 1 + pixel // 8)
            assert (row == pixel) == (pixel not in seen) and (row < 56) == (row == pixel)
            seen.add(pixel)
