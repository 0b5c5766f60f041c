"""Parts of the oracle against Fractions: every number, not only which primitive is hit."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from oracle_aims import triangles

from caster.geometry.packing import Kind
from caster.shapes.sphere import Spheres
from mitsuba_ref.oracle.oracle import Oracle, RayColumns, identical_groups, slab_test


def exact(rows) -> list[Fraction]:
    return [Fraction(float(x)) for x in rows]


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


def crossing(line, box) -> tuple[Fraction, Fraction] | None:
    """From which t to which a line is within a box, in Fractions; None: nowhere."""
    near = far = None
    for o, d, low, high in zip(*line, *box, strict=True):
        if not d:
            if not low <= o <= high:
                return None
            continue
        ends = sorted([(low - o) / d, (high - o) / d])
        near, far = ((ends[0] if near is None else max(near, ends[0])), (ends[1] if far is None else min(far, ends[1])))
    return None if near > far else (near, far)


def test_a_ray_passes_a_box_as_it_does_in_fractions():
    """On a lattice, where many rays pass along faces and through corners, or begin or end at a box: all that pass, no
    other that misses by more than rounding, and a `near` that is no later and hardly earlier than the box."""
    rng = np.random.default_rng(14)
    n = 4000
    o, d = rng.integers(-4, 5, (n, 3)).astype(float), rng.integers(-2, 3, (n, 3)).astype(float)
    d[~d.any(axis=1), 1] = 1.0
    low = rng.integers(-4, 2, (n, 3)).astype(float)
    high = low + rng.integers(0, 6, (n, 3))
    t_min, t_max = rng.choice([-np.inf, 0.0, 1.0], n), rng.choice([np.inf, np.inf, 2.0, 1.0, -1.0], n)
    rays = RayColumns(o.T, d.T, t_min, t_max)
    crossed, near = slab_test(rays, np.arange(n), low.T, high.T)
    touched = []
    for i in range(n):
        span = crossing((exact(o[i]), exact(d[i])), (exact(low[i]), exact(high[i])))
        inside = span is not None and span[1] > t_min[i] and span[0] <= t_max[i] and t_min[i] <= t_max[i]
        assert not inside or crossed[i], i
        if crossed[i] and not inside:
            touched.append(i)
            assert span is not None and (span[1] == t_min[i] or t_min[i] > t_max[i]), i
        if inside:
            assert near[i] <= span[0] and float(span[0]) - near[i] <= 1e-14 * max(1.0, abs(float(span[0])))
    assert 0.05 < crossed.mean() < 0.5 and touched


def test_identical_rows_are_gathered_by_the_numbers_of_their_primitives():
    lowest, ids = np.array([0, 1, 0, 3, 1, 5, 0, 3]), np.array([4, 8, 9, 2, 1, 7, 0, 5])
    groups, repeated = identical_groups(lowest, ids)
    assert {row: numbers.tolist() for row, numbers in groups.items()} == {0: [0, 4, 9], 1: [1, 8], 3: [2, 5]}
    assert repeated.tolist() == [False, False, True, False, True, False, True, True]
    assert identical_groups(None, ids) == ({}, None)
