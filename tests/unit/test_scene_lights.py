"""What arrives from each light, in Mitsuba's units."""

import math

import numpy as np
import pytest

from caster.kernels.surface.lighting import (
    incident_irradiance,
    light_direction,
    received_irradiance,
    shadow_ray,
)
from caster.scene.model import Ambient, Directional, Point

P = [(0.0, 0.0, 0.0), (3.0, 0.0, 4.0), (1.0, 2.0, 3.0)]


def test_a_point_light_fades_with_the_squared_distance():
    light = Point(position=[0, 0, 2], intensity=[4, 8, 12]).pack()
    assert incident_irradiance(light, P[0]) == ((0, 0, 1), (1, 2, 3))
    assert incident_irradiance(light, P[1])[1] == pytest.approx(np.array([4, 8, 12]) / 13)
    for p in P:
        assert math.hypot(*incident_irradiance(light, p)[0]) == pytest.approx(1, abs=2.0**-51)


def test_the_shadow_ray_of_a_point_light_ends_in_it():
    light = Point(position=[1, 1, 1], intensity=[1, 1, 1]).pack()
    for p in P:
        d, reach = light_direction(light, p)
        assert np.array_equal(np.array(p) + np.array(d) * reach, np.ones(3))


def test_a_point_in_the_light_itself_gets_nothing_and_no_nan():
    towards, strength = incident_irradiance(Point(position=[1, 2, 3], intensity=[1, 1, 1]).pack(), P[2])
    assert np.isfinite(towards).all() and strength == (0, 0, 0)


def test_a_directional_light_is_the_same_everywhere_and_never_ends():
    sun = Directional(direction=[0, -2, 0], irradiance=[1, 2, 3]).pack()
    for p in P:
        assert incident_irradiance(sun, p) == ((0, 1, 0), (1, 2, 3))
        assert light_direction(sun, p) == ((0, 1, 0), math.inf)


def test_ambient_light_has_no_direction():
    with pytest.raises(NotImplementedError, match="no direction"):
        Ambient(radiance=[1, 1, 1]).pack()


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
    seen, flux = received_irradiance(SUN, P[1], normal, ray, two_sided)
    assert seen == lit and flux == (1, 2, 4)


def test_slanting_light_gives_its_cosine():
    assert received_irradiance(SUN, P[1], SLANTED, DOWN, False) == (True, (0.8, 1.6, 3.2))


@pytest.mark.parametrize(("normal", "side"), [(UP, 1.0), (DOWN, 1.0), ((1.0, 0.0, 0.0), 0.0)])
def test_a_shadow_ray_starts_on_the_side_of_the_light(normal, side):
    """And by how much: 64 u of what the hit's rounding scales with; from there on everything counts."""
    o, d, near, reach = shadow_ray(SUN, (0.0, 1.0, 0.0), normal, (0.0, 3.0, 0.0), (0.0, -2.0, 0.0), 1.0)
    off = 64 * 2.0**-53 * (3.0 + 2.0 + 1.0)
    assert o == (0.0, 1.0 + side * off, 0.0) and d == UP and (near, reach) == (off, math.inf)
