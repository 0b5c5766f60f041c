"""The judge composes to_world independently and detects errors in the caster's matrix."""

import math
from typing import Any

import numpy as np
import pytest
from places import scene_of

from caster.shapes import Disk, Sphere
from mitsuba_ref.error_model.independent_transform import angle_weighted_normals, transform_error_ratio
from mitsuba_ref.judge.checks.shapes import check_placement

TURN = {"rotate": {"axis": [1.0, 2.0, 3.0], "degrees": 50.0}}
MOVE = {"translate": [0.3, -0.7, 1.9]}
STRETCH = {"scale": [1.0, 2.0, 3.0]}
LOOK = {"look_at": {"origin": [1, 2, 3], "target": [0.1, 0.2, -4], "up": [0, 1, 0.1]}}
ROWS = {"matrix": [[1, 0.5, 0, 2], [0, 2, 0.1, 0], [0.3, 0, -1, 1], [0, 0, 0, 1]]}
STEPS = (TURN, MOVE, STRETCH, LOOK, ROWS)


def placed(matrix: np.ndarray, steps: Any) -> Any:
    """A disk with these steps whose caster came to that matrix."""

    class Misplaced(Disk):
        @property
        def matrix(self) -> np.ndarray:
            return matrix

    return Misplaced(to_world=steps)


def random_steps(rng: np.random.Generator) -> list[dict[str, Any]]:
    def one() -> dict[str, Any]:
        v = rng.normal(size=3) * 10.0 ** rng.uniform(-3, 3)
        return [
            {"translate": v},
            {"scale": np.where(np.abs(v) > 1e-6, v, 1.0)},
            {"rotate": {"axis": v, "degrees": rng.uniform(-1000.0, 1000.0)}},
            {"look_at": {"origin": v, "target": v + rng.normal(size=3), "up": rng.normal(size=3)}},
            {"matrix": np.vstack([rng.normal(size=(3, 4)), [0, 0, 0, 1]])},
        ][rng.integers(5)]

    return [one() for _ in range(rng.integers(1, 6))]


def test_both_sides_agree_on_random_steps():
    rng = np.random.default_rng(120)
    shares = np.array([transform_error_ratio(Disk(to_world=random_steps(rng))) for _ in range(500)])
    assert shares.max() <= 1.0
    assert np.median(shares) > 1e-3  # not vacuous: they do round differently


@pytest.mark.parametrize("step", STEPS, ids=lambda step: next(iter(step)))
def test_one_entry_off_by_a_billionth_is_detected(step):
    shape = Disk(to_world=[step])
    matrix = shape.matrix.copy()
    matrix[0, 0] += 1e-9
    assert transform_error_ratio(placed(matrix, [step])) > 1e3


def test_the_check_names_the_shape():
    shapes = [Sphere(), Disk(to_world=[TURN]), placed(np.eye(4), [MOVE]).model_copy(update={"name": "lid"})]
    scene = scene_of(*shapes[:2])
    assert check_placement(scene).ok
    broken = scene.model_copy(update={"shapes": tuple(shapes)})
    assert check_placement(broken).what == "to_world of lid" and not check_placement(broken).ok


FAR = [{"translate": [0, 100, 0]}, {"translate": [0, -96, 0]}, {"scale": [2, 3, -6]}]


@pytest.mark.parametrize(
    ("steps", "sizes", "norm"),
    [
        ([{"scale": [2, -3, 6]}], [[2, 0, 0, 0], [0, 3, 0, 0], [0, 0, 6, 0]], 7.0),
        ([{"translate": [9, 0, -1]}], [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 1]], 3.0**0.5),
        (FAR, [[2, 0, 0, 0], [0, 3, 0, 588], [0, 0, 6, 0]], 7.0),
    ],
)
def test_a_matrix_may_be_off_by_four_roundings_of_each_step_and_of_the_identity(steps, sizes, norm):
    """Of the product of the steps' magnitudes there, and of the length of the linear part."""
    exact = Disk(to_world=steps).matrix
    for i in range(3):
        for j in range(4):
            off = 4.0 * (1 + len(steps)) * (sizes[i][j] + norm)
            matrix = exact.copy()
            matrix[i, j] += math.ldexp(off, -20)
            assert transform_error_ratio(placed(matrix, steps)) == pytest.approx(2.0**33, rel=1e-9)
    assert transform_error_ratio(placed(exact, steps)) == 0.0


def test_normals_that_cancel_have_no_bound():
    both = np.array([[0, 1, 2], [0, 2, 1]])
    _, size = angle_weighted_normals(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), both)
    assert np.isinf(size).all()


def test_a_face_without_area_changes_no_expected_normal():
    """A vertex of such faces alone gets the x axis."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 2], [3, 3, 3]])
    faces = [[0, 1, 2]], [[0, 1, 2], [0, 0, 1], [3, 3, 3]]
    alone, beside = (angle_weighted_normals(corners, np.array(each))[0] for each in faces)
    assert np.array_equal(alone, beside) and alone[3].tolist() == [1.0, 0.0, 0.0]
