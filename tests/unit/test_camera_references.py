"""Camera rays against independent formulas and Mitsuba's sensors; planted faults of cameras are found."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from caster.cameras import CAMERAS, Ray
from caster.description.fields import Camera
from caster.kernels.math.vec import UNIT_SQUARE_ATOL
from caster.kernels.nearest import Rays
from caster.rendering.images import camera_rays
from caster.scene.model import Film, Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.judge.checks import camera
from mitsuba_ref.judge.checks.camera import check_camera, check_sensor, pixel_centers

TYPES = [cls.model_fields["type"].default for cls in CAMERAS if issubclass(cls, Camera)]  # that look around
every_camera = pytest.mark.parametrize("camera", TYPES)


def random_scene(camera: str, rng: np.random.Generator) -> Scene:
    """Any pose, film, crop and field of view."""
    own: dict[str, Any] = {
        "pinhole": {
            "fov": 10.0 ** rng.uniform(-2.0, np.log10(179.0)),
            "fov_axis": rng.choice(["x", "y", "smaller", "larger", "diagonal"]),
            "principal_point": rng.uniform(-0.4, 0.4, 2),
            "near": rng.uniform(0.1, 1.0),
            "far": rng.uniform(2.0, 100.0),
        },
        "orthographic": {"width": 10.0 ** rng.uniform(-3, 3), "near": rng.uniform(0.1, 1.0), "far": 7.5},
        "fisheye": {"fov": rng.uniform(20.0, 360.0)},
    }.get(camera, {})
    eye = 10.0 ** rng.uniform(-2, 3) * rng.normal(size=3)
    pose = {"type": camera, "eye": eye, "direction": rng.normal(size=3), "up": rng.normal(size=3)}
    width, height = (int(n) for n in rng.integers(9, 60, 2))
    crop = [width // 4, height // 3, width - 2, height] if rng.random() < 0.3 else None
    return Scene(film=Film(width=width, height=height, crop=crop), camera=pose | own)


@every_camera
def test_our_rays_are_those_of_the_second_formula(camera):
    rng = np.random.default_rng([130, TYPES.index(camera)])
    ratios = []
    for _ in range(60):
        check = check_camera(random_scene(camera, rng))
        assert check.ok, check
        ratios.append(check.ratio)
    assert np.median(ratios) > 1e-3  # not vacuous: they do round differently


@every_camera
def test_directions_are_of_length_one(camera):
    """As near as the kernels take for granted that do without dividing by it."""
    rng = np.random.default_rng([131, TYPES.index(camera)])
    off = 0.0
    for _ in range(60):
        rays = camera_rays(random_scene(camera, rng))
        squares = (rays.d[rays.t_max >= 0.0] ** 2).sum(axis=1)
        off = max(off, np.abs(squares - 1.0).max())
    assert off <= UNIT_SQUARE_ATOL
    assert camera == "orthographic" or off > 0.1 * UNIT_SQUARE_ATOL  # not vacuous


Fault = Callable[[Scene, Any], Any]


def nudged(scene: Scene, rays: Any) -> Rays:
    """What the second formula gives a hundred-millionth of a pixel beside the centres."""
    x, y = pixel_centers(scene)
    found = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x + 1e-8, y)
    return Rays(found.o, found.d, found.t_min, found.t_max)


def with_one(values: np.ndarray, value: float) -> np.ndarray:
    """A copy with another value in the middle."""
    values = values.copy()
    values[len(values) // 2] = value
    return values


OF_ANY: dict[str, Fault] = {
    "stretched": lambda scene, rays: rays._replace(d=rays.d * (1.0 + 1e-12)),
    "moved": lambda scene, rays: rays._replace(o=rays.o + 1e-12 * (1.0 + np.abs(rays.o).max())),
    "one missing": lambda scene, rays: rays._replace(t_max=with_one(rays.t_max, -1.0)),
    "one not a number": lambda scene, rays: rays._replace(d=with_one(rays.d, np.nan)),
}
OF_A_CAMERA = {"nudged": nudged, **OF_ANY}
OF_LIMITS: dict[str, Fault] = {
    "near": lambda scene, rays: rays._replace(t_min=rays.t_min * (1.0 + 1e-6)),
    "far": lambda scene, rays: rays._replace(t_max=rays.t_max * (1.0 - 1e-6)),
}
OF_A_RAY = {"limit": lambda scene, rays: rays._replace(t_max=np.nextafter(rays.t_max, np.inf) + 1e-6), **OF_ANY}


def fixed_scene(camera: str) -> Scene:
    own: dict[str, Any] = {
        "pinhole": {"fov": 40, "principal_point": (0.2, -0.1), "near": 0.3, "far": 9.0},
        "orthographic": {"width": 3, "near": 0.3, "far": 9.0},
    }.get(camera, {})
    pose = {"type": camera, "eye": [1.1, -2.3, 0.7], "look_at": [0.1, 0.3, -0.2], "up": [0.1, 0.2, 1.0]}
    return Scene(film={"width": 37, "height": 23}, camera=pose | own)


def seen(monkeypatch: pytest.MonkeyPatch, scene: Scene, fault: Fault) -> bool:
    assert check_camera(scene).ok
    rays = fault(scene, camera_rays(scene))
    monkeypatch.setattr(camera, "camera_rays", lambda scene: rays)
    return not check_camera(scene).ok


@every_camera
@pytest.mark.parametrize("fault", OF_A_CAMERA)
def test_a_fault_of_any_camera_is_detected(monkeypatch, camera, fault):
    assert seen(monkeypatch, fixed_scene(camera), OF_A_CAMERA[fault])


@pytest.mark.parametrize("camera", ["pinhole", "orthographic"])
@pytest.mark.parametrize("fault", OF_LIMITS)
def test_a_fault_of_the_limits_is_detected(monkeypatch, camera, fault):
    assert seen(monkeypatch, fixed_scene(camera), OF_LIMITS[fault])


@pytest.mark.parametrize("fault", OF_A_RAY)
def test_a_fault_of_the_ray_is_detected(monkeypatch, fault):
    ray = Ray(origin=(1.1, -2.3, 0.7), direction=(0.3, 0.5, -7.0), t_max=9.5)
    scene = Scene(film=Film(width=3, height=2), camera=ray)
    assert check_camera(scene).ratio == 0.0
    assert seen(monkeypatch, scene, OF_A_RAY[fault])


@pytest.mark.parametrize("near", [0.3, 50.0])
def test_a_sensor_whose_rays_start_aside_is_detected(near):
    """Also where the near plane is farther from the eye than the eye is from the origin."""
    pose = {"type": "pinhole", "eye": (0.5, 0.0, 0.0), "direction": (0.0, 0.6, 0.8), "near": near, "far": 90.0}
    scene = Scene(film=Film(width=9, height=6), camera=pose)
    ours = camera_rays(scene)
    across = np.cross(ours.d, [1.0, 0.0, 0.0])  # so that only the lines differ, and no distance along them
    for aside in (0.0, 0.01):
        o = ours.o + ours.t_min[:, None] * ours.d + aside * across
        sensor = np.column_stack([o, ours.d, ours.t_max - ours.t_min])
        found = check_sensor(scene, SimpleNamespace(answer=SimpleNamespace(sensor=sensor)))
        assert found.ok is (aside == 0.0), found
