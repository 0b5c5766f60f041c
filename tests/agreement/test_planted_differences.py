"""Each check of this folder sees the fault it is there for: planted here, one at a time."""

import numpy as np
import pytest
import test_any_rays
import test_cullings
import test_mirrors
import test_powers_of_two
import test_threads
from hard_rays import at_corners, at_random, scene_points
from random_fields import own_fields
from random_scenes import random_scene
from same_bits import assert_same_bits

from caster.cameras import Panorama, Pinhole
from caster.description.fields import Camera, Shape
from caster.rendering import rasterization, ray_tiles, threads
from caster.rendering.bvh_construction import bvh_of
from caster.rendering.hits import packed
from caster.shapes import Sphere, Torus


def a_scene(camera=Pinhole):
    return random_scene(np.random.default_rng(80), [Sphere, Torus], camera, count=6)


def some_rays(scene):
    return at_random(scene_points(packed(scene)), np.random.default_rng(81), 300)


def image() -> dict[str, np.ndarray]:
    return {"t": np.array([1.5, 0.0, np.inf, np.nan]), "prim": np.array([3, 0, -1, 7], np.int32)}


@pytest.mark.parametrize(
    ("name", "at", "value"),
    [("t", 0, np.nextafter(1.5, 2.0)), ("t", 1, -0.0), ("t", 2, -np.inf), ("t", 3, 0.0), ("prim", 2, 0)],
    ids=["last bit", "sign of zero", "sign of infinity", "NaN", "id of a miss"],
)
def test_one_changed_entry_is_detected(name, at, value):
    assert_same_bits(image(), image(), "untouched")
    changed = image()
    changed[name][at] = value
    with pytest.raises(AssertionError, match=rf"planted: {name}: 1 of 4 differ, first at \({at},\)"):
        assert_same_bits(image(), changed, "planted")


def test_an_array_of_another_type_or_shape_or_name_is_detected():
    for other in ({"t": np.zeros(4)}, {"t": np.zeros(3, np.float32)}, {"u": np.zeros(3)}):
        with pytest.raises(AssertionError, match="planted"):
            assert_same_bits({"t": np.zeros(3)}, other, "planted")


def test_a_screen_rectangle_cut_short_is_detected(monkeypatch):
    """Without the lower half of their rows hits are lost."""
    bound_hulls = rasterization.bound_hulls

    def narrow(prims, camera, window, spans, reach, start, stop):
        bound_hulls(prims, camera, window, spans, reach, start, stop)
        rows = spans.pixels[start:stop]
        rows[:, 3] = (rows[:, 1] + rows[:, 3]) // 2

    monkeypatch.setattr(rasterization, "bound_hulls", narrow)
    with pytest.raises(AssertionError, match="raster: "):
        test_cullings.count_hits_where_cullings_agree(a_scene())


def test_a_ray_lost_by_the_tree_is_detected(monkeypatch):
    cast_packets = ray_tiles.cast_packets

    def forgetful(prims, tree, base, count, *rest):
        cast_packets(prims, tree, base, count // 2, *rest)

    monkeypatch.setattr(ray_tiles, "cast_packets", forgetful)
    monkeypatch.setattr(test_cullings, "cullings_for", lambda scene: ("bvh",))
    with pytest.raises(AssertionError, match="bvh: "):
        test_cullings.count_hits_where_cullings_agree(a_scene(Panorama))
    scene = a_scene()
    with pytest.raises(AssertionError, match="a family: "):
        test_any_rays.count_hits_where_tree_agrees(scene, *some_rays(scene), "a family")


def test_boxes_too_small_are_detected():
    """The boxes of the tree drawn in by a thousandth: corners stick out."""
    scene = a_scene()
    rays = at_corners(scene_points(packed(scene)), np.random.default_rng(83), 300)
    for kind in packed(scene).kinds:
        inset = 1e-3 * (bvh_of(kind).boxes[:, 3:] - bvh_of(kind).boxes[:, :3])
        bvh_of(kind).boxes[:, :3] += inset
        bvh_of(kind).boxes[:, 3:] -= inset
    with pytest.raises(AssertionError, match="a family: "):
        test_any_rays.count_hits_where_tree_agrees(scene, *rays, "a family")


def test_a_band_that_threads_skip_is_detected(monkeypatch):
    parallel_for_pieces = threads.parallel_for_pieces

    def skipping(begin, pieces, workers, done=None):
        parallel_for_pieces(begin, pieces if workers == 1 else pieces[:-1], workers, done)

    monkeypatch.setattr(rasterization, "parallel_for_pieces", skipping)
    with pytest.raises(AssertionError, match="2 threads: "):
        test_threads.count_hits_where_threads_agree(a_scene(Panorama))


def test_a_scale_that_is_no_power_of_two_is_detected():
    scene = a_scene()
    with pytest.raises(AssertionError, match=r"scaled by 2\^1\.5: "):
        test_powers_of_two.count_hits_where_scales_agree(scene, 1.5, *some_rays(scene))


def test_a_mirror_that_is_a_last_bit_off_is_detected():
    scene = a_scene()
    with pytest.raises(AssertionError, match="mirrored by "):
        mirror = np.array([-np.nextafter(1.0, 2.0), 1.0, 1.0])
        test_mirrors.count_hits_where_mirrors_agree(scene, mirror, *some_rays(scene))


def test_a_new_field_without_random_values_is_named():
    class Cone(Shape):
        type: str = "cone"
        tip_angle: float = 1.0

    class Periscope(Camera):
        type: str = "periscope"
        mirrors: int = 2

    rng = np.random.default_rng(82)
    for cls, message in ((Cone, "cone: .* 'tip_angle': add a line"), (Periscope, "periscope: .* 'mirrors': add")):
        with pytest.raises(AssertionError, match=message + r".*tests/agreement/random_fields\.py"):
            own_fields(cls, rng, 1.0)
