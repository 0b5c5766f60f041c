"""Which rays belong to a fan."""

import math

import numpy as np
import pytest

from caster.kernels.bvh.fans import Fan
from caster.kernels.bvh.ray_sorting import count_strays
from caster.kernels.nearest import Rays

ORIGIN = (1.0, -2.0, 4.0)
NOWHERE = (0.0, 0.0, 0.0)
AXES = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
BACK = (0.5, -0.25, 1.0)
POINT_FAN = Fan(1.0, ORIGIN, NOWHERE, *AXES, 100.0, 0.0)
PARALLEL_FAN = Fan(0.0, NOWHERE, BACK, *AXES, 100.0, 0.0)


def is_in_fan(fan, o, d, t_max, outward, deviation=0.0):
    rays = Rays(np.tile(o, (4, 1)).astype(float), np.tile(d, (4, 1)).astype(float), np.zeros(4), np.full(4, t_max))
    strays = count_strays(fan, rays, outward, deviation, 1, 4)
    assert strays in (0, 3)
    return strays == 0


def test_rays_belong_to_a_fan_that_start_at_its_origin_or_have_its_direction():
    assert is_in_fan(POINT_FAN, ORIGIN, (0.5, -3.0, 1.0), 0.0, True)
    assert is_in_fan(POINT_FAN, NOWHERE, (0.5, -3.0, 1.0), -1.0, True)  # there is no ray
    assert is_in_fan(PARALLEL_FAN, (7.0, 8.0, 9.0), BACK, 5.0, False)
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
