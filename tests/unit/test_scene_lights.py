"""What arrives from each light, in Mitsuba's units."""

import numpy as np
import pytest

from caster.lights import Ambient, Directional, Point

P = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 4.0], [1.0, 2.0, 3.0]])


def test_a_point_light_fades_with_the_squared_distance():
    towards, strength = Point(position=[0, 0, 2], intensity=[4, 8, 12]).towards(P)
    assert towards[0].tolist() == [0, 0, 1] and strength[0].tolist() == [1, 2, 3]
    assert strength[1] == pytest.approx(np.array([4, 8, 12]) / 13)
    assert np.linalg.norm(towards, axis=1) == pytest.approx(1, abs=2.0**-51)


def test_the_shadow_ray_of_a_point_light_ends_in_it():
    d, reach = Point(position=[1, 1, 1], intensity=[1, 1, 1]).shadow_rays(P)
    assert np.array_equal(P + d * reach[:, None], np.ones((3, 3)))


def test_a_point_in_the_light_itself_gets_nothing_and_no_nan():
    towards, strength = Point(position=[1, 2, 3], intensity=[1, 1, 1]).towards(P)
    assert np.isfinite(towards).all() and strength[2].tolist() == [0, 0, 0]


def test_a_directional_light_is_the_same_everywhere_and_never_ends():
    sun = Directional(direction=[0, -2, 0], irradiance=[1, 2, 3])
    towards, strength = sun.towards(P)
    assert np.array_equal(towards, np.tile([0.0, 1.0, 0.0], (3, 1)))
    assert np.array_equal(strength, np.tile([1.0, 2.0, 3.0], (3, 1)))
    d, reach = sun.shadow_rays(P)
    assert np.array_equal(d, towards) and np.isinf(reach).all()


def test_ambient_light_has_no_direction():
    with pytest.raises(NotImplementedError, match="no direction"):
        Ambient(radiance=[1, 1, 1]).towards(P)
