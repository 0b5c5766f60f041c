"""Parts of the oracle against Fractions: every number, not only which primitive is hit."""

from types import SimpleNamespace

import numpy as np
import pytest
from oracle_aims import triangles

from caster.geometry.packing import Kind
from caster.shapes.sphere import Spheres
from mitsuba_ref.oracle.oracle import Oracle, part_of


def test_the_roots_of_each_primitive_are_its_own_wherever_others_are_nowhere():
    """Faces at the heights of their numbers, and two spheres, in two arrays whose numbers alternate."""
    square = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    faces = triangles(np.stack([square + np.array([0, 0, k]) for k in (1, 3, 5, 6)]))
    faces.vertices[3 * 1 + 2, 0] = faces.vertices[3 * 3, 1] = np.nan  # the faces 3 and 6
    balls = Spheres(np.array([[0.0, 0, 0], [0, 0, 2], [0, 0, 4]]), np.full(3, 0.25), np.zeros((3, 3, 3)))
    kinds = (Kind(faces, np.array([1, 3, 5, 6])), Kind(balls, np.array([0, 2, 4])))
    for order in (kinds, kinds[::-1]):
        oracle = Oracle(SimpleNamespace(kinds=order, first=np.array([0, 7])))
        for prim in range(7):
            found = oracle.roots(prim, (0.5**9, 0.0, -1.0), (0.0, 0.0, 2.0))
            heights = [] if prim in (3, 6) else [prim] if prim % 2 else [prim - 0.25, prim + 0.25]
            assert [float(hit.t) for hit in found] == pytest.approx([(z + 1.0) / 2.0 for z in heights], abs=1e-4)
            assert all(hit.prim == prim for hit in found)
        for wrong in (-1, 7):
            with pytest.raises(IndexError):
                oracle.roots(wrong, (0.0, 0.0, -1.0), (0.0, 0.0, 2.0))


def test_identical_rows_are_gathered_by_the_numbers_of_their_primitives():
    radius, ids = np.array([4.0, 1, 4, 3, 1, 5, 4, 3]), np.array([4, 8, 9, 2, 1, 7, 0, 5])
    part = part_of(Spheres(np.zeros((8, 3)), radius, np.zeros((8, 3, 3))), ids)
    assert {k: part.numbers(k).tolist() for k in (0, 1, 3, 5)} == {0: [0, 4, 9], 1: [1, 8], 3: [2, 5], 5: [7]}
    other = part_of(Spheres(np.zeros((8, 3)), 1.0 + np.arange(8), np.zeros((8, 3, 3))), ids)
    assert other.numbers(2).tolist() == [9]
