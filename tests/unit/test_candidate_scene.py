"""A candidate is handed the scene in the very numbers that Mitsuba and exact arithmetic get."""

from pathlib import Path

import numpy as np
import pytest

from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32, as_given
from caster.scene.files import load_scene
from mitsuba_ref.subjects.subject import NoAnswer, checked_answer, scene_as_traced

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*.toml"))
NUMBERS = ("vertices", "faces", "center", "radius", "to_world", "to_object", "point")


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_traced_scene_packs_to_the_traced_numbers_without_any_rounding(path, tmp_path):
    scene = load_scene(path)
    packed = pack(scene, as_float32)
    traced = scene_as_traced(scene, packed, tmp_path)
    assert traced.film == scene.film and traced.camera == scene.camera
    assert traced.shape_names() == scene.shape_names()
    for there, here in zip(pack(traced, as_given).parts, packed.parts, strict=True):
        assert type(there) is type(here)
        for name in set(NUMBERS) & set(here._fields):
            assert np.array_equal(getattr(there, name), getattr(here, name)), name
        if "point" in here._fields:  # a plane: the normal is the same up to its length
            apart = np.cross(there.normal, here.normal)
            assert np.abs(apart).max() <= 2.0**-52


@pytest.mark.parametrize("path", SCENES[::6], ids=lambda path: path.stem)
def test_as_toml_it_loads_again(path, tmp_path):
    scene = load_scene(path)
    traced = scene_as_traced(scene, pack(scene, as_float32), tmp_path)
    (tmp_path / "scene.toml").write_text(traced.to_toml())
    assert load_scene(tmp_path / "scene.toml") == traced


def test_what_is_no_answer_at_a_pixel_is_noted_by_its_reason():
    t = np.array([1.0, np.nan, -1.0, -np.inf, np.inf, 1.0, 1.0, 1.0])
    n = np.tile([0.0, 0.0, 2.0], (8, 1))
    n[4], n[5], n[6] = np.nan, 0.0, [np.inf, 0, 0]
    found = checked_answer(t, n, 8)
    assert {why: np.flatnonzero(rows).tolist() for why, rows in found.broken.items()} == {
        "t is NaN": [1],
        "t is negative": [2, 3],
        "the normal is not finite on a hit": [6],
        "the normal has no length on a hit": [5],
    }
    assert found.n is not None and found.n[0].tolist() == [0.0, 0.0, 1.0] and not found.n[4].any()


@pytest.mark.parametrize(
    ("kinds", "precision"),
    [("dd", "float64"), ("ff", "float32"), ("df", "float32"), ("fd", "float32")],
)
def test_the_coarser_type_decides_the_bounds(kinds, precision):
    t, n = np.full(3, 0.1, kinds[0]), np.ones((3, 3), kinds[1])
    assert checked_answer(t, n, 3).precision == precision
    assert checked_answer(t, n, 3, precision="float64").precision == "float64"


def test_lists_are_arrays_too_and_nothing_else_is():
    assert checked_answer([1.0, 2.0], None, 2).n is None
    with pytest.raises(NoAnswer, match=r"expected shape \(n,\) = \(2,\), got \(2, 1\)"):
        checked_answer([[1.0], [2.0]], None, 2)
