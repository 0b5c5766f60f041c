"""Arrays of a report: to the bit where that is promised, never too small where digits are dropped."""

import base64
import zlib

import numpy as np
import pytest

import caster
from caster.geometry.packing import packed as pack_scene
from mitsuba_ref.reference.shared_input import shared_rays
from mitsuba_ref.report.evidence import film_projection, triangle_edges
from mitsuba_ref.report.scene_record import base_bits, coarse, narrowest, packed, rounded

ODD = [0.0, -0.0, 1.5, -2.25, np.inf, -np.inf, np.nan, 5e-324, 1e-45, 3.4e38, np.pi]


def unpacked(found, like=None):
    """The way back, as page/arrays.js has it."""
    dtype = np.dtype(f"<{found['type']}")
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found["z"])), np.uint8)
    bits = np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T).view(f"<u{dtype.itemsize}").ravel()
    if "delta" in found:
        bits = np.cumsum(bits, dtype=bits.dtype)
    if "xor" in found:
        bits = bits ^ base_bits(like, dtype)
    return bits.view(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.uint8])
def test_what_goes_in_comes_out_to_the_bit(dtype):
    numbers = np.random.default_rng(4).normal(0.0, 40.0, (300, 3))
    values = numbers.astype(dtype) if dtype != np.uint8 else np.abs(numbers).astype(dtype)
    assert unpacked(packed(values)).tobytes() == np.ascontiguousarray(values.T).tobytes()


def test_bits_are_taken_off_the_reference_and_put_back():
    with np.errstate(over="ignore"):
        reference = np.array(ODD, np.float64).astype(np.float32)
    ours = np.array([*ODD[3:], *ODD[:3]], np.float64)
    for mine, theirs in ((ours, reference), (ours, reference.astype(np.float64)), (rounded(ours), reference)):
        assert unpacked(packed(mine, theirs), theirs).tobytes() == mine.tobytes()


def test_float32_only_where_nothing_is_lost():
    assert narrowest(np.array([1.5, np.nan, np.inf])).dtype == np.float32
    assert narrowest(np.array([1.5, 0.1])).dtype == np.float64


def test_shares_are_never_reported_smaller_than_they_are():
    numbers = 10.0 ** np.random.default_rng(4).uniform(-50.0, 50.0, 5000)
    told = coarse(numbers).astype(np.float64)
    assert np.all(told >= numbers)
    normal = (numbers > 2e-38) & (numbers < 3e38)
    assert np.all(told[normal] <= numbers[normal] * (1.0 + 2.0**-11 + 2.0**-22))


# ---- projected edges


def rays_of(camera, width=20, height=14):
    scene = caster.Scene(camera=camera, film=caster.Film(width=width, height=height), shapes=[caster.Sphere()])
    rays = shared_rays(scene)
    return scene, rays.o.astype(np.float64), rays.d.astype(np.float64)


STRAIGHT = {
    "pinhole": caster.Pinhole(eye=(1, 2, 5), look_at=(0.3, 0, 0), fov=50.0),
    "shifted": caster.Pinhole(eye=(1, 2, 5), look_at=(0.3, 0, 0), principal_point=(0.2, -0.1)),
    "upside down": caster.Pinhole(eye=(1, 2, 5), look_at=(0.3, 0, 0), up=(0, -1, 0.3), fov=100.0),
    "orthographic": caster.Orthographic(eye=(1, 2, 5), look_at=(0.3, 0, 0), width=3.0),
}


@pytest.mark.parametrize("camera", STRAIGHT.values(), ids=STRAIGHT)
def test_a_point_on_a_ray_is_projected_to_the_centre_of_its_pixel(camera):
    scene, o, d = rays_of(camera)
    film = film_projection(scene, o, d)
    assert film is not None
    y, x = np.mgrid[0:14, 0:20] + 0.5
    pixels = np.column_stack([x.ravel(), y.ravel()])
    t = np.linspace(0.5, 70.0, len(o))[:, None]
    points, last = o + t * d, len(o) - 1
    found = film.segments(np.stack([points, points[::-1]], axis=1))
    assert np.abs(found - np.hstack([pixels, pixels[::-1]])).max() < 0.001
    assert len(found) == last + 1


def test_an_edge_that_passes_the_eye_ends_before_it_and_one_behind_it_is_left_out():
    scene, o, d = rays_of(STRAIGHT["pinhole"])
    film = film_projection(scene, o, d)
    ahead, behind = o[0] + 9 * d[31], o[0] - 9 * d[31]
    aside = behind + np.array([0.4, 0.0, 0.0])
    found = film.segments(np.array([[ahead, aside], [behind, aside]]))
    assert found.shape == (1, 4) and np.abs(found[0, :2] - (11.5, 1.5)).max() < 0.001
    assert np.abs(found[0, 2:]).max() > 1000.0  # towards the plane of the eye


def test_an_edge_that_two_triangles_share_is_drawn_once():
    scene = caster.Scene(shapes=[caster.Cube()], camera=STRAIGHT["pinhole"])
    edges = triangle_edges(pack_scene(scene), np.arange(12))
    assert edges.shape == (18, 2, 3) and len(np.unique(edges.reshape(18, 6), axis=0)) == 18
