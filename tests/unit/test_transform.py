"""Transforms: exact where floats allow it, refused where they are singular."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from caster.description import transform
from caster.description.transform import frame, is_invertible, look_at, rotate, scale, unit

U = 2.0**-53
numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).filter(lambda v: max(map(abs, v)) > 1e-3)


def at(matrix, p):
    return (matrix @ [*p, 1.0])[:3]


@pytest.mark.parametrize("quarters", range(-9, 10))
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1)])
def test_quarter_turns_are_exact(axis, quarters):
    matrix = rotate(axis, 90 * quarters)
    assert set(np.abs(matrix).ravel()) == {0.0, 1.0}
    assert np.array_equal(np.linalg.matrix_power(rotate(axis, 90), quarters % 4), matrix)


def test_a_rotation_is_counter_clockwise_seen_from_the_tip_of_its_axis():
    assert at(rotate([0, 0, 1], 90), [1, 0, 0]).tolist() == [0, 1, 0]
    assert at(rotate([1, 0, 0], 90), [0, 1, 0]).tolist() == [0, 0, 1]
    assert at(rotate([0, 1, 0], 90), [0, 0, 1]).tolist() == [1, 0, 0]


@given(vectors, st.floats(-720, 720))
def test_a_turn_keeps_lengths_angles_and_its_axis(axis, degrees):
    matrix = rotate(axis, degrees)[:3, :3]
    assert np.abs(matrix @ matrix.T - np.eye(3)).max() <= 32 * U  # products of three roundings, three of them
    assert np.abs(matrix @ unit(axis) - unit(axis)).max() <= 32 * U
    assert np.linalg.det(matrix) > 0


def test_look_at_brings_z_to_the_target_and_y_up():
    matrix = look_at([1, 2, 3], [1, 2, 8], [0, 1, 0])
    assert at(matrix, [0, 0, 0]).tolist() == [1, 2, 3]
    assert at(matrix, [0, 0, 5]).tolist() == [1, 2, 8]
    assert at(matrix, [0, 1, 0]).tolist() == [1, 3, 3]
    assert np.linalg.det(matrix[:3, :3]) > 0


@given(vectors, vectors)
def test_a_frame_is_orthonormal_even_where_up_is_nearly_along_the_view(view, up):
    view = unit(view)
    for bend in (1.0, 1e-6, 1e-12):
        leaning = [f + bend * u for f, u in zip(view, unit(up), strict=True)]
        if math.hypot(*transform.cross(view, unit(leaning))) > 1e-14:
            axes = np.array(frame(view, leaning))
            assert np.abs(axes @ axes.T - np.eye(3)).max() <= 16 * U
            right, new_up, forward = axes
            assert np.abs(np.cross(right, forward) - new_up).max() <= 16 * U


@given(vectors)
def test_normalising_twice_changes_no_bit(v):
    once = unit(v)
    assert unit(once) == once
    assert abs(math.hypot(*once) - 1.0) <= transform.UNIT_ATOL


@pytest.mark.parametrize("v", [(5e-324, 0, 0), (1e-310, 1e-310, 0), (1.7e308, 1.7e308, 1.7e308)])
def test_the_smallest_and_largest_vectors_have_a_direction(v):
    assert abs(math.hypot(*unit(v)) - 1.0) <= transform.UNIT_ATOL


@pytest.mark.parametrize("size", [1e-300, 1e-12, 1.0, 1e12, 1e300])
def test_uniform_scales_of_any_size_can_be_undone(size):
    assert is_invertible(scale(size))


@pytest.mark.parametrize(
    "flat", [scale(0), scale([1, 0, 1]), scale([1, 1, 2.0**-52]), scale(1e-320), np.ones((4, 4)) - np.eye(4)[3]]
)
def test_what_float64_cannot_undo_is_singular(flat):
    assert not is_invertible(flat)
