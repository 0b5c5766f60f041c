"""Every public route to a pixel gives the bits of the whole image; the planted faults of tests/faults/routes.toml."""

import pytest

from caster.cameras import CAMERAS
from caster.scene.files import load_scene
from mitsuba_ref.judge.checks.thorough import LENGTHS, check_routes, check_scaling

SCENES = ("one-sphere", "inside-sphere", "cornell-box", "shared-edges-cube", "lights-and-shadows")
SCALED = (
    "one-sphere",
    "every-shape",
    "transforms",
    "lights-and-shadows",
    "crop-window",
    "orthographic-clip",
    "fisheye",
)


@pytest.mark.parametrize("name", SCENES)
def test_routes(name):
    found = check_routes(load_scene(f"scenes/{name}.toml"))
    assert found.ok, found.what


@pytest.mark.parametrize("name", SCALED)
def test_scales(name):
    found = check_scaling(load_scene(f"scenes/{name}.toml"))
    assert found.ok, found.what


def test_it_is_known_of_every_field_of_a_camera_whether_it_is_a_length():
    ratios = {"type", "direction", "up", "fov", "fov_axis", "principal_point"}
    of_lights = {"position", "intensity"}
    assert {name for camera in CAMERAS for name in camera.model_fields} == (LENGTHS.keys() - of_lights) | ratios
