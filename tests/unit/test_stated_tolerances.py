"""Tolerances and thresholds of the judge, stated a second time: a larger one excuses more, and nothing fails.

Beside them the helpers that every ratio of an error to its bound goes through.
"""

import math
from importlib.util import module_from_spec
from typing import Any

import numpy as np
import pytest

from caster.description.errors import SceneError
from mitsuba_ref.error_model import bounds, intersections, lambert, tolerances
from mitsuba_ref.error_model.bounds import error_over_bound, nearest_root, row_distance
from mitsuba_ref.error_model.scene_model import PairIntersections
from mitsuba_ref.error_model.tolerances import Tolerances
from mitsuba_ref.shapes import cylinder, plane, shape_reference, sphere, surface_errors

TOLERANCES = {
    "U32": 1 / 2**24,
    "K": 4,
    "KU": 1 / 2**22,
    "KU_OURS": 1 / 2**50,
    "LARGEST_Z": 5,
    "MIN_GROUPS": 26,
    "LARGEST_USEFUL_NORMAL_ERROR": 1 / 16,
    "MATCH_RTOL": 1 / 10000,
    "DISTINCT_RTOL": 1 / 1000,
    "MAJORITY": 1 / 2,
    "FIT_FACTOR": 2,
    "LARGEST_RESIDUAL": 1 / 100,
    "NEARLY_ALL": 9 / 10,
    "MIN_FITTED_PIXELS": 3,
    "SEPARATES": 95 / 100,
    "SEPARATOR_CHANCE": 1 / 10**6,
    "CAMERA_ROUNDINGS": 8,
    "TRANSFORM_ROUNDINGS": 16,
    "SIMILARITY_ROUNDINGS": 144,
    "FILE_NORMAL_ROUNDINGS": 8,
    "FILE_UV_ROUNDINGS": 2,
    "DEPTH_RTOL": 12 / 2**24,
    "NORMAL_ATOL": 36 / 2**24,
    "COLOR_RTOL": 16 / 2**24,
    "TYPICAL_ATOL": 4 / 2**24,
    "LARGEST_FIRST_ORDER_SHARE": 1 / 2,
    "LARGEST_RAY_SHIFT_PIXELS": 2,
    "HALF_ROUNDINGS": 2,
    "U_HALF": 1 / 2**11,
    "SMALLEST_HALF": 1 / 2**24,
}
OTHERS = [
    (bounds, {"T_ROUNDING_ULPS": 1, "UNDERFLOW_BOUND": 2.0**-1010, "DEPTH_ULPS": 4, "UNIT_LENGTH_ATOL": 1 / 2**49}),
    (
        lambert,
        {
            "LARGEST_DIRECTION_ERROR": 1 / 2, "MAX_UNCERTAIN_LIGHTS": 8, "RAY_EPSILON": 1500 / 2**24,
            "SHADOW_EPSILON": 15000 / 2**24,
        },
    ),
    (intersections, {"LARGEST_COORDINATE": 1.844e18, "SAME_NORMAL_TOLERANCE": 1 / 4096}),
    (surface_errors, {"UNRESOLVABLE": 1 / 2, "TURN": 2 * math.pi}),
    (plane, {"AXES_ERROR": 8, "LARGEST_PATCH_COORDINATE": 1e10, "PATCH_RINGS": 24, "SMALLEST_HALF_SIDE": 2.0**-60}),
    (cylinder, {"LARGEST_SHEAR": 1e-6, "SHEAR_ROUNDING": 8 / 2**24, "LARGEST_HANDED_CONDITION": 2.0**20}),
    (sphere, {"TURN_ERROR": 3**0.5, "UNIFORM_SCALE_RTOL": 8 / 2**24}),
    (shape_reference, {"ROUNDING_INTERVAL_FRACTION": 1 - 1 / 2**20}),
]  # fmt: skip


def constants(module: Any) -> dict[str, Any]:
    """As the module makes them when it is loaded: a copy, so that the test runs those lines."""
    copy = module_from_spec(module.__spec__)
    module.__spec__.loader.exec_module(copy)
    assert vars(copy).keys() >= {name for name in vars(module) if name.isupper()}
    return {name: value for name, value in vars(copy).items() if name.isupper()}


def test_every_tolerance_is_the_stated_number():
    found = constants(tolerances)
    assert found == pytest.approx(TOLERANCES, rel=1e-15, abs=0.0)


