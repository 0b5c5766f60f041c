"""Irradiance from each light, in Mitsuba's units."""

import math

import numpy as np
import pytest

from caster.cameras import Pinhole
from caster.kernels.surface.lighting import light_at, received_irradiance, shadow_ray
from caster.rendering.images import render
from caster.scene.model import Ambient, Directional, Film, Point, Scene
from caster.shapes import Cylinder, Disk, Rectangle, Sphere

POINTS = [(0.0, 0.0, 0.0), (3.0, 0.0, 4.0), (1.0, 2.0, 3.0)]


def test_a_point_light_fades_with_the_squared_distance():
    light = Point(position=[0, 0, 2], intensity=[4, 8, 12]).pack()
    assert light_at(light, POINTS[0])[2:] == ((0, 0, 1), (1, 2, 3))
    assert light_at(light, POINTS[1])[3] == pytest.approx(np.array([4, 8, 12]) / 13)
    for p in POINTS:
        assert math.hypot(*light_at(light, p)[2]) == pytest.approx(1, abs=2.0**-51)


def test_the_shadow_ray_of_a_point_light_ends_in_it():
    light = Point(position=[1, 1, 1], intensity=[1, 1, 1]).pack()
    for p in POINTS:
        d, reach, _, _ = light_at(light, p)
        assert np.array_equal(np.array(p) + np.array(d) * reach, np.ones(3))


def test_a_point_in_the_light_itself_gets_nothing_and_no_nan():
    _, _, towards, strength = light_at(Point(position=[1, 2, 3], intensity=[1, 1, 1]).pack(), POINTS[2])
    assert np.isfinite(towards).all() and strength == (0, 0, 0)


def test_a_directional_light_is_the_same_everywhere_and_never_ends():
    sun = Directional(direction=[0, -2, 0], irradiance=[1, 2, 3]).pack()
    for p in POINTS:
        assert light_at(sun, p) == ((0, 1, 0), math.inf, (0, 1, 0), (1, 2, 3))
    slanting = Directional(direction=[2, -3, -6], irradiance=[1, 2, 3]).pack()
    assert light_at(slanting, POINTS[0])[0] == pytest.approx((-2 / 7, 3 / 7, 6 / 7), rel=1e-15)


SUN = Directional(direction=[0, -1, 0], irradiance=[1, 2, 4]).pack()
UP, DOWN, SLANTED = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0)


@pytest.mark.parametrize(
    ("normal", "ray", "two_sided", "lit"),
    [
        (UP, DOWN, False, True),
        (UP, UP, False, False),  # seen from below
        (DOWN, UP, False, False),  # from its front, which is turned away
        (DOWN, DOWN, False, False),  # from behind, where the light is
        (DOWN, DOWN, True, True),
        (DOWN, UP, True, False),
    ],
)
def test_which_side_is_lit(normal, ray, two_sided, lit):
    seen, flux = received_irradiance(SUN, POINTS[1], normal, ray, two_sided)
    assert seen == lit and flux == (1, 2, 4)


def test_slanting_light_gives_its_cosine():
    assert received_irradiance(SUN, POINTS[1], SLANTED, DOWN, False) == (True, (0.8, 1.6, 3.2))


@pytest.mark.parametrize(("normal", "side"), [(UP, 1.0), (DOWN, 1.0), ((1.0, 0.0, 0.0), 0.0)])
def test_a_shadow_ray_starts_on_the_side_of_the_light(normal, side):
    """And by how much: 64 u of what the hit's rounding scales with; from there on everything counts."""
    line = (0.0, 3.0, 0.0), (0.0, -2.0, 0.0), 1.0
    for extent, scale in ((0.0, 3.0 + 2.0 + 1.0), (6.0, 6.0), (1e6, 1e6)):
        o, d, near, reach = shadow_ray(SUN, (0.0, 1.0, 0.0), normal, *line, extent)
        off = 64 * 2.0**-53 * scale
        assert o == (0.0, 1.0 + side * off, 0.0) and d == UP and (near, reach) == (off, math.inf)


STAND = {"rotate": {"axis": [1, 0.05, 0.03], "degrees": -88.7}}
LARGE = {  # each as large as r, its surface 1.7 below the eye
    "sphere": lambda r: Sphere(center=(0, -r, 0), radius=r),
    "ellipsoid": lambda r: Sphere(to_world=[{"scale": [1.3 * r, r, 1.1 * r]}, {"translate": [0, -r, 0]}]),
    "cylinder": lambda r: Cylinder(to_world=[{"scale": [r, r, 9 * r]}, {"translate": [0, -r, -4 * r]}]),
    "disk": lambda r: Disk(to_world=[{"scale": r}, STAND]),
    "rectangle": lambda r: Rectangle(to_world=[{"scale": r}, STAND]),
}


@pytest.mark.parametrize("radius", [1e4, 6.371e6])
@pytest.mark.parametrize("shape", LARGE)
def test_a_large_shape_seen_from_nearby_does_not_shadow_itself(shape, radius):
    eye = Pinhole(eye=(0.0, 1.7, 0.0), look_at=(0.13, 1.3, -3.1), fov=63.1)
    sun = Directional(direction=(-0.31, -0.83, -0.57), irradiance=(2.0, 2.0, 2.0))
    film = Film(width=24, height=24)
    scene = Scene(camera=eye, film=film, lights=[sun], shapes=[LARGE[shape](radius)])
    images = render(scene, ("diffuse", "shading_normal"))
    lit = images.hit & (images["shading_normal"] @ np.array([0.31, 0.83, 0.57]) > 1e-3)
    assert lit.sum() > 200 and (images["diffuse"][lit] > 0.0).all()


def test_the_light_of_several_lamps_adds_up():
    lamps = [
        Point(position=(1.0, 4.0, 1.0), intensity=(4.0, 8.0, 1.0)),
        Point(position=(-2.0, 3.0, 1.5), intensity=(1.0, 2.0, 16.0)),
        Directional(direction=(0.25, -1.0, 0.5), irradiance=(1.0, 0.5, 2.0)),
        Ambient(radiance=(0.25, 0.5, 1.0)),
    ]
    about = {
        "film": Film(width=16, height=12),
        "camera": Pinhole(eye=(0.0, 2.0, 6.0), look_at=(0.0, 0.0, 0.0)),
        "shapes": [Sphere(center=(0.0, 0.5, 0.0), radius=0.75), Rectangle(to_world=LYING)],
    }
    each = [render(Scene(lights=[lamp], **about), ("diffuse",))["diffuse"] for lamp in lamps]
    together = render(Scene(lights=lamps, **about), ("diffuse",))["diffuse"]
    assert all((image > 0.0).any() for image in each)
    assert together == pytest.approx(sum(each), rel=2.0**-50)


LYING = [{"rotate": {"axis": [1, 0, 0], "degrees": -90}}, {"scale": 4}]
