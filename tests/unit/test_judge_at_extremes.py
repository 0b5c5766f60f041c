"""The judge in scenes far from the origin, with squashed spheres and denormal corners: all found by fuzzing."""

from typing import Any

import numpy as np
import pytest
from places import scene_of

from caster.aovs import Aovs
from caster.cameras import Orthographic, Pinhole
from caster.geometry.world_space import as_float32
from caster.rendering.images import camera_rays, render
from caster.scene.model import Scene
from caster.shapes import Cylinder, Disk, Plane, Sphere, Triangle
from mitsuba_ref.cameras.camera_reference import ClipRange, clip_planes
from mitsuba_ref.error_model.bounds import nearest_root
from mitsuba_ref.error_model.bracket import Claims
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE, SceneModel
from mitsuba_ref.error_model.tolerances import KU_OURS
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.judge.checks.render import CHECKED_AOVS, _within_float64, check_render
from mitsuba_ref.judge.checks.shapes import check_geometry
from mitsuba_ref.judge.defect_lookup import defect_features, defect_of
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.shared_input import SharedRays, endless_rays, model_of
from mitsuba_ref.shapes import disk, surface_errors
from mitsuba_ref.subjects.subject import cast_ours

# --- a near plane far from the origin

AWAY = np.array([-838.4915546440737, -5521.842198251097, 826.9822015611312])  # scene units
ALONG = np.array([1.0, -2.0, 0.5])


def behind_a_near_plane(near: float = 0.25, **lens: Any) -> Scene:
    """A triangle and a ball about half a unit from an eye that is 5600 units off."""
    lens = lens or {"type": "orthographic", "width": 0.3}
    camera = {"eye": AWAY, "direction": ALONG, "up": [0, 0, 1], "near": near, **lens}
    ball = Sphere(center=AWAY + 0.7 * ALONG / np.linalg.norm(ALONG), radius=0.2)
    corners = AWAY + np.array([[0.3, -1.1, -0.4], [0.9, -0.3, 0.1], [-0.2, -0.8, 0.7]])
    shapes = [Triangle(vertices=corners), ball]
    return Scene(camera=camera, film={"width": 8, "height": 8}, shapes=shapes)


@pytest.mark.parametrize("lens", [{"type": "orthographic", "width": 0.3}, {"type": "pinhole", "fov": 40}], ids=str)
def test_a_near_plane_far_from_the_origin_is_no_fault(lens):
    """Where the rays are moved to it they are rounded by more than t_error, which assumes no move."""
    scene = behind_a_near_plane(**lens)
    assert render(scene, ("depth",)).hit.sum() >= 20
    assert check_render(scene).ok


@pytest.mark.parametrize(
    "change",
    [
        lambda ours: {"depth": ours["depth"] * (1.0 + 1e-11)},
        lambda ours: {"position": ours["position"] + 1e-9},
        lambda ours: {"normal": -ours["normal"]},
        lambda ours: {"shape_id": np.where(ours.hit, 0, -1).astype(np.int32)},
    ],
    ids=["depth", "position", "normal", "shape_id"],
)
def test_a_faulty_image_behind_a_near_plane_is_still_detected(change):
    scene = behind_a_near_plane()
    ours, rays = render(scene, CHECKED_AOVS), camera_rays(scene)
    rows = np.arange(ours.hit.size)
    assert _within_float64(scene, ours, rows, rays).all()
    assert not _within_float64(scene, Aovs({**ours, **change(ours)}, ours.hit), rows, rays).all()


# --- clip planes of Mitsuba's sensors


@pytest.mark.parametrize(("near", "far"), [(0.0, 18.7), (0.0, None), (5.0, 18.7), (0.5, None), (1e20, None)])
@pytest.mark.parametrize("camera", [Pinhole, Orthographic])
def test_a_sensor_has_its_near_plane_before_its_far_plane(camera, near, far):
    """Where the scene reaches to 1e9, a near plane of the judge's own would lie beyond a far plane at 18.7."""
    given = camera(eye=(0, 0, 0), direction=(0, 0, 1), up=(0, 1, 0), near=near, **({"far": far} if far else {}))
    planes = clip_planes(given, ClipRange(2.0**-20 * 1e9, 2.0**10 * 1e9))
    assert 0.0 < planes["near_clip"] < planes["far_clip"]
    assert not near or planes["near_clip"] == near
    assert not far or planes["far_clip"] == far
    assert (near, far) != (0.0, None) or planes == {"near_clip": 2.0**-20 * 1e9, "far_clip": 2.0**10 * 1e9}


