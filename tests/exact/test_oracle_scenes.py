"""The first hit among many primitives: ties, ranges of t, order, and inputs outside the oracle's domain."""

import math
from collections import Counter
from functools import cmp_to_key
from itertools import product
from types import SimpleNamespace

import numpy as np
import oracle_fractions
import pytest
from oracle_aims import KINDS, SCALES, affine, aim, packed, root_bracket, triangles

from caster.geometry.packing import Kind, primitive_count
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, Spheres
from mitsuba_ref.oracle.oracle import Oracle, OutsideDomain

LEFT = -math.inf
EYE3 = np.eye(3)[None]


def spheres(*rows) -> Spheres:
    """Rows x, y, z, radius."""
    numbers = np.array(rows, np.float64)
    return Spheres(numbers[:, :3], numbers[:, 3], np.zeros((len(rows), 3, 3)))


def expected(arrays, o, d, t_min, t_max):
    """(t, {prim: where}) of the first hit, by trying all."""
    found, first = [], 0
    for prims in arrays:
        for k in range(primitive_count(prims)):
            met = oracle_fractions.roots(prims, k, o, d)
            ahead = [(t, where) for t, where in met if beyond(t, t_min) and not beyond(t, t_max)]
            found += [(*ahead[0], first + k)] if ahead else []
        first += primitive_count(prims)
    if not found:
        return None, {}
    best = min(found, key=cmp_to_key(lambda x, y: oracle_fractions.order(x[0], y[0])))[0]
    return best, {prim: where for t, where, prim in found if oracle_fractions.order(t, best) == 0}


def beyond(t, x):
    """Whether t > x."""
    return x < 0.0 if math.isinf(x) else t.compare(oracle_fractions.F(x)) > 0


def mixed(scale: str, seed: int, n: int):
    """A scene of every kind around one place, and rays at each."""
    aimed = [aim(kind, scale, seed, n) for kind in KINDS]
    arrays = [a.prims for a in aimed]
    return arrays, np.concatenate([a.o for a in aimed]), np.concatenate([a.d for a in aimed])


def scenes(scale: str):
    """Each kind alone, every primitive twice; and all kinds together."""
    for kind, seed in product(KINDS, range(6)):
        prims, o, d = aim(kind, scale, seed, 2)
        yield (prims, prims), o, d
    yield mixed(scale, 4, 3)


def wrong_answers(scale: str, seen: Counter) -> int:
    rng = np.random.default_rng(1)
    return sum(wrong_answers_of(rng, *scene, seen) for scene in scenes(scale))


def wrong_answers_of(rng, arrays, o, d, seen: Counter) -> int:
    oracle, wrong = Oracle(packed(*arrays)), 0
    spans = [(0.0, math.inf), (LEFT, math.inf), (LEFT, math.inf), (0.5, 3.0), (-1.0, 0.0), (2.0**-1074, 1.0)]
    t_min, t_max = np.array([spans[i] for i in rng.integers(0, len(spans), len(o))]).T
    for i, answer in enumerate(oracle.first_hits(o, d, t_min, t_max)):
        t, ties = expected(arrays, o[i], d[i], t_min[i], t_max[i])
        wrong += {hit.prim: hit.where for hit in answer.ties} != ties or answer.prim != min(ties, default=-1)
        wrong += answer.hit != (t is not None)
        wrong += answer.t is not None and (
            t is None or t.compare(root_bracket(answer.t, 300)[0]) < 0 or t.compare(root_bracket(answer.t, 300)[1]) > 0
        )
        seen.update(ties.values() or ["miss"])
        seen["tie"] += len(ties) > 1
    return wrong


def test_the_first_hit_of_all_is_that_of_trying_all_in_fractions():
    seen: Counter = Counter()
    for scale in SCALES:
        assert wrong_answers(scale, seen) == 0, scale
    assert set(seen) >= {"inside", "edge", "vertex", "rim", "tangent", "miss"} and min(seen.values()) >= 5, seen
    assert seen["tie"] >= 100


