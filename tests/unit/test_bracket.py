"""The bracket refuses what no rounding explains and allows what some rounding does, in scenes made for it."""

from typing import Any

import numpy as np
import pytest
from places import scene_of

from caster.geometry.world_space import as_float32
from caster.shapes import Cylinder, EllipsoidCloud, Icosphere, Plane, Sphere, Triangle
from mitsuba_ref.error_model.bracket import (
    Bracket,
    BracketResult,
    Claims,
    RayIntersections,
    latest_hits,
    near_ray_start,
)
from mitsuba_ref.error_model.defect_conditions import WIDENED_BOUNDS_FACTOR
from mitsuba_ref.error_model.intersections import Intersections, Rays, unit
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE, SceneModel, Side
from mitsuba_ref.error_model.tolerances import KU, U32
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.reference.shared_input import endless_rays, model_of

UP = np.array([0.0, 0.0, 1.0])
DOWN = -UP
# Two triangles that share the diagonal from (-1, -1) to (1, 1), a third of a unit off any lattice.
A, B, C, D = (np.array(p) / 3.0 for p in ([-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]))
RIGHT, LEFT = Triangle(name="right", vertices=(A, B, C)), Triangle(name="left", vertices=(A, C, D))


def modelled(shapes: list[Any], o: Any, d: Any) -> SceneModel:
    scene = scene_of(*shapes)
    return model_of(scene, endless_rays(np.atleast_2d(o), np.atleast_2d(d)))


def bracket(shapes: list[Any], o: Any, d: Any, *, ours: bool = False) -> Bracket:
    return Bracket(modelled(shapes, o, d), OUR_SIDE if ours else REFERENCE_SIDE)


def judged(
    shapes: list[Any],
    o: Any,
    d: Any,
    t: float,
    shape: int,
    n: Any = UP,
    *,
    t_min: float = 0.0,
    t_max: float = np.inf,
    ours: bool = False,
) -> BracketResult:
    """One ray, one claim; the claimed point follows from t."""
    o, d, n = (np.asarray(v, float)[None] for v in (o, d, n))
    p = o + (t if np.isfinite(t) else 0.0) * d
    claims = Claims(np.array([t]), np.array([shape]), n, n, p)
    return bracket(shapes, o, d, ours=ours).judge(Rays(o, d, np.array([t_min]), np.array([t_max])), claims)


def allows(*args: Any, **kwargs: Any) -> bool:
    return bool(judged(*args, **kwargs).allowed[0])


MISS = (np.inf, -1)
BALL = Sphere(name="ball", center=(0, 0, 0), radius=1)
FAR_BALL = Sphere(name="behind", center=(0, 0, -4), radius=1)
ABOVE = [0.0, 0.0, 5.0]


@pytest.mark.parametrize("ours", [False, True])
def test_the_nearest_hit_is_allowed_and_a_hidden_one_is_not(ours):
    balls = [BALL, FAR_BALL]
    assert allows(balls, ABOVE, DOWN, 4.0, 0, ours=ours)
    assert not allows(balls, ABOVE, DOWN, 8.0, 1, ours=ours)
    assert not allows(balls, ABOVE, DOWN, 6.0, 0, DOWN, ours=ours)  # the far side of the first
    assert allows([FAR_BALL], ABOVE, DOWN, 8.0, 0, ours=ours)


@pytest.mark.parametrize("ours", [False, True])
def test_a_miss_is_refused_where_something_is_certainly_hit(ours):
    assert not allows([BALL], ABOVE, DOWN, *MISS, ours=ours)
    assert allows([BALL], [2.0, 0.0, 5.0], DOWN, *MISS, ours=ours)
    assert not allows([BALL], [2.0, 0.0, 5.0], DOWN, 5.0, 0, [1, 0, 0], ours=ours)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_at_a_silhouette_both_hit_and_miss_are_allowed(side):
    o = [1.0 + side * U32, 0.0, 5.0]
    assert allows([BALL], o, DOWN, *MISS)
    assert allows([BALL], o, DOWN, 5.0, 0, [1, 0, 0])
    beyond = [1.0 + side * 1e-4, 0.0, 5.0]
    assert allows([BALL], beyond, DOWN, *MISS) == (side > 0)
    float64 = judged([BALL], o, DOWN, *MISS, ours=True)
    assert bool(float64.allowed[0]) == (side > 0)  # 2^-24 is wide for float64


def test_what_is_behind_a_silhouette_is_allowed_just_beside_it_only():
    balls = [BALL, Sphere(center=(0, 0, -4), radius=3)]
    for away, expected in ((U32, True), (-U32, True), (-1e-4, False)):
        x = 1.0 + away
        z = -4.0 + np.sqrt(9.0 - x * x)
        n = np.array([x, 0.0, z + 4.0]) / 3.0
        assert allows(balls, [x, 0.0, 5.0], DOWN, 5.0 - z, 1, n) is expected