# --- positions of ours


def modelled(shape: Any, o: np.ndarray, d: np.ndarray) -> tuple[Scene, SharedRays, SceneModel]:
    """The judge's view of one shape and some rays (n, 3), in float32."""
    rays = endless_rays(np.atleast_2d(o), np.atleast_2d(d))
    scene = scene_of(shape, film={"width": len(rays.o), "height": 1})
    return scene, rays, model_of(scene, rays)


def test_our_position_on_a_small_triangle_seen_from_afar_is_within_its_bound():
    """o + t d, which it is held to, is rounded as |o| is; the triangle's corners are 3 10^5 times smaller."""
    rng = np.random.default_rng(3)
    corners = as_float32(rng.normal(size=(3, 3)) * 1e-2)
    weights = rng.dirichlet(np.ones(3), 200)
    d = np.array([0.0, 0.0, -1.0])  # an axis, so that the edge functions do not know how far away o is
    o = as_float32(weights @ corners - 3000.0 * d)
    scene, rays, model = modelled(Triangle(vertices=corners), o, np.tile(d, (len(o), 1)))
    view = cast_ours(scene, rays)
    hit = view.nearest.prim == 0
    o, d, prim = o[hit], rays.d[hit].astype(float), np.zeros(hit.sum(), int)
    at = model.intersect(prim, o, d, OUR_SIDE).at
    (bare,) = surface_errors.intersect(model.kinds[0], prim, o, d, KU_OURS)
    point = o + view.nearest.t[hit, None] * d
    away = np.linalg.norm(view.position[hit] - point, axis=1)
    assert hit.sum() >= 50
    assert (away <= at.p_error).all()
    assert (away > bare.p_error).any()  # more than the corners and barycentrics are rounded by
    assert np.median(at.p_error) < 1e6 * KU_OURS


FLATTENED = [{"matrix": [[0.5, 0.4, 0.45, 0], [0.4, 0.33, 0.37, 0], [0.06, 0.02, 0.11, 0], [0, 0, 0, 1]]}]


@pytest.mark.parametrize("kind", [Disk, Cylinder, Sphere])
def test_our_position_under_a_matrix_of_large_condition_is_within_its_bound(kind):
    """It goes through object space and back; for disks that is more than t and o + t d are off."""
    rng, shape = np.random.default_rng(5), kind(to_world=FLATTENED)
    targets = shape.matrix[:3, :3] @ rng.uniform(-0.5, 0.5, (3, 400))
    o = np.tile([2.1, -1.7, 1.3], (400, 1))
    scene, rays, model = modelled(shape, o, targets.T - o)
    view = cast_ours(scene, rays)
    hit = np.flatnonzero(view.nearest.prim == 0)
    o, d, t = rays.o[hit].astype(float), rays.d[hit].astype(float), view.nearest.t[hit]
    prim = np.zeros(len(hit), int)
    at = nearest_root(model.intersect(prim, o, d, OUR_SIDE), t)
    away = np.linalg.norm(view.position[hit] - (o + t[:, None] * d), axis=1)
    assert len(hit) >= 150
    assert (away <= at.p_error).all()
    assert np.median(at.p_error) < 1e-9
    if isinstance(shape, Disk):
        (alone,) = disk.intersect(model.kinds[0], prim, o, d, KU_OURS)
        assert (away > alone.p_error).any()


# --- planes beyond their patch


def test_a_plane_whose_patch_has_no_area_leaves_its_normal_open():
    """At 3e11 units float32 puts the corners of the patch on top of each other."""
    o = np.array([[-2.6e9, 4.8e10, 3.6e11]])
    plane = Plane(point=o[0] + 20.0, normal=(-0.04, -0.89, 0.456))
    _, rays, model = modelled(plane, o, [[0.0, 0.6, -0.8]])
    at = model.intersect(np.array([0]), rays.o.astype(float), rays.d.astype(float), REFERENCE_SIDE).at
    assert np.isinf(at.t_error).all() and np.isinf(at.n_error).all()


