"""A power of two scales a scene exactly: depth and position scale too, and everything else keeps its bits.

Products, sums, quotients, roots and matrix inverses round alike when their operands are multiplied by powers of two,
short of overflow and underflow. A threshold in scene units shows as other bits.
"""

import numpy as np
import pytest
from same_bits import assert_same_bits, without_signed_zeros

from caster.cameras import CAMERAS
from caster.rendering.images import render
from caster.scene.files import load_scene
from caster.scene.model import Scene

# Fields of cameras that are lengths. t_max counts in lengths of the direction of a camera of type `ray`, which stays.
LENGTHS = ("eye", "look_at", "origin", "near", "far", "width", "t_max")
RATIOS = ("type", "direction", "up", "fov", "fov_axis", "principal_point")
AOVS = ("hit", "depth", "position", "normal", "shading_normal", "albedo", "diffuse", "shape_id", "prim_id")
SCENES = (
    "one-sphere",
    "every-shape",
    "transforms",
    "lights-and-shadows",
    "crop-window",
    "orthographic-clip",
    "fisheye",
)


def with_lengths(element, factor, names):
    """A copy with the named fields multiplied, those of them that are set."""
    given = {name: getattr(element, name, None) for name in names}
    return element.model_copy(update={name: np.multiply(factor, x) for name, x in given.items() if x is not None})


def scaled_scene(scene: Scene, power: int) -> Scene:
    """The scene 2^power times as large, seen from as many times as far: lights reach it as before."""
    factor = 2.0**power
    lights = []
    for light in scene.lights:
        if hasattr(light, "position"):  # a point light sends factor^2 as much, so that the same arrives
            brighter = {"intensity": np.multiply(factor * factor, light.intensity)}
            light = with_lengths(light, factor, ("position",)).model_copy(update=brighter)
        lights.append(light)
    shapes = tuple(each.model_copy(update={"to_world": (*each.to_world, {"scale": factor})}) for each in scene.shapes)
    camera = with_lengths(scene.camera, factor, LENGTHS)
    return scene.model_copy(update={"camera": camera, "lights": tuple(lights), "shapes": shapes})


def test_it_is_known_of_every_field_of_a_camera_whether_it_is_a_length():
    assert {name for camera in CAMERAS for name in camera.model_fields} == {*LENGTHS, *RATIOS}


@np.errstate(all="ignore")  # of kernels in plain Python
@pytest.mark.parametrize("name", SCENES)
def test_a_power_of_two_scales_an_image_exactly(name):
    scene = load_scene(f"scenes/{name}.toml").with_film(width=20, height=16)
    expected = render(scene, AOVS)
    for power in (-24, 40, -150):
        image = render(scaled_scene(scene, power), AOVS)
        found = {each: np.ldexp(a, -power) if each in ("depth", "position") else a for each, a in image.items()}
        assert_same_bits(without_signed_zeros(expected), without_signed_zeros(found), f"scaled by 2^{power}")
