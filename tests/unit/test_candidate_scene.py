"""A candidate is handed the scene in the very numbers that Mitsuba and exact arithmetic get."""

from dataclasses import replace

import numpy as np
import pytest
from marks import each_shipped_scene
from places import scene_of

import caster
from caster.geometry.packing import pack, packed
from caster.geometry.world_space import as_float32, as_given
from caster.scene.files import load_scene
from mitsuba_ref.error_model.bracket import CLAIMED_MISS
from mitsuba_ref.judge.adjudication import claims_of
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.subjects.ray_files import answer_of_numbered_hits
from mitsuba_ref.subjects.subject import checked_answer, scene_as_traced

NUMBERS = ("vertices", "faces", "center", "radius", "to_world", "to_object", "point")


@each_shipped_scene
@pytest.mark.slow("every shipped scene", every=3)
def test_the_traced_scene_packs_to_the_traced_numbers_without_any_rounding(path, tmp_path):
    scene = load_scene(path)
    packed = pack(scene, as_float32)
    traced = scene_as_traced(scene, packed, tmp_path)
    assert traced.film == scene.film and traced.camera == scene.camera
    assert [name for name in traced.shape_names() if name in scene.shape_names()] == scene.shape_names()
    again = pack(traced, as_given)
    assert again.first[-1] == packed.first[-1]
    parts = iter(again.parts)
    for i, here in enumerate(packed.parts):
        alone = [next(parts)]
        if len(here[0]) > len(alone[0][0]):  # each primitive is a shape
            alone += [next(parts) for _ in range(int(packed.first[i + 1] - packed.first[i]) - 1)]
        there = alone[0]
        assert {type(each) for each in alone} == {type(here)}
        for name in set(NUMBERS) & set(here._fields):
            numbers = np.concatenate([getattr(each, name) for each in alone])
            assert np.array_equal(numbers, getattr(here, name)), name
        if "point" in here._fields:  # a plane: the normal is the same up to its length
            apart = np.cross(there.normal, here.normal)
            assert np.abs(apart).max() <= 2.0**-52
    assert next(parts, None) is None


def clouds(to_world=()):
    grid = [(x, y, 0.0) for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)]
    return caster.Scene(
        film={"width": 60, "height": 50},
        camera={"type": "pinhole", "eye": (0.3, 0.2, 8.0), "look_at": (0.0, 0.0, 0.0), "fov": 40.0},
        shapes=[
            {"type": "spheres", "centers": grid, "radius": 0.6, "to_world": to_world},
            {"type": "plane", "point": (0.0, 0.0, -1.0), "normal": (0.0, 0.0, 1.0)},
        ],
    )


STRETCHED = ({"scale": (1.0, 0.9, 1.3)},)


@pytest.mark.parametrize(("to_world", "types"), [((), ["spheres", "plane"]), (STRETCHED, ["sphere"] * 9 + ["plane"])])
def test_a_cloud_is_handed_on_whole_and_its_ids_are_those_of_the_scene(to_world, types):
    seen = []

    class Named:
        name, reads_xml, takes_rays, takes_limits = "named", False, True, False

        def __init__(self, off=0):
            self.off = off

        def answer(self, request):
            seen.append(request.traced)
            hits = caster.cast(request.traced, request.rays.o, request.rays.d)
            prim = np.where(hits.hit, hits.packed.first[hits.shape_id] + hits.prim_id, -1)
            prim = np.where((prim > 0) & (prim < 9), prim + self.off, prim)
            named = {"t": hits.t, "n": hits.normal, "prim_id": prim}
            return answer_of_numbered_hits(named, request.rays, request.model.packed, None, limits=False)

    scene = clouds(to_world)
    verdict = validate_scene(Task(scene, "clouds", subject=Named()))
    assert verdict.ok, verdict.failures
    assert [shape.type for shape in seen[0].shapes] == types
    if to_world:  # of another sphere of the same cloud
        assert not validate_scene(Task(scene, "clouds", subject=Named(off=-1))).ok


def test_what_is_no_answer_at_a_pixel_is_noted_by_its_reason():
    t = np.array([1.0, np.nan, -1.0, -np.inf, np.inf, 1.0, 1.0, 1.0])
    n = np.tile([0.0, 0.0, 2.0], (8, 1))
    n[4], n[5], n[6] = np.nan, 0.0, [np.inf, 0, 0]
    found = checked_answer(t, n, np.ones(8, bool))
    assert {why: np.flatnonzero(rows).tolist() for why, rows in found.broken.items()} == {
        "t is NaN": [1],
        "t is negative": [2, 3],
        "the normal is not finite on a hit": [6],
        "the normal has no length on a hit": [5],
    }
    assert found.n is not None and found.n[0].tolist() == [0.0, 0.0, 1.0] and not found.n[4].any()


@pytest.mark.parametrize(
    ("kinds", "precision"), [("dd", "float64"), ("ff", "float32"), ("df", "float32"), ("fd", "float32")]
)
def test_the_coarser_type_decides_the_bounds(kinds, precision):
    t, n = np.full(3, 0.1, kinds[0]), np.ones((3, 3), kinds[1])
    assert checked_answer(t, n, np.ones(3, bool)).precision == precision
    assert checked_answer(t, n, np.ones(3, bool), precision="float64").precision == "float64"


def test_lists_are_arrays_too():
    assert checked_answer([1.0, 2.0], None, np.ones(2, bool)).n is None


def test_a_number_that_names_no_shape_claims_a_hit_of_another_one():
    """The bracket excuses a rounded candidate only at the shape that it names."""
    ids = {"shape_id": np.array([1, 0, -3, 5]), "prim_id": np.array([0, 0, 0, 0])}
    answer = replace(checked_answer([1.0, 2.0, 3.0, np.inf], None, np.ones(4, bool)), **ids)
    two = packed(scene_of(caster.Sphere(), caster.Sphere(center=(3, 0, 0))))
    assert claims_of(answer, two).shape.tolist() == [1, 0, 2, CLAIMED_MISS]
