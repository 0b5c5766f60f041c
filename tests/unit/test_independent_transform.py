"""The judge composes to_world a second time, and sees what goes wrong in composing it."""

import math
from typing import Any

import numpy as np
import pytest

from caster.scene.model import Scene
from caster.shapes import Disk, Sphere
from mitsuba_ref.error_model.independent_transform import (
    NO_NORMAL,
    angle_weighted_normals,
    compose_transform,
    transform_error_ratio,
    transformed_normals,
)
from mitsuba_ref.judge.scene_checks import check_placement

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


@pytest.mark.parametrize(("first", "then"), [(TURN, MOVE), (STRETCH, TURN), (LOOK, STRETCH), (ROWS, MOVE)], ids=str)
def test_steps_in_the_wrong_order_are_detected(first, then):
    right, wrong = Disk(to_world=[first, then]), Disk(to_world=[then, first])
    assert transform_error_ratio(right) <= 1.0
    assert transform_error_ratio(placed(wrong.matrix, [first, then])) > 1e10


def test_an_axis_that_is_not_normalised_is_detected():
    """Rodrigues' formula on the axis as given shears and stretches."""
    axis, angle = np.array(TURN["rotate"]["axis"]), np.deg2rad(TURN["rotate"]["degrees"])
    cross = np.cross(np.eye(3), axis)
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    assert transform_error_ratio(placed(matrix, [TURN])) > 1e10


@pytest.mark.parametrize("steps", [[TURN], [LOOK], [ROWS]], ids=str)
def test_a_transposed_matrix_is_detected(steps):
    matrix = Disk(to_world=steps).matrix.copy()
    matrix[:3, :3] = matrix[:3, :3].T
    assert transform_error_ratio(placed(matrix, steps)) > 1e10


@pytest.mark.parametrize("step", STEPS, ids=lambda step: next(iter(step)))
def test_one_entry_off_by_a_billionth_is_detected(step):
    shape = Disk(to_world=[step])
    assert np.array_equal(compose_transform(shape.to_world).shape, (4, 4))
    matrix = shape.matrix.copy()
    matrix[0, 0] += 1e-9
    assert transform_error_ratio(placed(matrix, [step])) > 1e3


def test_the_check_names_the_shape():
    shapes = [Sphere(), Disk(to_world=[TURN]), placed(np.eye(4), [MOVE]).model_copy(update={"name": "lid"})]
    camera = {"type": "pinhole", "eye": [0, 0, 9], "look_at": [0, 0, 0], "up": [0, 1, 0]}
    scene = Scene(camera=camera, shapes=shapes[:2])
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
    exact = compose_transform(Disk(to_world=steps).to_world)
    for i in range(3):
        for j in range(4):
            off = 4.0 * (1 + len(steps)) * (sizes[i][j] + norm)
            matrix = exact.copy()
            matrix[i, j] += math.ldexp(off, -20)
            assert transform_error_ratio(placed(matrix, steps)) == pytest.approx(2.0**33, rel=1e-9)
    assert transform_error_ratio(placed(exact, steps)) == 0.0


def test_a_normal_turns_as_a_cross_product_of_turned_edges_does():
    """And is rounded as its three terms are, over its length."""
    rng = np.random.default_rng(121)
    for _ in range(20):
        matrix, u, v = np.eye(4), *rng.normal(size=(2, 5, 3))
        matrix[:3] = rng.normal(size=(3, 4)) * 2.0 ** rng.integers(-20, 20)
        linear, given = matrix[:3, :3], np.cross(u, v)
        found, size = transformed_normals(matrix, given)
        across = np.cross(u @ linear.T, v @ linear.T)  # whichever way it is mirrored, the outside stays outside
        across *= np.sign(np.linalg.det(linear)) / np.linalg.norm(across, axis=1)[:, None]
        assert np.abs(found - across).max() < 1e-11
        lengths = np.linalg.norm(linear, axis=0)
        terms = np.abs(given) @ [lengths[1] * lengths[2], lengths[2] * lengths[0], lengths[0] * lengths[1]]
        turned = np.linalg.norm(np.cross(u @ linear.T, v @ linear.T), axis=1)
        assert size.shape == (5, 1) and size[:, 0] == pytest.approx(terms / turned, rel=1e-9)


def weighted_by_angles(vertices: Any, faces: Any) -> tuple[list[Any], list[float]]:
    """Corner by corner with arc cosines: the sum of angles times normals; angle + 1 / sine, summed, over its length."""
    total, weight = np.zeros((len(vertices), 3)), [0.0] * len(vertices)
    count = [sum(face.count(i) for face in faces) for i in range(len(vertices))]
    for face in faces:
        for j in range(3):
            at, after, before = (np.array(vertices[face[(j + step) % 3]], float) for step in range(3))
            a, b = after - at, before - at
            n = np.cross(a, b)
            if not n.any():
                continue
            lengths = np.linalg.norm(a) * np.linalg.norm(b)
            angle = math.acos(a @ b / lengths)
            total[face[j]] += angle * n / np.linalg.norm(n)
            weight[face[j]] += angle + lengths / np.linalg.norm(n)
    size = [c * w / np.linalg.norm(t) if w else 1.0 for c, w, t in zip(count, weight, total, strict=True)]
    return [t / np.linalg.norm(t) if w else NO_NORMAL for t, w in zip(total, weight, strict=True)], size


ROOF = [[0, 0, 1], [0, 4, 1], [-3, 0, 0], [2, 0, 0], [2, 5, 0], [9, 9, 9]]
ROOF_FACES = [[0, 3, 1], [0, 1, 2], [3, 4, 1]]


@pytest.mark.parametrize("scale", [1.0, 1e-3, 2.0**40])
@pytest.mark.parametrize("more", [[], [[0, 3, 3]], [[5, 5, 5]], [[0, 3, 0], [2, 2, 1], [5, 0, 5]]], ids=str)
def test_normals_are_weighted_by_angles_and_their_size_by_angles_and_slenderness(scale, more):
    """Faces without an area add nothing but to the number of terms; a vertex of none but these has Mitsuba's normal."""
    vertices = (np.array(ROOF) * scale).tolist()
    normals, size = angle_weighted_normals(np.array(vertices), np.array(ROOF_FACES + more))
    expected, sizes = weighted_by_angles(vertices, ROOF_FACES + more)
    assert np.abs(normals - np.array(expected)).max() < 1e-14
    assert size.shape == (6, 1) and size[:, 0] == pytest.approx(sizes, rel=1e-12)
    assert normals[5].tolist() == [1.0, 0.0, 0.0] and size[5, 0] == 1.0


def test_normals_that_cancel_have_no_bound():
    both = np.array([[0, 1, 2], [0, 2, 1]])
    _, size = angle_weighted_normals(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), both)
    assert np.isinf(size).all()
