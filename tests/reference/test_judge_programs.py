"""The programs of the judge's side in docs/api.md work as written."""

import json

import numpy as np
import pytest
from programs import FOLDER, run_program

import caster
import mitsuba_ref
from caster.image.channels import write_render
from mitsuba_ref.judge.verdict import AGREE, WRONG

PROGRAMS = sorted(FOLDER.glob("judge_*.py"))
SCENE = """
[film]
width = 24
height = 18
[camera]
type = "pinhole"
eye = [0.5, 0.75, 4]
look_at = [0, 0, 0]
[[shape]]
type = "cube"
to_world = [{rotate = {axis = [1, 2, 3], degrees = 40}}, {scale = 0.8}]
"""
MINE = """import caster
def trace(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t, hits.normal
"""
SAYS = {  # a part of what each prints
    "judge_function": "12 scenes: 12 pass, 0 fail",
    "judge_failing_pixels": "'agree': ",
    "judge_images": "PASS",
    "judge_json": "True",
    "judge_pytest": "2 passed",
    "judge_pixel": "pixel (12, 9)",
    "judge_hits": "1 pass, 0 fail",
    "judge_export": "1 shapes;",
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "mine.py").write_text(MINE)
    scene = caster.load_scene(tmp_path / "scene.toml")
    write_render(str(tmp_path / "ours.exr"), scene, [caster.render(scene, ("depth",))], "scene.toml")
    return tmp_path


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_a_program_works_as_written(path, folder):
    assert SAYS[path.stem] in run_program(path, folder)


def shifted(scene, o, d):
    """Every seventh t is too large."""
    hits = caster.cast(scene, o, d)
    t = hits.t.copy()
    t[::7] *= 1.001
    return t, hits.normal


def test_a_verdict_has_every_failing_pixel_with_its_numbers(folder, monkeypatch):
    """Also of a film that is judged in bands."""
    from mitsuba_ref.judge import pipeline

    scene = caster.load_scene(folder / "scene.toml")
    whole = mitsuba_ref.validate(scene, candidate=shifted).scenes[0]
    monkeypatch.setattr(pipeline, "LARGEST_WHOLE_FILM", 100)
    monkeypatch.setattr(pipeline, "BAND_PIXELS", 24 * 7)
    banded = mitsuba_ref.validate(scene, candidate=shifted).scenes[0]
    assert any("bands" in note for note in banded.notes)
    depth = {side: aovs["depth"] for side, aovs in whole.images.items()}
    for found in (whole, banded):
        wrong = found.classes == mitsuba_ref.CLASSES.index(WRONG)
        assert found.classes.dtype == np.uint8 and found.classes.shape == (18, 24)
        assert np.array_equal(found.classes, whole.classes) and wrong.sum() == found.counts[WRONG] > 20
        hit = wrong | (found.classes == mitsuba_ref.CLASSES.index(AGREE)) & found.images["ours"].hit
        assert hit.sum() == found.counts[WRONG] + found.counts[AGREE]
        pixels = found.failing_pixels()
        assert [[pixel.y, pixel.x] for pixel in pixels] == np.argwhere(wrong).tolist()
        for pixel in pixels:
            assert (pixel.verdict, pixel.check) == (WRONG, "depth")
            assert pixel.subject == depth["ours"][pixel.y, pixel.x]
            assert pixel.reference == depth["reference"][pixel.y, pixel.x]
            error = abs(pixel.subject - pixel.reference)
            assert 0.0 < pixel.bound < error and pixel.ratio == pytest.approx(error / pixel.bound, rel=1e-2)


def test_texts_of_a_verdict_are_short_and_name_cause_and_replay(folder):
    verdict = mitsuba_ref.validate([folder / "scene.toml", "builtin:needles"], candidate=shifted, size=(16, 16))
    lines = str(verdict).splitlines()
    assert lines[0] == "2 scenes: 0 pass, 2 fail: scene, needles" and len(lines) <= 14
    assert "t is off: behind what is hit" in str(verdict) and "mitsuba-ref probe" in str(verdict)
    assert (
        len(repr(verdict)) < 200
        and "t is off" in repr(verdict)
        and all(len(repr(scene)) < 60 for scene in verdict.scenes)
    )
    assert not json.loads(json.dumps(verdict.to_dict()))["ok"]


def test_only_what_was_compared_has_images(folder):
    def broken(scene, o, d):
        raise RuntimeError("no idea")

    (found,) = mitsuba_ref.validate(folder / "scene.toml", candidate=broken).scenes
    with pytest.raises(ValueError, match="scene has no images: the candidate gave no answer to judge: broken raised"):
        found.failing_pixels()


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda: mitsuba_ref.validate("scene.toml", candidate=42), TypeError, "expected a function.* got 42"),
        (lambda: mitsuba_ref.validate("scene.toml", precision="float32"), TypeError, "expected a candidate beside"),
        (lambda: mitsuba_ref.validate("scene.toml", size=32), TypeError, "size: expected .width, height., got 32"),
        (lambda: mitsuba_ref.validate(), TypeError, "expected a scene, or builtin='triangles'"),
        (lambda: mitsuba_ref.validate("scene.toml", size=(0, 9)), caster.SceneError, "--size 0 9"),
        (lambda: mitsuba_ref.validate("nothing.toml"), caster.SceneError, "nothing.toml: expected a scene file"),
        (lambda: mitsuba_ref.probe_pixel("scene.toml", 99, 0), caster.SceneError, "expected 0 <= x < 24"),
        (lambda: mitsuba_ref.compare_exr(3, "ours.exr"), TypeError, "expected the path of an EXR file"),
        (lambda: mitsuba_ref.judge_hits("scene.toml", np.zeros((2, 7)), {}), caster.SceneError, "shape .n, 8."),
    ],
)
def test_wrong_arguments_are_exceptions_not_verdicts(folder, monkeypatch, call, error, says):
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=says):
        call()


def test_without_mitsuba_there_is_an_exception_and_no_verdict(folder, monkeypatch):
    from mitsuba_ref.reference import variants

    monkeypatch.setattr(variants, "usable_variants", lambda: variants.Variants(False, None, "No module named 'drjit'"))
    calls = mitsuba_ref.validate, lambda scene: mitsuba_ref.probe_pixel(scene, 3, 3), mitsuba_ref.render_reference
    for call in calls:
        with pytest.raises(caster.SceneError, match="pip install mitsuba=="):
            call(caster.load_scene(folder / "scene.toml"))