@pytest.mark.parametrize("ours", [False, True])
def test_a_miss_is_refused_on_an_edge_that_two_triangles_share(ours):
    on_edge = [0.1, 0.1, 5.0]
    assert not allows([RIGHT, LEFT], on_edge, DOWN, *MISS, ours=ours)
    assert allows([RIGHT, LEFT], on_edge, DOWN, 5.0, 0, ours=ours)
    assert allows([RIGHT, LEFT], on_edge, DOWN, 5.0, 1, ours=ours)


def test_a_miss_is_allowed_on_an_edge_without_a_neighbour_across_it():
    on_edge = [0.1, 0.1, 5.0]
    assert allows([RIGHT], on_edge, DOWN, *MISS)
    turned = Triangle(vertices=(A, C, B))
    assert allows([RIGHT, turned], on_edge, DOWN, *MISS)  # both lie on the same side of it
    assert allows([RIGHT, LEFT], A + ABOVE, DOWN, *MISS)  # a corner: no promise there


def test_what_is_hidden_behind_a_shared_edge_is_refused():
    floor = Plane(normal=(0, 0, 1), offset=-1)
    assert not allows([RIGHT, LEFT, floor], [0.1, 0.1, 5.0], DOWN, 6.0, 2)
    assert allows([RIGHT, floor], [0.1, 0.1, 5.0], DOWN, 6.0, 1)
    assert not allows([RIGHT, floor], [0.2, 0.1, 5.0], DOWN, 6.0, 1)


def test_a_neighbour_with_another_corner_does_not_close_an_edge():
    """Edges close by their end points: this one ends elsewhere, so the edge is a crack."""
    shorter = Triangle(vertices=(A, C * 0.999, D))
    assert allows([RIGHT, shorter], [0.1, 0.1, 5.0], DOWN, *MISS)


def test_nothing_counts_beyond_t_max_or_behind_the_origin():
    assert not allows([BALL], ABOVE, DOWN, 4.0, 0, t_max=3.5)
    assert allows([BALL], ABOVE, DOWN, *MISS, t_max=3.5)
    assert allows([BALL], ABOVE, DOWN, 4.0, 0, t_max=4.0) and allows([BALL], ABOVE, DOWN, *MISS, t_max=4.0)
    assert not allows([BALL], ABOVE, UP, -4.0, 0) and allows([BALL], ABOVE, UP, *MISS)


NEAR_SIDE, FAR_SIDE = (4.0, 0, UP), (6.0, 0, DOWN)


@pytest.mark.parametrize(
    ("t_min", "allowed"),
    [(3.0, [NEAR_SIDE]), (5.0, [FAR_SIDE]), (7.0, [MISS]), (4.0, [NEAR_SIDE, FAR_SIDE])],  # at 4, either, by rounding
)
def test_nothing_counts_before_t_min(t_min, allowed):
    for claim in (NEAR_SIDE, FAR_SIDE, MISS):
        assert allows([BALL], ABOVE, DOWN, *claim, t_min=t_min, ours=True) is (claim in allowed)


def test_a_primitive_is_looked_at_beyond_its_box_if_it_is_named():
    """A cylinder squashed to 1e-6, 5 units aside, whose bound reaches that far."""
    thin = Cylinder(to_world=[{"scale": [1e-6, 1.0, 1e-6]}, {"rotate": {"axis": [1, 0, 0], "degrees": 30}}])
    o, d = np.array([[0.0, 6.0, 5.0]]), DOWN[None]
    claims = Claims(np.array([5.0]), np.array([0]), UP[None], UP[None], o + 5.0 * d)
    judge = Bracket(modelled([thin], o, d), Side(WIDENED_BOUNDS_FACTOR * KU, own=False)).judge
    assert not judge(endless(o, d), claims).allowed[0]
    assert judge(endless(o, d), claims, also=np.array([0])).allowed[0]
    assert not judge(endless(o, d), claims, also=np.array([-1])).allowed[0]


@pytest.mark.parametrize("t", [4.0 + 1e-4, 4.0 - 1e-4, np.nan, -4.0, 0.0])
def test_a_wrong_t_is_refused(t):
    assert not allows([BALL], ABOVE, DOWN, t, 0)


@pytest.mark.parametrize("n", [DOWN, [0, 0, 2], [0, 0, 0.99999], [1e-4, 0, 1], [np.nan] * 3, [0, 0, 0]], ids=str)
def test_a_wrong_normal_is_refused(n):
    assert allows([BALL], ABOVE, DOWN, 4.0, 0, UP)
    assert not allows([BALL], ABOVE, DOWN, 4.0, 0, n)


