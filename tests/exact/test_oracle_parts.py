"""Parts of the oracle by themselves, against matrices of Fractions and lists: each number, not only who is hit."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from mitsuba_ref.oracle import exact_quadrics
from mitsuba_ref.oracle.exact_numbers import integer_ray, scaled
from mitsuba_ref.oracle.interface import OutsideDomain, TieSet, check_rays


def exact(rows) -> list[Fraction]:
    return [Fraction(float(x)) for x in rows]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_ray_in_object_space_is_the_one_that_its_matrix_brings_back(seed, mirrored):
    """M (o + s d) / size + center is the ray again, with t = s 2^e: exactly, of either handedness and any scale."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, 3)) * 2.0 ** rng.integers(-30, 30)
    if (np.linalg.det(matrix) < 0.0) is not mirrored:
        matrix[0] *= -1.0
    prims = SimpleNamespace(center=rng.normal(size=(2, 3)), to_world=np.stack([np.eye(3), matrix]))
    o, d = (
        rng.normal(size=3) * 2.0 ** rng.integers(-20, 20),
        rng.normal(size=3) * 2.0 ** rng.integers(-20, 20),
    )
    affine = exact_quadrics.prepare_affine(prims, 1)
    ray = exact_quadrics.to_object_space(affine, integer_ray(o.tolist(), d.tolist()))
    assert affine.determinant > 0 and ray.size > 0
    columns = [exact(row) for row in matrix]
    center, given_o, given_d = exact(prims.center[1]), exact(o), exact(d)
    for i in range(3):
        at = sum(columns[i][j] * Fraction(ray.o[j], ray.size) for j in range(3)) + center[i]
        along = sum(columns[i][j] * Fraction(ray.d[j], ray.size) for j in range(3)) / Fraction(2) ** ray.e
        assert (at, along) == (given_o[i], given_d[i])


def test_numbers_are_scaled_to_the_coarsest_power_of_two_that_holds_them():
    for numbers in ([1.0, 3.0, -8.0], [0.75, -0.0, 2.5], [5e-324, 1.0, 1e300], [0.0, 0.0, 0.0]):
        integers, k = scaled(numbers)
        assert [Fraction(n, 2**k) for n in integers] == exact(numbers) and k >= 0
        assert k == 0 or any(n % 2 for n in integers)


GROUPS = [("edge", np.array([4, 9])), ("inside", np.array([2])), ("vertex", np.array([3, 5, 7]))]
SORTED = [(2, "inside"), (3, "vertex"), (4, "edge"), (5, "vertex"), (7, "vertex"), (9, "edge")]


def test_ties_are_in_the_order_of_their_primitives_whatever_their_groups():
    for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2)):
        ties = TieSet("t", [GROUPS[i] for i in order])
        assert [(hit.prim, hit.where) for hit in ties] == SORTED and len(ties) == 6
        assert [(ties[i].prim, ties[i].where) for i in range(-6, 6)] == SORTED * 2
        assert [hit.prim for hit in ties[1:4]] == [3, 4, 5] and ties.prims.tolist() == [2, 3, 4, 5, 7, 9]
        assert {hit.t for hit in ties} == {"t"} and ties[0].t == ties[1].t == "t"
    with pytest.raises(IndexError):
        TieSet("t", GROUPS)[6]


@pytest.mark.parametrize("boxes", ["affine_boxes", "disk_boxes", "cylinder_boxes"])
def test_boxes_hold_every_corner_and_little_more(boxes):
    """Corners in Fractions: none lies outside, and each side touches one up to a few units in the last place."""
    rng = np.random.default_rng(5)
    prims = SimpleNamespace(center=rng.normal(size=(20, 3)), to_world=rng.normal(size=(20, 3, 3)))
    heights = {"affine_boxes": (-1, 1), "disk_boxes": (0,), "cylinder_boxes": (0, 1)}[boxes]
    low, high = getattr(exact_quadrics, boxes)(prims)
    for k in range(20):
        columns, center = [exact(row) for row in prims.to_world[k]], exact(prims.center[k])
        for i in range(3):
            ends = [
                center[i] + x * columns[i][0] + y * columns[i][1] + z * columns[i][2]
                for x in (-1, 1) for y in (-1, 1) for z in heights
            ]  # fmt: skip
            slack = Fraction(2) ** -44
            assert min(ends) - slack < Fraction(low[k, i]) <= min(ends)
            assert max(ends) <= Fraction(high[k, i]) < max(ends) + slack


def test_affine_primitives_with_a_number_that_is_none_are_left_out():
    prims = SimpleNamespace(center=np.zeros((4, 3)), to_world=np.tile(np.eye(3), (4, 1, 1)))
    prims.center[1, 2], prims.to_world[2, 0, 1] = np.nan, np.inf
    assert exact_quadrics.usable_affine(prims).tolist() == [True, False, False, True]


RAYS = [
    ({}, None),
    ({"o": (np.inf, 0.0, 0.0)}, "o = [inf, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = 0.0, t_max = inf"),
    ({"d": (0.0, np.nan, 1.0)}, "o = [0.0, 0.0, 0.0], d = [0.0, nan, 1.0], t_min = 0.0, t_max = inf"),
    ({"d": (0.0, -0.0, 0.0)}, "o = [0.0, 0.0, 0.0], d = [0.0, -0.0, 0.0], t_min = 0.0, t_max = inf"),
    ({"t_min": np.nan}, "o = [0.0, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = nan, t_max = inf"),
    ({"t_max": np.nan}, "o = [0.0, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = 0.0, t_max = nan"),
    ({"t_min": -np.inf, "t_max": -1.0, "d": (0.0, 5e-324, 0.0)}, None),
]


@pytest.mark.parametrize(("change", "said"), RAYS)
def test_a_ray_outside_of_the_domain_is_named_with_its_numbers(change, said):
    """The second and the third of four are the same."""
    plain = {"o": (0.0, 0.0, 0.0), "d": (0.0, 0.0, 1.0), "t_min": 0.0, "t_max": np.inf}
    rows = {
        name: np.array([plain[name], *[(plain | change)[name]] * 2, plain[name]], float) for name in plain
    }
    if said is None:
        check_rays(**rows)
        return
    with pytest.raises(OutsideDomain) as error:
        check_rays(**rows)
    must = "ray 1: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got "
    assert str(error.value) == must + said