def test_primitives_keep_their_numbers_wherever_others_are_nowhere():
    """Faces at the heights of their numbers, and three spheres, in two arrays whose numbers alternate."""
    square = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    faces = triangles(np.stack([square + np.array([0, 0, k]) for k in (1, 3, 5, 6)]))
    faces.vertices[3 * 1 + 2, 0] = faces.vertices[3 * 3, 1] = np.nan  # the faces 3 and 6
    kinds = (
        Kind(faces, np.array([1, 3, 5, 6])),
        Kind(spheres(*((0, 0, z, 0.25) for z in (0, 2, 4))), np.array([0, 2, 4])),
    )
    for order in (kinds, kinds[::-1]):
        oracle = Oracle(SimpleNamespace(kinds=order))
        for prim in range(7):
            answer = oracle.first_hit((0.5**9, 0.0, -9.0), (0.0, 0.0, 1.0), prim + 8.5, prim + 9.5)
            assert answer.prims.tolist() == ([] if prim in (3, 6) else [prim])


def test_spans_are_open_at_t_min_and_closed_at_t_max():
    oracle = Oracle(packed(spheres((0, 0, 0, 1))))
    line = (-3, 0, 0), (1, 0, 0)
    assert [oracle.first_hit(*line, t).t for t in (1.9999999999999998, 2.0, 4.0)] == [2, 4, None]
    assert [oracle.first_hit(*line, 0.0, t).t for t in (2.0, 1.9999999999999998)] == [2, None]
    assert oracle.first_hit(*line, 3.0, 2.0).t is None and oracle.first_hit(*line, LEFT, -1.0).t is None
    third = Oracle(packed(triangles(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]]))))
    assert third.first_hit((0, 0, 0), (1, 1, 1), 1 / 3).hit  # 1/3 is rounded down
    assert not third.first_hit((0, 0, 0), (1, 1, 1), math.nextafter(1 / 3, 1)).hit
    assert not third.first_hit((0, 0, 0), (1, 1, 1), 0.0, 1 / 3).hit


LARGE = 1.844e18


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, -LARGE])
def test_faces_that_are_nowhere_or_too_large_are_dropped(number):
    below = math.nextafter(LARGE, 0.0)
    corners = np.array([[[number, -1, 5], [1, -1, 5], [0, 2, 5]], [[-below, -1, 6], [1, -1, 6], [0, 2, 6]]])
    answer = Oracle(packed(triangles(corners))).first_hit((0, 0, 0), (0, 0, 1))
    assert (answer.t, answer.prim) == (6, 1)


ONE = np.ones((1, 3))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize(
    "prims",
    [
        lambda x: spheres((0, 0, 0, 1), (0, x, 0, 1)),
        lambda x: spheres((0, 0, 0, 1), (0, 0, 0, x)),
        lambda x: spheres((0, 0, 0, 1), (0, 0, 0, -abs(x) if math.isinf(x) else -1e-300)),
        lambda x: Planes(np.array([ONE[0], x * ONE[0]]), np.array([ONE[0], ONE[0]])),
        lambda x: affine(Ellipsoids, np.array([ONE[0], x * ONE[0]]), np.array([EYE3[0], EYE3[0]])),
        lambda x: affine(Cylinders, np.array([ONE[0], ONE[0]]), np.array([EYE3[0], x + EYE3[0]])),
        lambda x: affine(Disks, np.array([ONE[0], ONE[0]]), np.array([EYE3[0], x + EYE3[0]])),
    ],
)
def test_primitives_without_a_meaning_are_refused_by_number(prims, bad):
    with pytest.raises(OutsideDomain, match=r"primitive 4 \(row 1 of \w+\) must have finite numbers"):
        Oracle(packed(spheres((0, 0, 0, 1), (0, 0, 0, 1), (0, 0, 0, 1)), prims(bad)))


@pytest.mark.parametrize(
    ("o", "d", "t_min", "t_max"),
    [
        ((math.nan, 0, 0), (0, 0, 1), 0.0, 1.0),
        ((0, 0, 0), (0, math.inf, 1), 0.0, 1.0),
        ((0, 0, 0), (0.0, -0.0, 0.0), 0.0, 1.0),
        ((0, 0, 0), (0, 0, 1), math.nan, 1.0),
        ((0, 0, 0), (0, 0, 1), 0.0, math.nan),
    ],
)
def test_rays_without_a_meaning_are_refused(o, d, t_min, t_max):
    oracle = Oracle(packed(spheres((0, 0, 0, 1))))
    with pytest.raises(OutsideDomain, match="ray 0: o and d must be finite"):
        oracle.first_hit(o, d, t_min, t_max)
    with pytest.raises(OutsideDomain, match="ray 1: "):
        oracle.first_hits(np.array([ONE[0], o]), np.array([ONE[0], d]), [0.0, t_min], [1.0, t_max])