def test_a_shape_that_is_not_there_is_refused():
    assert not allows([BALL, FAR_BALL], ABOVE, DOWN, 4.0, 1)
    assert not allows([FAR_BALL, BALL], ABOVE, DOWN, 4.0, 0)
    assert not allows([BALL], ABOVE, DOWN, 4.0, -1)


def test_each_part_of_a_claim_counts():
    o, d = np.array([ABOVE]), DOWN[None]
    good = Claims(np.array([4.0]), np.array([0]), UP[None], UP[None], UP[None])
    judge = bracket([BALL], o, d).judge
    assert judge(endless(o, d), good).allowed[0]
    for change in ({"p": UP[None] * 1.0001}, {"sh_n": DOWN[None]}, {"p": np.full((1, 3), np.nan)}):
        assert not judge(endless(o, d), good._replace(**change)).allowed[0], change


def test_a_triangle_seen_edge_on_leaves_open_where_it_is_hit_and_nothing_else():
    """Turned off the axes: along them, nothing rounds and everything can be told."""
    corners = np.array([[0.31, 0.17, -0.53], [-0.71, 0.43, 0.29], [0.23, -0.61, 0.37]])
    along, n = corners[1] - corners[0], np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for slope, expected in ((1e-9, True), (0.1, False)):
        d = along / np.linalg.norm(along) - slope * n / np.linalg.norm(n)
        o = corners.mean(axis=0) - 5.0 * d
        ball = Sphere(center=tuple(o + 2.0 * d), radius=0.5)
        shapes, up = [Triangle(vertices=corners), ball], n / np.linalg.norm(n)
        alone = shapes[:1]
        assert bool(judged(alone, o, d, 4.9, 0, up).open[0]) is expected
        assert not judged(alone, o, d, 4.9, 0, -up).open[0]  # its normal is known all the same
        assert not judged(alone, o, d, *MISS).open[0]
        assert not judged(shapes, o, d, 4.9, 0, up).open[0]  # behind the ball, which is certain
        assert not judged(shapes, o, d, 1.5, 1, d).open[0]  # a normal of the ball turned round is no edge-on triangle


START = (np.array([0, 0]), np.array([1e-15, 1e-15]))  # the primitive they leave, and how far off it they start


def test_shadow_rays_do_not_count_the_surface_they_leave():
    """From a point of a ball to the outside nothing blocks; through the ball, its far side does."""
    o = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    d = np.array([[0.1, 0.0, 1.0], [0.1, 0.0, -1.0]])
    rays = endless(o, d)
    alone = bracket([BALL], o, d, ours=True)
    possible, certain = alone.blocked(rays, leaving=START)
    assert possible.tolist() == certain.tolist() == [False, True]
    possible, _ = alone.blocked(rays)
    assert possible.tolist() == [True, True]  # its own start, unless told
    roofed = bracket([BALL, Plane(normal=(0, 0, 1), offset=9)], o, d, ours=True)
    assert roofed.blocked(rays, leaving=START)[1].tolist() == [True, True]
    assert roofed.blocked(rays._replace(t_max=np.array([5.0, 1.0])), leaving=START)[1].tolist() == [False, False]


def test_only_the_meeting_at_the_start_is_left_out():
    """Seen from inside, the far wall of the ball is no start of it, even where nothing else of the ball is met."""
    o, d = np.array([[0.0, 0.0, 0.999]]), np.array([[0.0, 0.0, -1.0]])
    inside = bracket([BALL], o, d, ours=True)
    possible, certain = inside.blocked(endless(o, d), leaving=(np.array([0]), np.array([1e-15])))
    assert possible[0] and certain[0]


@pytest.mark.parametrize("aim", ["middles of edges", "middles of faces"])
def test_a_closed_mesh_has_no_hole_for_rays_from_inside(aim):
    ball = Icosphere(subdivisions=2, to_world=[{"rotate": {"axis": [1, 2, 3], "degrees": 40}}])
    mesh = ball.pack(as_float32)
    corners = mesh.vertices[mesh.faces]
    targets = corners.mean(axis=1) if aim == "middles of faces" else 0.5 * (corners[:, 0] + corners[:, 1])
    o = as_float32(np.tile([0.011, -0.023, 0.017], (len(targets), 1)))
    d, count = as_float32(targets - o), len(targets)
    nothing = Claims(np.full(count, np.inf), np.full(count, -1), 0 * d, 0 * d, 0 * d)
    assert count == 320
    assert not bracket([ball], o, d).judge(endless(o, d), nothing).allowed.any()


