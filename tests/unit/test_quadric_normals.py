"""Both functions for the normal of a sphere give the same bits."""

import numpy as np
import pytest

from caster.kernels.math.quadric_roots import fast_outward_normal, outward_normal
from caster.kernels.math.vec import fast_unit_direction, unit_direction


def test_both_ways_to_a_normal_round_a_tiny_component_alike():
    """A component of 2^-1060 after, but not before, it is divided by r: to scale it twice rounds it twice."""
    rng = np.random.default_rng(150)
    for _ in range(500):
        r, tiny = 2.0 ** rng.uniform(80, 97), rng.uniform(1, 2) * 2.0 ** rng.uniform(-990, -960)
        across = rng.normal(size=2)
        y, z = (across / np.linalg.norm(across)).tolist()
        f = (-tiny, -3.0 * r * y + 0.2 * r * z, -3.0 * r * z - 0.2 * r * y)
        d = 0.0, y, z
        known, n = fast_outward_normal(f, d, fast_unit_direction(d), 2.0 * r, r)
        assert known and n == outward_normal(f, d, unit_direction(d), 2.0 * r, r)


@pytest.mark.parametrize("d", [(0.0, 0.0, 1.0), (-0.6, 0.0, 0.8), (0.0, 0.8, -0.6)])
@pytest.mark.parametrize("r", [1e-200, 1.3e-310, 5e-324])
def test_a_sphere_too_small_for_a_square_has_its_normals_along_a_ray_through_its_centre(d, r):
    """Against the ray where it is met first; along it where t is sure to be beyond the centre."""
    far = 2.0**600
    f = tuple(-far * x for x in d)
    assert outward_normal(f, d, d, far, r) == tuple(-x for x in d)
    assert outward_normal(f, d, d, far * (1.0 + 2.0**-40), r) == d
