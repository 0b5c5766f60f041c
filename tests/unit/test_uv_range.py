"""A fraction of a turn lies in [0, 1), and the judge accepts no other from us."""

import math

import numpy as np
import pytest

from caster.kernels.math.angles import turn_fraction
from mitsuba_ref.shapes import KINDS

# Of kinds whose uv have a seam: which of u and v is the fraction of a turn.
SEAMS = {"Spheres": 0, "Ellipsoids": 0, "Cylinders": 0, "Disks": 1}
ALLOWED, BEYOND = (0.0, 0.5, math.nextafter(1.0, 0.0)), (-5e-324, -0.25, 1.5, math.inf, math.nan)


@pytest.mark.parametrize("y", [0.0, -0.0, 5e-324, -5e-324, 1e-20, -1e-20, 1e-16, -1e-16, 1.0, -1.0])
@pytest.mark.parametrize("x", [1.0, -1.0, 0.0, 1e-3, 1e300])
def test_a_fraction_of_a_turn_is_never_1(x, y):
    turn = turn_fraction(y, x)
    assert 0.0 <= turn < 1.0
    apart = abs(turn - math.atan2(y, x) / (2.0 * math.pi)) % 1.0
    assert min(apart, 1.0 - apart) <= 2.0**-52  # an angle of at most pi within 2^-50 of itself, over 2 pi


@pytest.mark.parametrize("name", SEAMS)
def test_the_judge_has_no_point_for_another_number(name):
    """1 is allowed of Mitsuba, whose float32 2 pi - epsilon is 2 pi."""
    (kind,) = (each for each in KINDS.values() if each.name == name)
    prims = type("Prims", (), {"turn": np.eye(3)[None]})
    every = np.array([*ALLOWED, 1.0, *BEYOND])
    uv = np.full((len(every), 2), 0.5)
    uv[:, SEAMS[name]] = every
    place = np.zeros(len(every), int)
    ours, theirs = (space(prims, place, uv) for space in (kind.model.uv.subject, kind.model.uv.reference))
    fits, fits_theirs = (np.isfinite(points).all(axis=1).tolist() for points in (ours, theirs))
    assert fits == [True] * 3 + [False] * 6
    assert fits_theirs == [True] * 4 + [False] * 5
    assert np.allclose(theirs[3], ours[0], atol=1e-15), "a whole turn is none"
