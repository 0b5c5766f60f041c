"""Origins of spawned rays: known cases, and the float64 filter against exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from places import scene_of

from caster import Cylinder, Disk, EllipsoidCloud, LinearCurve, Plane, Rectangle, Sphere
from mitsuba_ref.hard.rays import Targets, endless
from mitsuba_ref.judge.checks.secondary_rays import judge_origins, leaving_rays
from mitsuba_ref.oracle.implicit_surfaces import Approximate
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import SELF_HIT, SKIPPED, UNDECIDED, WRONG_SIDE, OriginJudge
from mitsuba_ref.reference.shared_input import packed_float32

FLOOR = Plane(point=(0, 0, 0), normal=(0, 0, 1))
BALL = Sphere(center=(0, 0, -1), radius=1)
TINY = 2.0**-20
BELOW = Plane(point=(0, 0, -TINY), normal=(0, 0, 1))
WITHIN = Sphere(center=(0, 0, -1), radius=1 - TINY)


def outer(z, radius):
    """A ball that rays meet from outside only."""
    return EllipsoidCloud(centers=[(0, 0, z)], scales=[(radius,) * 3], quaternions=[(0, 0, 0, 1)])


def leaving(shapes, o, d, w, q):
    """Rays from q along w after the exact hits of their parents."""
    scene = scene_of(*shapes)
    packed = packed_float32(scene)
    o, d, w, q = (np.atleast_2d(np.asarray(a, np.float64)) for a in (o, d, w, q))
    answers = Oracle(packed).first_hits(o, d)
    prim = np.array([answer.prim for answer in answers])
    t = np.array([np.inf if answer.t is None else float(answer.t) for answer in answers])
    return leaving_rays(scene, packed, endless(o, d), prim, t, w, q)


@pytest.mark.parametrize(
    ("shapes", "w", "q", "finding"),
    [
        ([FLOOR], (0, 0, 1), (0, 0, TINY), 0),
        ([FLOOR], (0, 0, 1), (0, 0, -TINY), SELF_HIT | WRONG_SIDE),
        ([FLOOR], (0, 0, 1), (0, 0, 0), SELF_HIT | WRONG_SIDE),
        ([FLOOR], (0, 0, -1), (0, 0, -TINY), 0),
        ([FLOOR], (1, 0, 0), (0, 0, TINY), UNDECIDED),
        ([FLOOR, BELOW], (0, 0, -1), (0, 0, -2 * TINY), SKIPPED),
        ([FLOOR, BELOW], (0, 0, -1), (0, 0, -TINY), SKIPPED),
        ([FLOOR, BELOW], (0, 0, -1), (0, 0, -TINY / 2), 0),
        ([BALL], (0, 0, 1), (0, 0, TINY), 0),
        ([BALL], (0, 0, -1), (0, 0, -TINY), 0),
        ([BALL], (0, 0, -1), (0, 0, TINY), SELF_HIT | WRONG_SIDE),
        ([BALL], (0, 0, -1), (0, 0, -3), WRONG_SIDE),  # beyond its far side
        ([BALL], (1, 0, TINY), (-TINY, 0, 0), 0),
        ([BALL], (1, 0, TINY / 4), (-TINY, 0, TINY**2 / 2), 0),
        ([BALL], (1, 0, TINY**2), (-0.5, 0, -0.125), SELF_HIT),  # outside; past a bulge of its own surface
        ([BALL, WITHIN], (0, 0, -1), (0, 0, -4 * TINY), SKIPPED),
        ([BALL, WITHIN], (0, 0, -1), (0, 0, -TINY / 4), 0),
        ([BALL, BALL], (0, 0, -1), (0, 0, -TINY), 0),
        ([outer(-1, 1)], (0, 0, 1), (0, 0, TINY), 0),
        ([outer(-1, 1)], (0, 0, 1), (0, 0, -TINY), WRONG_SIDE),
        ([BALL, outer(-1, 1 - TINY)], (0, 0, -1), (0, 0, -4 * TINY), SKIPPED),
        ([FLOOR, outer(9, 9 + 4 * TINY)], (0, 0, -1), (0, 0, -8 * TINY), 0),  # which p is within
        ([LinearCurve(points=[(-1, 0, -1), (1, 0, -1)])], (0, 0, 1), (0, 0, TINY), UNDECIDED),
        ([Disk(), Sphere(center=(0, 0, -3))], (0, 0, 1), (0, 0, np.inf), UNDECIDED),
    ],
)
def test_known_origins(shapes, w, q, finding):
    found = judge_origins(leaving(shapes, (0, 0, 9), (0, 0, -1), w, q))
    assert found.found.tolist() == [finding]
    assert found.between.tolist() == [1 if finding & SKIPPED else -1]


def test_a_parent_that_hits_nothing_or_another_surface_leaves_its_ray_undecided():
    rays = leaving([FLOOR], [(0, 0, 9)] * 2, [(0, 0, 1), (0, 0, -1)], [(0, 0, 1)] * 2, [(0, 0, TINY)] * 2)
    other = rays._replace(rays=rays.rays._replace(prim=np.array([-1, 1])))
    assert OriginJudge(Oracle(rays.packed)).judge(rays.rays)[0].tolist() == [UNDECIDED, 0]
    assert OriginJudge(Oracle(rays.packed)).judge_exactly(other.rays.rows(0))[0] == UNDECIDED


def test_the_float64_filter_agrees_with_exact_arithmetic():
    rng = np.random.default_rng(5)
    turn = {"rotate": {"axis": [1, 2, 3], "degrees": 40}}
    shapes = [
        Sphere(center=(0.3, 0, 0), radius=1),
        Sphere(to_world=[{"scale": [1.0, 0.5, 0.7]}, turn]),
        Cylinder(p0=(-1, 0, 0), p1=(1, 0.5, 0.3), radius=0.4),
        Disk(to_world=[{"scale": 2}, turn]),
        Rectangle(to_world=[turn, {"translate": [0, 0.2, 0]}]),
        Plane(point=(0, -0.3, 0), normal=(0.2, 1, 0.1)),
    ]
    count = 300
    p = Targets(packed_float32(scene_of(*shapes)), rng).points(count, "inside").p
    o, w = p + rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    made = leaving(shapes, o, p - o, w, p)
    rays = made.rays
    side = np.where((rays.n * w).sum(axis=1) < 0, -1, 1)[:, None]
    off = 10.0 ** rng.uniform(-17, 0, (count, 1)) * (side * rays.n + 0.3 * rng.normal(size=(count, 3)))
    off *= rng.choice([1.0, 1.0, -1.0], (count, 1))  # some start on the other side
    rays = rays._replace(q=rays.p + off)
    judge = OriginJudge(Oracle(made.packed))
    sure = judge.certainly_right(rays)
    exact = np.array([judge.judge_exactly(rays.rows(row))[0] for row in range(count)])
    assert not exact[sure].any() and sure[exact == 0].mean() > 0.25
    assert all((exact & what).any() for what in (SELF_HIT, SKIPPED, WRONG_SIDE))


def test_running_errors_bound_the_errors_of_cancelling_sums():
    rng = np.random.default_rng(2)
    x, y, z = rng.normal(size=(3, 200))
    near = y * (1.0 + rng.integers(-4, 5, 200) * 2.0**-52)
    a, b, c, d = map(Approximate, (x, y, z, near))
    found = a * b * c - a * c * d
    exact = [Fraction(i) * Fraction(k) * (Fraction(j) - Fraction(m)) for i, j, k, m in zip(x, y, z, near, strict=True)]
    off = [abs(Fraction(value) - each) for value, each in zip(found.value, exact, strict=True)]
    assert all(error <= Fraction(bound) for error, bound in zip(off, found.error, strict=True))
    assert all(sign in (0, (each > 0) - (each < 0)) for sign, each in zip(found.sign(), exact, strict=True))
