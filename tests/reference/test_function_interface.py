"""A Python function may take t_min and t_max and return ids: a caster gets the same verdict through each interface."""

import numpy as np
import pytest
from candidates import ours

import caster
import mitsuba_ref

SCENE = """
[film]
width = 24
height = 18
[camera]
type = "pinhole"
eye = [0.5, 0.75, 6]
look_at = [0, 0, 0]
[[shape]]
type = "spheres"
centers = [[-0.75, 0, 0], [0.5, 0.25, -0.5], [0, 0.75, 0.25]]
radius = 0.375
to_world = [{scale = [1, 2, 1]}]
[[shape]]
type = "cube"
to_world = [{scale = 0.5}, {translate = [0.75, -0.75, 0]}]
[[shape]]
type = "cube"
to_world = [{scale = 0.25}, {translate = [-0.75, -1, 0.5]}]
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return caster.load_scene(tmp_path / "scene.toml")


def first_of_each(scene):
    """Numbers of the first primitives of the shapes that are traced: cubes are meshes of twelve triangles."""
    counts = [12 if shape.type == "mesh" else 1 for shape in scene.shapes]
    return np.cumsum([0, *counts[:-1]])


def numbered(scene, o, d):
    hits = caster.cast(scene, o, d)
    first = first_of_each(scene)
    return hits.t, hits.normal, np.where(hits.shape_id >= 0, first[hits.shape_id] + hits.prim_id, -1)


def limited(scene, o, d, t_min, t_max):
    hits = caster.cast(scene, o, d)
    assert t_min.shape == t_max.shape == (len(o),) and t_min.dtype == t_max.dtype == np.float64
    t = np.where(hits.t > t_min, hits.t, caster.cast(scene, o + t_min[:, None] * d, d).t + t_min)
    inside = t <= t_max
    return np.where(inside, t, np.inf), np.where(inside[:, None], hits.normal, 0.0)


def careless(scene, o, d, t_min, t_max):
    """It takes the limits, and does not heed them."""
    return ours(scene, o, d)


@pytest.mark.parametrize("trace", [ours, numbered, limited])
def test_the_same_caster_passes_through_each_interface(scene, trace):
    verdict = mitsuba_ref.validate(scene, candidate=trace)
    (found,) = verdict.scenes
    assert verdict.ok, str(verdict)
    assert ("shape_id" in found.unjudged) == (trace in (ours, limited))
    assert len(verdict.checks) == (trace is limited)


@pytest.mark.parametrize("shape", ["sphere", "mesh"])
def test_one_wrong_number_fails(scene, shape):
    """Also of spheres that are described one by one, whose numbers are those of further shapes."""

    def wrong(scene, o, d):
        t, n, ids = numbered(scene, o, d)
        hits = caster.cast(scene, o, d)
        kinds = np.array([shape.type for shape in scene.shapes])
        row = np.flatnonzero((hits.shape_id >= 0) & (kinds[hits.shape_id] == shape))[3]
        return t, n, np.where(np.arange(len(ids)) == row, ids + 1, ids)

    verdict = mitsuba_ref.validate(scene, candidate=wrong)
    assert verdict.scenes[0].counts["wrong"] == 1, str(verdict)


def test_a_function_may_return_none_for_numbers(scene):
    assert mitsuba_ref.validate(scene, candidate=lambda scene, o, d: (*ours(scene, o, d), None)).ok


def test_limits_that_a_function_takes_have_to_be_heeded(scene):
    verdict = mitsuba_ref.validate(scene, candidate=careless)
    assert verdict.scenes[0].ok and not verdict.ok
    assert "ray_limits" in [check.name for check in verdict.checks if not check.ok]


@pytest.mark.parametrize(
    ("returned", "says"),
    [
        (lambda t, n: (t, n, np.zeros(len(t))), "prim_id: expected whole numbers, got float64"),
        (lambda t, n: (t, n, np.zeros(3, int)), r"prim_id: expected shape \(n,\)"),
        (lambda t, n: (t, n, t, t), r"got 4 of them; it is called as function\(scene, o, d\)"),
    ],
)
def test_ids_that_are_none_are_refused(scene, returned, says):
    verdict = mitsuba_ref.validate(scene, candidate=lambda scene, o, d: returned(*ours(scene, o, d)))
    with pytest.raises(ValueError, match=says):
        _ = verdict.scenes[0].classes
