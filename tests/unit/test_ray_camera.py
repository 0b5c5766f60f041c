"""The camera `ray` gives its one ray, to the bit, at every pixel."""

import numpy as np
import pytest

from caster import Film, Ray, Scene, SceneError, Sphere, cast, render
from caster.rendering.images import camera_rays, culling_for
from caster.scene.files import scene_from_text

LINE = '[camera]\ntype = "ray"\norigin = {o}\ndirection = {d}\n'


def test_every_pixel_casts_the_ray_as_it_was_written():
    text = LINE.format(o='["0x1.8p-3", 0.1, 5]', d='[-0.0, "-0x1.5p-1070", -3e20]') + "t_max = 7.5\n"
    scene = scene_from_text("[film]\nwidth = 3\nheight = 2\n" + text)
    rays = camera_rays(scene)
    o, d = np.array([0.1875, 0.1, 5.0]), np.array([-0.0, -float.fromhex("0x1.5p-1070"), -3e20])
    assert rays.o.tobytes() == np.tile(o, (6, 1)).tobytes()
    assert rays.d.tobytes() == np.tile(d, (6, 1)).tobytes()
    assert rays.t_min.tolist() == [0.0] * 6 and rays.t_max.tolist() == [7.5] * 6


@pytest.mark.parametrize("length", ["0x1p-1074", "1e-300", "1e300", "1.7e308"])
def test_a_direction_without_a_square_is_brought_to_one(length):
    """By a power of two: what is hit, and its depth, are those of any other length."""
    ball = '[[shape]]\ntype = "sphere"\n'
    depths = []
    for size in (length, "1"):
        text = LINE.format(o="[0.25, 0, 5]", d=f'[0, 0, "-{size}"]' if size.startswith("0x") else f"[0, 0, -{size}]")
        depths.append(
            render(scene_from_text("[film]\nwidth = 1\nheight = 1\n" + text + ball), ("depth",))["depth"][0, 0]
        )
    assert depths[0] == depths[1] == pytest.approx(5 - np.sqrt(1 - 0.0625), abs=1e-14)


def test_it_sees_what_cast_sees():
    balls = [Sphere(center=(0.1, 0.2, -3.0)), Sphere(center=(0.1, 0.2, -6.0), radius=0.5)]
    o, d = (0.3, 0.1, 2.0), (-0.02, 0.01, -0.5)
    scene = Scene(film=Film(width=2, height=2), camera=Ray(origin=o, direction=d), shapes=balls)
    hits = cast(scene, [o], [d])
    for culling in (None, "bvh", "brute-force"):
        aovs = render(scene, ("depth", "position", "shape_id"), culling=culling)
        assert aovs.hit.all() and (aovs["shape_id"] == hits.shape_id[0]).all()
        assert (aovs["depth"] == hits.t[0] * np.linalg.norm(d)).all()
        assert (aovs["position"] == hits.position[0]).all()
    assert culling_for(scene.camera.pack(2, 2)) == "bvh"


@pytest.mark.parametrize("length", [1.0, 2.0**-1000, 2.0**1000])
@pytest.mark.parametrize(("t_max", "hit"), [(5.9999, False), (6.0, True), (None, True)])
def test_the_ray_ends_at_t_max(t_max, hit, length):
    """Which counts in lengths of the direction, however long that is."""
    end = t_max and t_max / length
    ray = Ray(origin=(0, 0, 4), direction=(0, 0, -0.5 * length), t_max=end)
    scene = Scene(film=Film(width=1, height=1), camera=ray, shapes=[Sphere()])
    assert bool(render(scene).hit.all()) is hit


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("origin = [0, 0, 0]\ndirection = [0, -0.0, 0]\n", "direction must be a direction, so not all zero"),
        ("origin = [0, 0, 0]\ndirection = [0, 0, 1]\nt_max = 0\n", "t_max must be > 0, got 0"),
        ("origin = [0, 0, 0]\ndirection = [0, 0, 1]\nup = [0, 1, 0]\n", "up is an unknown key"),
    ],
)
def test_a_ray_that_is_none_is_refused_with_its_line(lines, says):
    with pytest.raises(SceneError, match=r"scene:\d+:\d+: camera") as error:
        scene_from_text('[camera]\ntype = "ray"\n' + lines, origin="scene")
    assert says in str(error.value)
