"""Beginners' mistakes, each one edit of a right caster, are named as the cause in the first line of the failure."""

from dataclasses import dataclass
from pathlib import Path

import mistakes
import numpy as np
import pytest

import caster
from mitsuba_ref.judge.diagnosis import best_threshold, necessary_share
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import Verdict
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.report.verdict_text import failure_text, failures_text
from mitsuba_ref.subjects.function import FunctionSubject
from mitsuba_ref.subjects.ray_files import answer_of_hits
from mitsuba_ref.subjects.subject import Answer, CastRequest

ALL_MISTAKES = [*mistakes.MISTAKES, *mistakes.DEFECTS]


def judged(name, trace, scene):
    return validate_scene(Task(scene, "scene", subject=FunctionSubject(name, trace)))


@pytest.mark.parametrize("mistake", ALL_MISTAKES, ids=lambda mistake: mistake.name)
@pytest.mark.slow("each judges a scene", every=4)
def test_a_mistake_is_named_in_the_first_line(mistake, tmp_path):
    found = judged(mistake.name, mistake.trace, mistakes.scene_of(mistake.scene, tmp_path))
    first = failure_text(found).splitlines()[0]
    assert not found.ok and not found.problem
    assert mistake.says in first, first


@pytest.mark.parametrize("name", sorted({mistake.scene for mistake in ALL_MISTAKES}))
@pytest.mark.slow("each judges a scene", keep=3)
def test_without_a_mistake_the_caster_passes_and_no_hypothesis_is_reported(name, tmp_path):
    found = judged("right", mistakes.Caster(), mistakes.scene_of(name, tmp_path))
    assert found.ok and not found.findings, failure_text(found)


def test_two_independent_mistakes_are_two_causes():
    both = mistakes.answering(lambda s, o, d, t, n: (t + 0.25, -n))
    found = judged("both", both, mistakes.scene_of("cornell-box", Path()))
    assert [finding.what for finding in found.findings] == [
        "t is 0.25 too large everywhere, a constant",
        "the normal is turned round",
    ]
    assert all(finding.pixels == finding.of == found.failing for finding in found.findings)
    assert "; and the normal is turned round" in found.failures[0].reason


def test_ours_is_diagnosed_by_the_same_engine(monkeypatch):
    from mitsuba_ref.subjects import subject

    real = subject.cast_ours

    def moved(scene, rays):
        view = real(scene, rays)
        view.nearest.t[:] *= 1.005
        return view

    monkeypatch.setattr(subject, "cast_ours", moved)
    found = validate_scene(Task(mistakes.scene_of("one-sphere", Path()), "scene"))
    assert "t is 1.005 times what it should be" in found.findings[0].what


SHARED = {
    "the normal is turned round": (mistakes.answering(lambda s, o, d, t, n: (t, -n)), ("cornell-box", "one-sphere")),
    "the candidate misses everything; is an epsilon larger than the determinants? The same rays hit with d scaled by "
    "2^40": (mistakes.edited(determinant_epsilon=50.0), ("torus-smooth", "one-triangle")),
}


@pytest.mark.parametrize("cause", SHARED)
def test_a_cause_that_several_scenes_share_is_said_once_before_all(cause, tmp_path):
    trace, names = SHARED[cause]
    scenes = [judged("candidate", trace, mistakes.scene_of(name, tmp_path)) for name in names]
    said = failures_text(Verdict(tuple(scenes), 2)).splitlines()
    assert said[0] == f"cause:      in 2 of 2 that fail: {cause}"


# ---- separators


def test_a_threshold_separates_and_is_the_simplest_number_in_the_gap():
    values = np.r_[np.linspace(1e-8, 9e-7, 40), np.linspace(1.2e-6, 1.0, 100)]
    wrong = np.arange(140) < 40
    words, flags = best_threshold(values, wrong, tried=20)
    assert words == "below 1e-06" and np.array_equal(flags, wrong)


def test_a_property_of_all_wrong_pixels_is_reported_unless_chance_would_do_as_well():
    wrong = np.arange(400) < 40
    assert necessary_share(wrong | (np.arange(400) % 10 == 0), wrong, tried=20) == 0.1
    assert necessary_share(np.ones(400, bool), wrong, tried=20) is None  # so do all right ones
    assert necessary_share(wrong & (np.arange(400) > 0), wrong, tried=20) is None  # one has it not
    rng = np.random.default_rng(5)
    few = np.arange(400) < 8
    assert all(necessary_share(few | (rng.random(400) < 0.45), few, tried=20) is None for _ in range(50))