@pytest.mark.parametrize(("module", "numbers"), OTHERS, ids=lambda each: getattr(each, "__name__", "").split(".")[-1])
def test_every_limit_of_an_error_model_is_the_stated_number(module, numbers):
    found = constants(module)
    assert {name: found[name] for name in numbers} == pytest.approx(numbers, rel=1e-15, abs=0.0)


def test_a_tolerance_is_not_negative_and_there_is_none_unless_it_is_given():
    names = ("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol", "max_pixels")
    plain = Tolerances()
    assert [getattr(plain, name) for name in names] == [None] * 5 + [0]
    assert (plain.ignore, plain.allow_empty, plain.other_scene) == ((), False, False)
    for name in names:
        assert getattr(Tolerances(**{name: 0}), name) == 0 and getattr(Tolerances(**{name: 1}), name) == 1
        for wrong in (-1, -1e-300, math.inf, math.nan):
            with pytest.raises(SceneError, match=f"^--{name.replace('_', '-')}: expected a number >= 0, got "):
                Tolerances(**{name: wrong})


INF, NAN = math.inf, math.nan


@pytest.mark.parametrize(
    ("error", "bound", "share"),
    [
        (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), (1.0, 2.0, 0.5), (3.0, 2.0, 1.5), (1e-300, 0.0, INF), (1.0, INF, INF),
        (0.0, INF, INF), (0.0, NAN, INF), (NAN, 1.0, INF), (INF, 1.0, INF), (INF, INF, INF), (1.0, NAN, INF),
        (1e300, 1e-300, INF),
    ],
)  # fmt: skip
def test_an_error_over_a_bound_is_infinite_where_either_is_no_number(error, bound, share):
    assert error_over_bound(np.array([error]), np.array([bound])).tolist() == [share]


def test_a_distance_of_rows_is_none_where_either_has_a_number_that_is_not_finite():
    a = np.array([[0.0, 3, 0], [INF, 0, 0], [0, 0, 0], [0, NAN, 0], [INF, 0, 0], [1e300, 0, 0], [0, 0, -INF]])
    b = np.array([[4.0, 0, 12], [0, 0, 0], [0, 0, -INF], [0, 0, 0], [INF, 0, 0], [-1e300, 0, 0], [0, 0, INF]])
    expected = [13.0, NAN, NAN, NAN, NAN, INF, NAN]
    for one, other in ((a, b), (b, a)):
        assert np.array_equal(row_distance(one, other), expected, equal_nan=True)
    assert row_distance(a[:, :2], b[:, :2])[0] == 5.0


def met(pair, t) -> PairIntersections:
    """Intersections that are known by their t alone."""
    numbers, flags = np.array(t, float), np.ones(len(t), bool)
    rows = np.tile(numbers[:, None], 3)
    at = bounds.Intersections(
        numbers, numbers, rows, numbers, rows, numbers, flags, flags, numbers, rows, numbers, np.tile(rows, 2), numbers
    )
    return PairIntersections(np.array(pair), at)


@pytest.mark.parametrize(
    ("pair", "roots", "t", "expected"),
    [
        ([0, 1], [5.0, 7.0], [1.0, 1.0], [5.0, 7.0]),
        ([0, 1, 0, 1], [1.0, 2.0, 4.0, 8.0], [2.4, 5.1], [1.0, 8.0]),
        ([1, 0, 1, 0], [1.0, 2.0, 4.0, 8.0], [2.4, 2.6], [2.0, 4.0]),
        ([0, 0, 1, 1], [NAN, 9.0, 9.0, NAN], [1.0, 1.0], [9.0, 9.0]),
        ([0, 0, 1, 1], [-3.0, 3.5, 3.5, -3.0], [INF, 0.0], [-3.0, -3.0]),
        ([1, 0], [3.0, 6.0], [0.0, 0.0], [6.0, 3.0]),
    ],
)
def test_the_nearest_root_of_each_pair_is_taken_in_the_order_of_the_pairs(pair, roots, t, expected):
    assert nearest_root(met(pair, roots), np.array(t)).t.tolist() == expected
    assert len(nearest_root(met([], []), np.zeros(0)).t) == 0


def test_what_is_not_hit_has_no_number_that_could_be_held_to():
    missing = bounds.missing_intersections(2)
    numbers = [a for a in missing if a is not None and a.dtype == float]
    assert all(np.isposinf(a).all() and len(a) == 2 for a in numbers) and len(numbers) == 9
    assert not missing.possible.any() and not missing.certain.any() and missing.edge is missing.side is None
    assert missing.n.shape == missing.sh_n.shape == missing.uv.shape == (2, 3)