def met(t: float, t_error: float, *, certain: bool = True) -> RayIntersections:
    """One intersection of one ray, with the normal UP."""
    one, up, flag, edge = np.ones(1), UP[None], np.ones(1, bool), np.ones((1, 6))
    at = Intersections(t * one, t_error * one, up, one, up, one, flag, flag & certain, one, up, one, edge, 0.0 * one)
    return RayIntersections(np.zeros(1, int), np.zeros(1, int), at)


@pytest.mark.parametrize(
    ("t_min", "t_max", "certain", "latest"),
    [
        (0.0, np.inf, True, 2.5),
        (0.0, np.inf, False, np.inf),
        (0.0, 2.5, True, 2.5),
        (0.0, 2.25, True, np.inf),
        (1.25, np.inf, True, 2.5),
        (1.5, np.inf, True, np.inf),
    ],
)
def test_a_certain_hit_is_one_that_is_in_range_with_its_whole_bound(t_min, t_max, certain, latest):
    """At t = 2 +- 1/2; the range is t_min < t <= t_max."""
    found = latest_hits(met(2.0, 0.5, certain=certain), Rays(UP, UP, np.array([t_min]), np.array([t_max])))
    assert found.tolist() == [latest]


@pytest.mark.parametrize(
    ("t", "off", "near"), [(0.0, 0.0, False), (2.0, 0.75, True), (2.0, 0.5, False), (-2.0, 0.75, True)]
)
def test_a_surface_is_near_the_start_of_a_ray_within_the_uncertainty_of_that(t, off, near):
    """Its height is (|t| - 1/2) |n.d| = 3/4 at |t| = 2; an exact start has no surface near it."""
    found = near_ray_start(met(t, 0.5), np.array([[0.0, 3.0, 0.5]]), np.array([off]))
    assert found.tolist() == [near]


# A film of the family `furnished`, seed 1: Mitsuba 3.9.1 reports this hit on x86-64 with and without AVX-512.
THIN = [
    [0.010763764, 0.008846196, -0.70471895, 0.17625207],
    [0.027380043, 0.025367521, 0.27757892, 0.38241562],
    [-0.059164982, 0.013464646, -0.020238269, -0.83727169],
    [0.0, 0.0, 0.0, 1.0],
]
PASSING = [0.73597258, 11.999999, -11.761024], [-0.090754375, -0.71773195, 0.69037998]


def thin_ellipsoids(matrix: Any) -> EllipsoidCloud:
    turned = {"centers": [[0.0, 0.0, 0.0]], "scales": [[1.0, 1.0, 1.0]], "quaternions": [[0.0, 0.0, 0.0, 1.0]]}
    return EllipsoidCloud(to_world=[{"matrix": matrix}], **turned)


@pytest.mark.parametrize(("t", "allowed"), [(15.645721, True), (15.4, False), (16.1, False), (np.inf, True)])
def test_a_thin_ellipsoid_may_be_hit_by_a_ray_that_passes_it_by_far(t, allowed):
    n = [0.093025789, 0.3496067525, -0.932266772]
    assert allows([thin_ellipsoids(THIN)], *PASSING, t, 0 if np.isfinite(t) else -1, n) is allowed


@pytest.mark.parametrize("make", [thin_ellipsoids, lambda matrix: Sphere(to_world=[{"matrix": matrix}])])
@pytest.mark.parametrize(("size", "far"), [(1e-3, 0.0), (0.03, 0.0), (1.0, 0.0), (30.0, 0.0), (1.0, 1e4), (1e3, 1e7)])
def test_a_possible_hit_is_never_too_far_off_to_be_considered(make, size, far):
    """Ellipsoids with semi-axes down to a hundredth of the longest, and rays that pass them at up to 10^4 radii."""
    rng, possible = np.random.default_rng(6), 0
    for _ in range(30):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = np.eye(4)
        matrix[:3, :3] = turn * (size * 10.0 ** -rng.uniform(0.0, 2.0, 3))
        matrix[:3, 3] = rng.normal(size=3) + far * unit(rng.normal(size=(1, 3)))[0]
        o = matrix[:3, 3] + 10.0 ** rng.uniform(0.0, 4.0, (100, 1)) * unit(rng.normal(size=(100, 3)))
        off = size * 10.0 ** rng.uniform(-3.0, 4.0, (100, 1)) * unit(rng.normal(size=(100, 3)))
        d = unit(matrix[:3, 3] + off - o)
        model = modelled([make(matrix.tolist())], o, d)
        near = np.hstack([*model.near_pairs(o, d, blurred=True)])
        found = model.intersect(np.zeros(100, np.int64), o, d, REFERENCE_SIDE)
        hit = found.pair[found.at.possible]
        assert set(hit) <= set(near[0])
        possible += len(set(hit))
    assert possible >= 30
