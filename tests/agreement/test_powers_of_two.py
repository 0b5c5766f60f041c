"""A power of two scales a scene exactly: no rounding moves, so t scales too, and all else keeps its bits.

The scale is the last step of every shape's `to_world`, and the packed arrays follow exactly: matrix products,
inverses, lengths and normals are sums, products, quotients and square roots, and none of those rounds
elsewhere when its operands are multiplied by powers of two, short of overflow and underflow. Triangles have
the highest power, a length to the third: 2^-300 becomes 2^-900, and where two such products cancel, what is
left of them is still above 2^-1022.
"""

import numpy as np
import pytest
from hard_rays import hard_rays
from random_scenes import VIEWS, name, random_camera, random_scene
from same_bits import Arrays, assert_same_bits, without_signed_zeros
from scaled_scenes import LENGTHS, scaled_scene

from caster.cameras import CAMERAS, Pinhole
from caster.rendering.hits import cast, packed
from caster.rendering.images import camera_rays, render
from caster.scene.files import load_scene
from caster.scene.model import Film, Scene
from caster.shapes import SHAPES

POWERS = (-300, -20, -1, 1, 20, 300)
LARGEST_OF_TRIANGLES = 40  # further out, faces are left out (caster.geometry.world_space.LARGEST_COORDINATE)
UV_ARE_LENGTHS = ("plane",)
CAMERA_RATIOS = ("type", "direction", "up", "fov", "fov_axis", "principal_point")
IMAGES = ("hit", "depth", "position", "normal", "shading_normal", "albedo", "diffuse", "shape_id", "prim_id")


def what_is_cast(scene: Scene, o: np.ndarray, d: np.ndarray, unit: float) -> Arrays:
    """What rays meet, lengths counted in units of `unit`."""
    hits = cast(scene, o * unit, d)
    uv = hits.surface.uv.copy()
    uv[[scene.shapes[k].type in UV_ARE_LENGTHS for k in hits.shape_id]] /= unit
    ids = {"shape": hits.shape_id, "prim": hits.prim_id}
    return ids | hits.surface._asdict() | {"t": hits.t / unit, "uv": uv, "p": hits.surface.p / unit}


def count_hits_where_scales_agree(scene: Scene, power: int, o: np.ndarray, d: np.ndarray) -> int:
    """How many rays hit; fails where a scene 2^power times as large is not exactly that."""
    expected = what_is_cast(scene, o, d, 1.0)
    got = what_is_cast(scaled_scene(scene, power), o, d, 2.0**power)
    assert_same_bits(expected, got, f"scaled by 2^{power}")
    return int((expected["shape"] >= 0).sum())


@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_a_power_of_two_scales_t_exactly_and_keeps_the_rest(shape):
    rng = np.random.default_rng([40, SHAPES.index(shape)])
    hits, triangles = 0, hasattr(shape, "mesh")
    for power in (-300, 1, LARGEST_OF_TRIANGLES) if triangles else POWERS:
        scene = random_scene(rng, [shape], Pinhole, offset=rng.uniform(0.0, 10.0))
        families = hard_rays(packed(scene), rng, 50)
        del families["unnormalised"]  # a length of 1e30 to the third power leaves no room for 2^300
        for o, d in families.values():
            hits += count_hits_where_scales_agree(scene, power, o, d)
    assert hits >= 250


@pytest.mark.parametrize("camera", VIEWS, ids=name)
def test_a_power_of_two_scales_a_camera_s_rays_exactly(camera):
    rng = np.random.default_rng([41, VIEWS.index(camera)])
    for power in POWERS:
        factor = 2.0**power
        small = random_camera(camera, rng)
        film = Film(width=37, height=23)
        expected = camera_rays(Scene(film=film, camera=small))
        rays = camera_rays(scaled_scene(Scene(film=film, camera=small), power))
        lengths = {key: getattr(rays, key) / factor for key in ("o", "t_min", "t_max")}
        lengths["t_max"] = np.where(rays.t_max < 0.0, rays.t_max, lengths["t_max"])  # no ray at all
        assert_same_bits(expected._asdict(), lengths | {"d": rays.d}, f"scaled by {factor}")


def test_it_is_known_of_every_field_of_a_camera_whether_it_is_a_length():
    assert {name for camera in CAMERAS for name in camera.model_fields} == {*LENGTHS, *CAMERA_RATIOS}


@np.errstate(all="ignore")  # of kernels in plain Python
@pytest.mark.parametrize("name", ["one-sphere", "transforms", "lights-and-shadows", "crop-window", "orthographic-clip"])
def test_a_power_of_two_scales_an_image_exactly(name):
    """A threshold in scene units would show as other bits."""
    scene = load_scene(f"scenes/{name}.toml").with_film(width=20, height=16)
    expected = render(scene, IMAGES)
    for power in (-24, 40, -150):
        image = render(scaled_scene(scene, power), IMAGES)
        found = {each: np.ldexp(a, -power) if each in ("depth", "position") else a for each, a in image.items()}
        assert_same_bits(without_signed_zeros(expected), without_signed_zeros(found), f"scaled by 2^{power}")
