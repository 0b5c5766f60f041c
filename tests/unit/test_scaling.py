"""Scenes scaled by powers of two: the function, and the check that finds thresholds in scene units."""

import numpy as np
import pytest

from caster.cameras import CAMERAS
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.judge.checks import scaling as module
from mitsuba_ref.judge.checks.scaling import CAMERA_LENGTHS, CAMERA_RATIOS, check_scaling, scaling_differences

LIGHTS = [
    {"type": "point", "position": [1.0, 2.0, 4.0], "intensity": [3.0, 2.0, 1.0]},
    {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": [1.0, 2.0, 3.0]},
]


def scene_of(radius=1.0, **fields):
    camera = {"type": "pinhole", "eye": [0.0, 0.0, 5.0], "look_at": [0.0, 0.0, 0.0], "near": 0.5, "far": 9.0}
    shapes = [{"type": "sphere", "radius": radius}] if radius else []
    data = {"film": {"width": 9, "height": 7}, "camera": camera, "light": LIGHTS, "shape": shapes}
    return Scene.model_validate(data | fields)


def test_it_is_known_of_every_field_of_a_camera_whether_it_is_a_length():
    fields = {name for camera in CAMERAS for name in camera.model_fields}
    assert fields == {*CAMERA_LENGTHS, *CAMERA_RATIOS}


@pytest.mark.parametrize("name", ["transforms", "lights-and-shadows", "crop-window", "orthographic-clip"])
@pytest.mark.parametrize("exponent", [-150, -40, -10, 10, 40])
def test_a_shipped_scene_is_rendered_alike_at_every_scale(name, exponent):
    scene = load_scene(f"scenes/{name}.toml").with_film(width=24, height=18)
    assert scaling_differences(scene, (exponent,)) == []


def with_threshold(aov, spoil):
    """`render`, where one AOV is off by what a threshold in scene units does."""
    right = module.render

    def render(scene, *args, **options):
        image = right(scene, *args, **options)
        image[aov][...] = np.where(spoil(scene), image[aov] * 2.0, image[aov])
        return image

    return render


@pytest.mark.parametrize("aov", ["depth", "position", "normal", "diffuse"])
@pytest.mark.parametrize(
    "spoil", [lambda s: s.camera.eye[2] < 1e-6, lambda s: s.camera.eye[2] > 1e6], ids=["small", "large"]
)
def test_a_threshold_in_scene_units_fails(monkeypatch, aov, spoil):
    scene = scene_of()
    assert check_scaling(scene).ok
    monkeypatch.setattr(module, "render", with_threshold(aov, spoil))
    found = check_scaling(scene)
    assert not found.ok and found.what.startswith(f"{aov} at (")


def test_one_bit_fails(monkeypatch):
    monkeypatch.setattr(module, "render", with_one_bit(module.render))
    assert not check_scaling(scene_of()).ok


def with_one_bit(right):
    def render(scene, *args, **options):
        image = right(scene, *args, **options)
        if scene.camera.eye[2] > 1e6:
            image["depth"][3, 4] = np.nextafter(image["depth"][3, 4], 0.0)
        return image

    return render


def test_a_shape_that_stays_where_it_is_excuses_no_difference(monkeypatch):
    plane = {"type": "plane", "normal": [0.0, 1.0, 0.0], "offset": 0.0}
    scene = scene_of(shape=[{"type": "sphere"}, plane])
    assert check_scaling(scene).ok
    monkeypatch.setattr(module, "render", with_one_bit(module.render))
    assert not check_scaling(scene).ok


def test_a_scene_without_shapes_has_nothing_to_scale():
    assert check_scaling(scene_of(radius=None)).what == "no shape to scale"
