"""What is measured of a pixel where the reference is wrong, by hand: sizes, distances, angles, and hits at t = 0."""

import numpy as np
import pytest
from places import scene_of

import caster
from mitsuba_ref.error_model.bounds import nearest_root
from mitsuba_ref.error_model.bracket import CLAIMED_MISS, Claims
from mitsuba_ref.error_model.defect_conditions import WIDENED_BOUNDS_FACTOR
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.judge.defect_lookup import defect_features
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.shared_input import endless_rays, model_of

CORNERS = ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 1.0, 0.0))
SHAPES = (
    caster.Triangle(name="triangle", vertices=CORNERS),
    caster.Sphere(name="ball", center=(10.0, 0.0, 2.0), radius=1.0),
    caster.Disk(name="lid", to_world=[{"translate": [0.0, 20.0, 0.0]}]),
)
BALL, LID = 1, 2


def measured(o, d, *, t=None, prim=-1, shape=None, n=None, off=0.0):
    """Features of one ray and the reference's claim about it: the primitive's own values, t off by so many bounds."""
    scene = scene_of(*SHAPES)
    rays = endless_rays(np.array([o]), np.array([d]))
    model = model_of(scene, rays)
    oracle = Oracle(model.packed)
    o, d = rays.o.astype(float), rays.d.astype(float)
    answers = oracle.first_hits(o, d)
    claims = Claims(np.array([np.inf]), np.array([CLAIMED_MISS]), *np.zeros((3, 1, 3)))
    if prim >= 0:
        guess = np.array([float(answers[0].t) if answers[0].t is not None else 1.0])
        at = nearest_root(
            model.intersect(np.array([prim]), o, d, REFERENCE_SIDE), guess if t is None else np.array([t])
        )
        claimed = at.t + off * at.t_error if t is None else np.array([t])
        p = o + claimed[:, None] * d
        claims = Claims(claimed, np.array([prim if shape is None else shape]), at.n, at.sh_n, p)
    if n is not None:
        claims = claims._replace(n=np.array([n]))
    (found,) = defect_features(model, oracle, endless(o, d), claims, answers, np.array([prim]))
    return found


def test_sizes_are_those_of_the_box_of_what_is_involved():
    found = measured((1.0, 0.25, 8.0), (0.0, 0.0, -1.0))
    assert (found.ours, found.theirs, found.where) == ("Triangles", "", frozenset({"inside"}))
    assert found.distance == 2.0 and found.offset == 1.0  # 8 away, the box is 4 long and ends at 4
    assert (found.t, found.at_zero, found.beyond_corners, found.without_area) == (np.inf, False, False, False)
    assert found.cosine == 1.0 and found.slenderness == pytest.approx(4.0 / 17.0)
    assert found.axis_angle == 1.0 and not found.nearly and not found.normless
    both = measured((1.0, 0.25, 8.0), (0.0, 0.0, -1.0), prim=BALL, t=6.0)
    assert both.theirs == "Spheres" and both.offset == pytest.approx(5.5)
    assert both.slenderness == pytest.approx(4.0 / 17.0)
    away = np.linalg.norm([8.0, 0.0, 5.0]) / 2.0
    assert both.distance == pytest.approx(away)
    aside = measured((20.0, 0.25, 8.0), (-19.0, 0.0, -8.0))
    assert aside.ours == "Triangles" and aside.distance == pytest.approx(np.hypot(16.0, 8.0) / 4.0)
    nothing = measured((50.0, 50.0, 50.0), (1.0, 0.0, 0.0))
    assert (nothing.ours, nothing.theirs, nothing.distance, nothing.offset) == ("", "", 0.0, 0.0)
    assert (nothing.cosine, nothing.slenderness, nothing.axis_angle, nothing.stretch) == (1.0, 1.0, 1.0, 1.0)


def test_the_least_angle_of_both_counts():
    slanted = measured((1.0, 0.25, 3.0), (0.0, -0.0, -3.0))
    assert slanted.cosine == pytest.approx(1.0)
    tilted = measured((1.0 - 4.0, 0.25, 3.0), (4.0, 0.0, -3.0))
    assert tilted.ours == "Triangles" and tilted.cosine == pytest.approx(0.6)
    other = measured((1.0 - 4.0, 0.25, 3.0), (4.0, 0.0, -3.0), prim=LID, t=1.0)
    assert other.theirs == "Disks" and other.cosine == pytest.approx(0.6)


@pytest.mark.parametrize(("off", "nearly"), [(0.5, True), (0.97, True), (1.05, False), (-0.97, True), (-1.05, False)])
def test_nearly_is_within_sixteen_bounds(off, nearly):
    found = measured((1.0, 0.25, 3.0), (0.0, 0.0, -1.0), prim=0, off=off * WIDENED_BOUNDS_FACTOR)
    assert found.theirs == "Triangles" and found.nearly is nearly
    assert WIDENED_BOUNDS_FACTOR == 16.0


ZERO = {
    "on the disk itself": ((0.5, 20.0, 0.0), (0.0, 0.3, 1.0), LID, LID, True),
    "beside the disk": ((0.5, 20.0, 0.01), (0.0, 0.3, 1.0), LID, LID, False),
    "on the ball, that is named": ((11.0, 0.0, 2.0), (1.0, 0.5, 0.0), BALL, BALL, True),
    "inside of the ball": ((10.5, 0.0, 2.0), (1.0, 0.5, 0.0), BALL, BALL, False),
    "on the triangle, of which only the shape is named": ((1.0, 0.25, 0.0), (0.0, 0.3, 1.0), -1, 0, False),
}


@pytest.mark.parametrize("what", ZERO)
def test_a_hit_at_zero_is_one_where_the_ray_starts(what):
    o, d, prim, shape, at_zero = ZERO[what]
    found = measured(o, d, prim=prim, shape=shape, t=0.0)
    assert found.at_zero is at_zero
    assert not measured(o, d, prim=prim, shape=shape, t=1e-30).at_zero


def test_a_normal_that_is_no_number_is_excused_only_where_it_has_no_bound():
    found = measured((1.0, 0.25, 3.0), (0.0, 0.0, -1.0), prim=0, n=(np.nan, 0.0, 0.0), off=0.5)
    assert not found.normless and not found.nearly
    assert not measured((1.0, 0.25, 3.0), (0.0, 0.0, -1.0), prim=0, off=0.5).normless