# --- balls that Mitsuba is wrong about


def measured(shape: Any, o: Any, d: Any, t: float, n: Any, p: Any) -> int | None:
    """The case of a pixel where Mitsuba gives the shape this t, normal and position."""
    _, rays, model = modelled(shape, o, d)
    line = endless(rays.o.astype(float), rays.d.astype(float))
    oracle = Oracle(model.packed)
    answers = [oracle.first_hit(line.o[0].tolist(), line.d[0].tolist())]
    n, p = (np.asarray(v, float)[None] for v in (n, p))
    claims = Claims(np.array([t]), np.array([0]), n, n, p)
    (found,) = defect_features(model, oracle, line, claims, answers, np.array([0]))
    return defect_of(found)


NOTHING = [np.nan] * 3
LOST = (-58622576.0, 28182582.0, 13086081.0)  # a ball's centre


@pytest.mark.parametrize("radius", [2.0**-8, 0.026217538863420486])
def test_a_sphere_lost_in_the_rounding_of_its_centre_has_no_normal_there(radius):
    """Mitsuba's point on it is the centre, and its normal 0 / 0."""
    o, d = np.add(LOST, [0, 0, 1.0]), np.array([0.0, 0.0, -1.0])
    assert measured(Sphere(center=LOST, radius=radius), o, d, 1.0 - radius, NOTHING, NOTHING) == 9


@pytest.mark.parametrize(
    ("center", "radius", "t"),
    [((0.0, 0.0, 0.0), 0.5, 3.5), (LOST, 200.0, 3.5), (LOST, 0.026, 1e6)],
    ids=["near", "large", "a wrong t"],
)
def test_no_other_sphere_is_excused_for_a_normal_that_is_no_number(center, radius, t):
    o, d = np.add(center, [0, 0, radius + 3.5]), np.array([0.0, 0.0, -1.0])
    assert measured(Sphere(center=center, radius=radius), o, d, t, NOTHING, NOTHING) is None


def test_a_hit_beside_a_squashed_sphere_is_case_8_however_far_its_box_is():
    """The ray passes 5 units beside the box; the ball's unit shape sees a direction of length 1e6."""
    turned = [{"scale": [1e-6, 1.0, 1e-6]}, {"rotate": {"axis": [1, 0, 0], "degrees": 30}}]
    ball = Sphere(to_world=turned)
    o, d = np.array([0.0, 5.0, 5.0]), np.array([0.0, 0.0, -1.0])
    assert measured(ball, o, d, 5.0, [0.0, 0.0, 1.0], o + 5.0 * d) == 8
    assert measured(ball, o, d, 5e7, [0.0, 0.0, 1.0], o + 5.0 * d) is None
    assert measured(Sphere(), o, d, 5.0, [0.0, 0.0, 1.0], o + 5.0 * d) is None


def test_a_ray_that_starts_on_the_patch_of_a_plane_up_to_its_rounding_is_case_30():
    """The plane lies 1/700 beside the ray's origin; the corners of its patch are rounded by more."""
    o, d = np.array([35729.15625, 612095.1875, -215684.21875]), np.array([0.6, -0.64, 0.48])
    n = np.array([0.19, 0.9415, -0.2785]) / np.linalg.norm([0.19, 0.9415, -0.2785])
    near, far = (Plane(point=(o[0] + away, o[1], o[2]), normal=n) for away in (2.0**-7, 128.0))
    assert measured(near, o, d, 0.0, n, o) == 30
    assert measured(far, o, d, 0.0, n, o) is None
    assert measured(near, o, d, 100.0, n, o + 100.0 * d) is None


# --- denormal corners

TURN = {"rotate": {"axis": [1.0, 2.0, 3.0], "degrees": 50.0}}


@pytest.mark.parametrize("tiny", [5e-324, 3e-320, 1e-310, 1.4e-45, 1e-40], ids=str)
def test_denormal_corners_are_rounded_by_the_spacing_of_denormal_numbers(tiny):
    corners = tiny * np.random.default_rng(4).integers(-9, 10, (3, 3))
    found = check_geometry(scene_of(Triangle(vertices=corners, to_world=[TURN])))
    assert found.ok, found
