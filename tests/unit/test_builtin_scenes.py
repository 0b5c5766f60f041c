"""Built-in scenes, mesh files as scenes, and runs that only new failures fail."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import PYPROJECT, ROOT, shipped
from verdict_factory import scene

from caster.description.errors import SceneError
from caster.rendering.images import render
from caster.scene.files import load_scene
from mitsuba_ref.cli.validate import exit_code
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, SceneCheck
from mitsuba_ref.report import validation
from mitsuba_ref.runner.many_scenes import JudgeOptions
from mitsuba_ref.runner.validation_run import ValidationRun, expected_toml, read_expected

BUILTIN = ROOT / "mitsuba_ref" / "runner" / "builtin"
SCENES = sorted(BUILTIN.glob("*/*.toml"))
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


# ---- the set in the wheel


def test_every_file_of_the_set_is_in_the_wheel():
    data = PYPROJECT["tool"]["setuptools"]["package-data"]
    packed = {path for pattern in data["mitsuba_ref.runner"] for path in BUILTIN.parent.glob(pattern)}
    assert packed == {path for path in BUILTIN.rglob("*") if path.is_file()}


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_builtin_scene_has_its_purpose_first_and_hits_something(path):
    assert path.read_text().startswith("# ") and len(path.read_text().partition("\n")[0]) <= 120
    depth = render(load_scene(path).with_film(width=24, height=24), ("depth",))["depth"]
    assert np.isfinite(depth).any()


# ---- a mesh file as a scene


def obj_of(corners) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES)])


def test_a_mesh_file_is_a_scene_whose_camera_sees_all_of_it(tmp_path):
    path = tmp_path / "tetrahedron.obj"
    path.write_text(obj_of(CORNERS))
    loaded = load_scene(path)
    mesh = loaded.shapes[0].mesh()
    assert np.array_equal(mesh.vertices[mesh.faces], CORNERS[np.array(FACES)])
    hit = render(loaded, ("hit",))["hit"]
    assert hit.any() and not (hit[0].any() or hit[-1].any() or hit[:, 0].any() or hit[:, -1].any())


@pytest.mark.parametrize(("scale", "place"), [(1e-20, 0.0), (1e12, 0.0), (1.0, 1e6)])
def test_the_camera_of_a_mesh_fits_its_size_and_place(tmp_path, scale, place):
    (tmp_path / "a.obj").write_text(obj_of(CORNERS * scale + place))
    hit = render(load_scene(tmp_path / "a.obj"), ("hit",))["hit"]
    assert 0.05 < hit.mean() < 0.9


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.ply", b"", "the file is empty"),
        ("a.obj", b"v 0 0 0\n", "no faces"),
        ("a.obj", b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n", "expected a mesh with an extent"),
        ("a.xyz", b"0 0 0\n", "unknown scene format"),
    ],
)
def test_a_mesh_that_cannot_be_seen_is_an_error_with_its_name(here, name, data, message):
    Path(name).write_bytes(data)
    with pytest.raises(SceneError, match=f"^{name}: .*{message}"):
        load_scene(name)


# ---- scenes that are waived


def judged(*scenes, **settings):
    """The verdict of a run over these, as it waives them."""
    run = ValidationRun([], JudgeOptions(), **settings)
    run.done = [run._recorded(each) for each in scenes]
    return replace(run.verdict(), scene_count=len(scenes), names=tuple(each.name for each in scenes))


def declined(name):
    return scene(name, ok=False, problem="declined", unsupported=True)


def listed(tmp_path, *scenes):
    (tmp_path / "expected.toml").write_text(expected_toml(scenes))
    return read_expected(str(tmp_path / "expected.toml"))


def test_a_declined_scene_fails_unless_such_scenes_are_skipped():
    some = scene("a"), declined("b")
    assert not judged(*some).ok
    found = judged(*some, skip_unsupported=True)
    assert found.ok and found.waived == {UNSUPPORTED: 1} and exit_code(found, []) == 0


def test_a_run_in_which_all_is_declined_or_too_little_judged_fails():
    nothing = judged(declined("a"), skip_unsupported=True)
    assert not nothing.ok and exit_code(nothing, []) == 5
    few = judged(scene("a"), declined("b"), skip_unsupported=True, min_scenes=2)
    assert not few.ok and exit_code(few, []) == 1


def test_known_failures_pass_and_no_others(tmp_path):
    known = listed(tmp_path, scene("a"), scene("b", ok=False))
    found = judged(scene("a"), scene("b", ok=False), expected=known)
    assert found.ok and found.scenes[1].waived == EXPECTED and not found.scenes[1].ok
    assert not judged(scene("a", ok=False), scene("b", ok=False), expected=known).ok
    more = replace(scene("b", ok=False), counts=scene("b", ok=False).counts | {"wrong": 2})
    assert not judged(scene("a"), more, expected=known).ok, "more pixels than are known"
    both = replace(scene("b", ok=False), checks=(SceneCheck("camera", 2.0, "direction at (0, 0)"),))
    assert not judged(scene("a"), both, expected=known).ok, "another check beside the known one"
    broken = scene("b", ok=False, problem="killed")
    assert not judged(scene("a"), broken, expected=known).ok, "another failure than the known one"


def test_a_fixed_failure_is_named(tmp_path):
    found = judged(scene("a"), expected=listed(tmp_path, scene("a", ok=False)))
    assert found.ok and found.fixed == ("a",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("failure = 3", r":1:1: .*failure must be a list"),
        ('[[failure]]\nscene = "a"\nchecks = []\npixels = -1', r":4:1: failure.0.: pixels must be >= 0"),
        (
            '[[failure]]\nscene = "a"\nchecks = []\npixels = 1\nwhi = "x"',
            r":5:1: failure.0.: whi is an unknown key, did",
        ),
        ("nonsense", "not valid TOML: expected '='"),
        ("a." * 99 + "a = 1", "expected keys of at most 32 parts"),
        ("a = " + "[" * 9999 + "]" * 9999, "nested too deeply"),
    ],
)
def test_a_damaged_list_of_known_failures_is_an_error(tmp_path, text, message):
    (tmp_path / "expected.toml").write_text(text)
    with pytest.raises(SceneError, match=message):
        read_expected(str(tmp_path / "expected.toml"))


def test_a_film_beyond_the_memory_is_refused_with_the_numbers(monkeypatch):
    scene = shipped("one-sphere", 20_000, 20_000)
    monkeypatch.setattr(validation, "available_bytes", lambda: 8e9)
    with pytest.raises(SceneError, match=r"20000 x 20000 pixels need some 580\.0 GB .* and 8\.0 GB are left"):
        validation.check_memory(scene)
    validation.check_memory(scene.with_film(crop=(0, 0, 100, 100)))
