"""`mitsuba-ref probe --candidate` reproduces what validate found at a pixel, with the size of the error."""

import json
import re
import shlex

import candidates
import mistakes
import numpy as np
import pytest
from mitsuba_scenes import scene_judge
from outputs import json_of
from places import ROOT, shipped

from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref import __main__
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import WRONG
from mitsuba_ref.probe.pixel import probe_candidate
from mitsuba_ref.probe.verdict import CandidatePixel
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.subjects.function import FunctionSubject
from mitsuba_ref.subjects.subject import Subject

HIT, MISS = (5, 4), (0, 0)  # of one-sphere


def small(name: str = "one-sphere") -> Scene:
    return shipped(name, 12, 9)


@pytest.fixture
def at(send):
    """Probe a pixel, with the resident Mitsuba process."""

    def look(trace: candidates.Trace | Subject, pixel=HIT, scene: Scene | None = None) -> CandidatePixel:
        asked = FunctionSubject(trace.__name__, trace) if callable(trace) else trace
        return probe_candidate(asked, scene or small(), pixel, send=send)

    return look


def test_a_replay_that_is_pasted_shows_the_pixel_again(monkeypatch, capsys, tmp_path):
    """The replay has film size, candidate and its options; Mitsuba's answers are shown beside the candidate's."""
    monkeypatch.chdir(ROOT)
    given = ["--size", "12", "9", "--candidate", "docs.candidates.textbook:trace"]
    given += ["--candidate-precision", "float32", "--candidate-timeout", "70"]
    verdict = tmp_path / "v.json"
    assert main(["validate", "scenes/inside-sphere.toml", *given, "--json", str(verdict)]) == 1
    (replay,) = re.findall(r"^      replay:    mitsuba-ref (.*)", capsys.readouterr().out, re.MULTILINE)
    assert replay.startswith("probe scenes/inside-sphere.toml 0 0 ") and shlex.split(replay)[4:] == given
    (scene,) = json_of(verdict)["scenes"]
    assert scene["failures"][0]["replay"] == f"mitsuba-ref {replay}"
    assert scene["replay"] == f"mitsuba-ref validate scenes/inside-sphere.toml {shlex.join(given)}"
    saved = tmp_path / "again.toml"
    assert main([*shlex.split(replay), "--json", "--save", str(saved)]) == 1
    found = json.loads(capsys.readouterr().out)
    assert load_scene(saved).camera.type == "ray"
    theirs, (witness, *others) = found["candidate"], found["witnesses"]
    assert (theirs["verdict"], theirs["ok"], theirs["precision"]) == (WRONG, False, "float32")
    assert "first root is behind the ray's origin" in theirs["why"] and "hit or miss" in theirs["why"]
    assert (witness["who"], witness["right"], witness["shape"]) == ("candidate", False, "miss")
    assert all(each["right"] for each in others) and found["verdict"] == "agree" and not found["ok"]


@pytest.mark.parametrize("trace", [candidates.ours, candidates.ours_rounded, candidates.without_normals])
def test_a_right_candidate_is_right_and_how_far_off_it_is_is_reported(at, trace):
    found = at(trace)
    assert (
        found.ok
        and found.verdict == "agree"
        and found.witness.right
        and found.why == "every quantity is within its bound"
    )
    assert found.witness.share < 1.0 and abs(found.witness.ulps) < 2.0
    if trace is candidates.without_normals:
        assert found.witness.normal_share is None and "normal" not in found.says
    else:
        assert found.witness.normal_share < 1.0
    nothing = at(trace, MISS)
    assert nothing.ok and nothing.says["hit"] is False


def test_a_factor_on_t_is_reported_in_ulps_and_in_units_of_the_bound(at):
    found = at(candidates.t_off_by_a_ten_thousandth)
    t = found.says["t"] / (1.0 + 1e-4)
    assert found.witness.off == pytest.approx(1e-4 * t)
    assert found.witness.ulps == pytest.approx(1e-4 * t / np.spacing(t), rel=1e-3)
    assert re.search(r"beyond its bound: t [\d.]+e\+\d+x\n", found.why) and "normal" not in found.why
    assert not found.witness.right


def test_a_normal_that_is_wrong_is_named_with_its_factor(at):
    found = at(candidates.flipped_normal)
    assert found.witness.share < 1.0 < found.witness.normal_share
    assert "the normal is turned round; beyond its bound: normal " in found.why


@pytest.mark.parametrize("trace", [candidates.one_nan, candidates.far_root, candidates.one_missed_edge_pixel])
def test_a_pixel_has_the_class_that_validate_gave_it(at, send, trace):
    """The candidate casts the whole film; otherwise a fault at its seventh hit would not recur."""
    scene = small()
    verdict = validate_scene(Task(scene, "scene", subject=FunctionSubject(trace.__name__, trace), send=send))
    failure = verdict.failures[0]
    found = at(trace, (failure.x, failure.y), scene)
    assert found.verdict == WRONG and failure.verdict == "wrong"
    assert found.why.startswith(failure.reason)


def test_a_pixel_that_validate_left_out_is_adjudicated(at, send):
    """Of hundreds of pixels that are wrong alike, validate looks at a sample."""
    scene = shipped("one-sphere", 60, 60)
    subject = FunctionSubject("off", candidates.t_off_by_a_ten_thousandth)
    row = int(scene_judge(scene, subject, send=send).judge().not_adjudicated[-1])
    found = at(subject, (row % 60, row // 60), scene)
    assert found.verdict == WRONG and found.witness.right is False and found.witness.share > 1.0


def test_the_question_that_validate_asks_is_repeated(at, tmp_path):
    """Which epsilon it is, further rays show; and the separator of a cause that is none of a single pixel."""
    scene = mistakes.scene_of("torus-smooth", tmp_path)
    found = at(FunctionSubject("blind", mistakes.edited(determinant_epsilon=5.0)), (12, 9), scene)
    assert found.verdict == WRONG and "is an epsilon larger than the determinants?" in found.why
    assert "\ndistances of hits here: " in found.why and ", determinants: " in found.why


@candidates.altered
def a_miss_is_a_number(t, n):
    return np.where(np.isfinite(t), t, 1e30), n


def test_a_number_in_the_place_of_a_miss_is_reported_by_the_other_rays(at):
    found = at(a_miss_is_a_number, MISS)
    assert found.verdict == WRONG and found.why.splitlines()[0] == "t is 1e+30 where nothing is hit; a miss has t inf"
    assert at(a_miss_is_a_number).ok


def raising(scene, o, d):
    raise RuntimeError("no such shape")


def test_no_answer_is_stated_in_the_words_of_validate_and_fails(at, send):
    found = at(raising)
    told = validate_scene(Task(small(), "scene", subject=FunctionSubject("raising", raising), send=send))
    assert found.problem == told.problem and "raised RuntimeError: no such shape" in found.problem
    assert not found.ok and found.witness.problem == "no answer"


def test_a_probe_of_a_function_is_supervised():
    words = ["probe", "--json", "scene.toml", "1", "2", "--candidate", "mine:trace"]
    assert __main__.needs_supervision(words) and __main__.needs_supervision([*words[:5], "--candidate=mine:trace"])
    assert not __main__.needs_supervision(words[:5])


def test_options_of_a_candidate_without_one_are_refused(capsys):
    words = ["probe", str(ROOT / "scenes/one-sphere.toml"), "5", "4"]
    for option, value in (("--candidate-precision", "float32"), ("--candidate-timeout", "5")):
        assert main([*words, option, value]) == 2
        assert f"{option}: expected --candidate X beside it" in capsys.readouterr().err
