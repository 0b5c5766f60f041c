"""Non-rectilinear cameras, where screen bounds of spheres and corners are hardest to compute."""

from typing import Any

import pytest
from same_bits import assert_same_bits

from caster.cameras import Fisheye, Panorama
from caster.rendering.images import render
from caster.scene.model import Scene

BENDING = (Fisheye, Panorama)
AHEAD: dict[str, Any] = {"eye": (0.0, 0.0, 0.0), "direction": (0.0, 0.0, 1.0), "up": (0.0, 1.0, 0.0)}
FILM = {"width": 128, "height": 128}


def assert_cullings_agree(camera: Any, shapes: list[dict[str, Any]], film: dict[str, int] = FILM) -> None:
    scene = Scene(film=film, camera=camera, shapes=shapes)
    every = render(scene, ("depth", "normal"), culling="brute-force")
    assert every.hit.any()
    assert_same_bits(every, render(scene, ("depth", "normal"), culling="raster"), "raster")


@pytest.mark.parametrize("camera", BENDING)
@pytest.mark.parametrize(
    "balls",
    [((0.0, 0.5), (0.0, 0.1)), ((1e-130, 0.5), (1e-130, 0.1)), ((3e-130, 1e-130), (1e-130, 7e-131))],
    ids=["around the eye", "around it, too near for squares", "tiny"],
)
def test_of_two_spheres_whose_distance_has_no_square_the_nearer_one_is_detected(camera, balls):
    """Nothing may be said of how near they are. balls: distance and radius of the farther one, and of the nearer."""
    spheres = [{"type": "sphere", "center": (0.0, 0.0, z), "radius": radius} for z, radius in balls]
    assert_cullings_agree(camera(**AHEAD), spheres)


@pytest.mark.parametrize("camera", BENDING)
def test_a_corner_straight_behind_has_no_image(camera):
    """To either side of it, or where it rounds to, the picture would be anywhere."""
    corners = [(0.0, 0.0, -1.0), (0.9, 0.3, 0.1), (0.9, 0.32, 0.12)]
    assert_cullings_agree(camera(**AHEAD), [{"type": "triangle", "vertices": corners}], {"width": 256, "height": 256})


AROUND = [(0.3, 0.1, -3), (-0.5, -0.9, -2.8), (0.1, 3, -0.1), (-0.2, -3, 0.1), (3, 0.2, 0.1), (-3, 0.1, -0.4)]


@pytest.mark.parametrize("camera", BENDING)
@pytest.mark.parametrize("kind", ["sphere", "cylinder", "disk", "cube"])
def test_what_lies_around_the_eye_is_seen_whole(camera, kind):
    """Behind it, where a panorama has its seam, above, below and to the sides."""
    ahead = {"type": "sphere", "center": (0, 0, 3), "radius": 0.5}
    shaped = {"scale": (0.5, 0.4, 0.45)}, {"rotate": {"axis": (1, 2, 3), "degrees": 40}}
    for place in AROUND:
        other = {"type": kind, "to_world": (*shaped, {"translate": place})}
        assert_cullings_agree(camera(**AHEAD), [ahead, other], {"width": 60, "height": 30})


@pytest.mark.parametrize("aside", [1.6e-162, 1e-170, 5e-324])
def test_a_sphere_hardly_off_the_axis_of_a_fisheye_is_seen_whole(aside):
    """The square of so short a way has lost bits, or all of them, to underflow."""
    ball = {"type": "sphere", "center": (aside, 0.0, 1.0), "radius": 0.05}
    assert_cullings_agree(Fisheye(**AHEAD), [ball], {"width": 512, "height": 512})