def test_no_threshold_is_reported_where_chance_would_do_as_well_or_it_separates_some_alone():
    rng = np.random.default_rng(3)
    for _ in range(200):
        assert best_threshold(rng.normal(size=60), np.arange(60) < 10, tried=20) is None
    assert best_threshold(np.array([1.0, 2.0, 3.0, 4.0]), np.array([1, 1, 0, 0], bool), tried=20) is None
    assert best_threshold(np.repeat([0.0, 1.0], [80, 120]), np.arange(200) < 100, tried=20) is None


# ---- numbers of primitives, and what right pixels contradict


@dataclass(frozen=True)
class Naming(FunctionSubject):
    """A subject that is right but for the numbers of shapes and primitives, which `call` makes of its hits."""

    def answer(self, request: CastRequest) -> Answer:
        o, d = (v.astype(np.float64) for v in (request.rays.o, request.rays.d))
        hits = caster.cast(request.traced, o, d)
        shape_id, prim_id = self.call(request.traced, o, d, hits)
        arrays = {"t": hits.t, "n": hits.normal, "shape_id": shape_id, "prim_id": prim_id}
        return answer_of_hits(arrays, np.ones(len(o), bool), "float64")


def farther_one(scene, o, d, hits):
    """Numbers of the second hit, if there is one, as if a later test had overwritten the first."""
    beyond = np.where(np.isinf(hits.t), 0.0, hits.t * (1.0 + 1e-9))
    second = caster.cast(scene, o + beyond[:, None] * d, d)
    there = second.shape_id >= 0
    return np.where(there, second.shape_id, hits.shape_id), np.where(there, second.prim_id, hits.prim_id)


def none(scene, o, d, hits):
    return 0 * hits.shape_id - 1, 0 * hits.prim_id - 1


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda scene, o, d, hits: (0 * hits.shape_id, 0 * hits.prim_id), "the same primitive is named at all"),
        (farther_one, "the primitive's number is that of another surface along the ray, t that of the first"),
    ],
)
def test_wrong_numbers_of_primitives_are_named(change, says):
    found = validate_scene(Task(mistakes.scene_of("torus-smooth", Path()), "scene", subject=Naming("naming", change)))
    assert not found.ok and says in failure_text(found).splitlines()[0], failure_text(found)


def test_numbers_that_are_minus_one_at_every_hit_are_not_given():
    scene = mistakes.scene_of("torus-smooth", Path())
    changes = (lambda scene, o, d, hits: (hits.shape_id, hits.prim_id)), none
    named, unnamed = (validate_scene(Task(scene, "scene", subject=Naming("naming", change))) for change in changes)
    assert named.ok and unnamed.ok
    assert "shape_id" in unnamed.unjudged and "shape_id" not in named.unjudged


def test_one_missing_number_is_a_wrong_one():
    def one(scene, o, d, hits):
        first = int(np.argmax(hits.shape_id >= 0))
        return hits.shape_id, np.where(np.arange(len(o)) == first, -1, hits.prim_id)

    scene = mistakes.scene_of("torus-smooth", Path())
    assert not validate_scene(Task(scene, "scene", subject=Naming("naming", one))).ok


def test_a_hypothesis_that_right_pixels_contradict_is_not_reported():
    """All hits are on front faces; most are missed, but not all: that no front face is hit would be untrue."""
    some = mistakes.answering(lambda s, o, d, t, n: (np.where(np.arange(len(t)) % 50 < 48, np.inf, t), n))
    found = judged("some", some, mistakes.scene_of("cornell-box", Path()))
    assert "missed; exact arithmetic hits" in failure_text(found).splitlines()[0]


def test_few_wrong_pixels_of_a_plane_are_no_scene_of_another_size(tmp_path):
    """Scaled about a point of its plane, a plane is itself: nearly all pixels stay right under that, too."""

    def few(scene, o, d, t, n):
        wrong = np.flatnonzero(np.isfinite(t))[::40]
        t = t.copy()
        t[wrong] *= 1.0 - np.linspace(1e-4, 9e-4, len(wrong))
        return t, n

    found = judged("few", mistakes.answering(few), mistakes.scene_of("one-triangle", tmp_path))
    first = failure_text(found).splitlines()[0]
    assert "everywhere" not in first and "times as large" not in first and "t is off: before" in first
