"""What the judge says about a pixel, and quantities that conditions of known defects are of, by their rules."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from mitsuba_ref.judge.comparison import reference_prims
from mitsuba_ref.judge.explanations import QUANTITY_NAMES, exceeded_bounds


@pytest.mark.parametrize(
    ("ratios", "told"),
    [
        ({}, ""),
        ({"t": 1.0, "normal": 0.0}, ""),  # a bound that is just reached is kept
        ({"t": math.nextafter(1.0, 2.0)}, "beyond its bound: {t} 1x"),
        ({"t": 2.5, "normal": 1234.5}, "beyond their bounds: {t} 2.5x, {normal} 1.23e+03x"),
        ({"t": math.inf}, "beyond its bound: {t}"),
        ({"t": math.nan}, "beyond its bound: {t}"),  # what is no number is not within
        ({"exact": math.inf}, "beyond its bound: {exact}"),
        ({"exact": math.inf, "t": 3.0}, "beyond its bound: {t} 3x"),
        ({"exact": 4.0, "t": 3.0}, "beyond their bounds: {exact} 4x, {t} 3x"),
    ],
)
def test_what_exceeds_its_bound_is_reported_with_its_factor(ratios, told):
    names = {name: QUANTITY_NAMES.get(name, name) for name in ("t", "normal", "exact")}
    assert exceeded_bounds(ratios) == told.format(**names)


def test_a_primitive_of_mitsuba_is_counted_in_its_shape_and_of_a_stand_in_is_the_first():
    model = SimpleNamespace(packed=SimpleNamespace(first=np.array([0, 1, 5, 6])))
    shape, prim = np.array([0, 1, 1, 1, 2, 2, -1, 1]), np.array([0, 0, 3, 4, 7, 0, 2, 1])
    hit = np.array([1, 1, 1, 1, 1, 1, 1, 0], bool)
    result = SimpleNamespace(shape_id=shape, hit=hit, answer=SimpleNamespace(prim=prim))
    found = reference_prims(result, model)
    assert found.tolist() == [0, 1, 4, 1, 5, 5, -1, -1] and found.dtype == np.int32
