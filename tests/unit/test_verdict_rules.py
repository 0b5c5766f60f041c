"""Tables of what passes: errors against the exact answer, scenes, runs and windows of films."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import verdict_factory

from caster.system.process import OK
from mitsuba_ref.cli.validate import exit_code
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.judge.adjudication import exact_ratios, oracle_answers
from mitsuba_ref.judge.aggregate import merge_windows
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.oracle.oracle import OutsideDomain
from mitsuba_ref.subjects.subject import Answer

INF = np.inf


def test_rays_that_the_oracle_refuses_cost_the_others_nothing():
    bad = {3, 4, 11}

    class Refusing:
        def first_hits(self, o, d, t_min, t_max):
            numbers = o[:, 0].astype(int).tolist()
            if bad & set(numbers):
                raise OutsideDomain("planted")
            return [(n, *rest) for n, *rest in zip(numbers, d[:, 1], t_max, t_min, strict=True)]

    o, d = np.zeros((2, 13, 3))
    o[:, 0], d[:, 1] = np.arange(13), np.arange(13) + 0.5
    found = oracle_answers(Refusing(), Rays(o, d, np.arange(13) + 0.75, np.arange(13) + 0.25))
    assert found == [None if n in bad else (n, n + 0.5, n + 0.25, n + 0.75) for n in range(13)]


# ---- the error from the exact answer


class Exact(float):
    """An exact t."""

    def off(self, x):
        return abs(x - float(self))


def answer_at(*ties, miss=False) -> SimpleNamespace:
    """An exact answer with (prim, t) as its tie set."""
    members = [SimpleNamespace(prim=prim, t=Exact(t), where="inside") for prim, t in ties]
    t, prim = (None, -1) if miss else (members[0].t, members[0].prim)
    return SimpleNamespace(t=t, prim=prim, ties=members)


HIT, MISS = answer_at((7, 2.0)), answer_at(miss=True)


@pytest.mark.parametrize(
    ("answer", "prim", "t", "bound", "ratio"),
    [
        (MISS, -1, INF, 1.0, 0.0),
        (MISS, 7, 2.0, 1.0, INF),
        (HIT, -1, INF, 1.0, INF),
        (HIT, 8, 2.0, 1.0, INF),
        (HIT, 7, 2.0, 1.0, 0.0),
        (HIT, 7, 2.0, 0.0, 0.0),
        (HIT, 7, 2.25, 0.5, 0.5),
        (HIT, 7, 1.0, 0.5, 2.0),
        (HIT, 7, 1.0, 0.0, INF),
        (HIT, 7, 1.0, np.nan, INF),
        (HIT, 7, INF, 0.5, INF),
        (HIT, 7, np.nan, 0.5, INF),
        (HIT, 7, 9.0, INF, 0.0),  # edge-on: t has no bound, so only the primitive counts
    ],
)
def test_the_error_of_a_subject_that_names_what_it_hits(answer, prim, t, bound, ratio):
    given = Answer(np.array([t, t]), None, "float64", {}, prim=np.array([prim, prim]), exact_visibility=True)
    packed = SimpleNamespace(shape_of=None, index_in_shape=None)
    best, first = exact_ratios(
        [answer, None], given, lambda of, *at: SimpleNamespace(t_error=np.full(len(of), bound)), packed
    )
    assert best.tolist() == [ratio, INF] and first.tolist() == [ratio <= 1.0, False]


# ---- verdicts


def scene_with(counts=None, **more) -> SceneVerdict:
    return SceneVerdict("name", "path", counts=dict.fromkeys(CLASSES, 0) | (counts or {"agree": 9}), **more)


GOOD, BAD = SceneCheck("good", 1.0, ""), SceneCheck("bad", 1.0000001, "")


@pytest.mark.parametrize(
    ("verdict", "ok", "failing", "evidence", "excused"),
    [
        (scene_with(), True, 0, 9, 0),
        (scene_with({"agree": 0}), False, 0, 0, 0),
        (scene_with(problem="a crash"), False, 0, 9, 0),
        (scene_with({"agree": 99, "wrong": 1}), False, 1, 99, 0),
        (scene_with({"agree": 99, "undecided": 2}), False, 2, 99, 0),
        (scene_with({"agree": 99, "reference_wrong": 2}, cases={"unlisted": 2, "8": 5}), False, 2, 99, 2),
        (scene_with({"agree": 99, "reference_wrong": 2}, cases={"8": 2}), True, 0, 99, 2),
        (scene_with({"tie": 3, "explained": 1, "out_of_domain": 1}), True, 0, 3, 2),
        (scene_with({"agree": 1, "tie": 1, "explained": 1, "reference_wrong": 1}), False, 0, 2, 2),
        (scene_with({"agree": 1, "out_of_domain": 2}), False, 0, 1, 2),
        (scene_with(checks=(GOOD,)), True, 0, 9, 0),
        (scene_with(checks=(GOOD, BAD)), False, 0, 9, 0),
        (scene_with(checks=(SceneCheck("nan", np.nan, ""),)), False, 0, 9, 0),
    ],
)
def test_a_scene_passes_by_evidence_alone(verdict, ok, failing, evidence, excused):
    assert (verdict.ok, verdict.failing, verdict.evidence, verdict.excused) == (ok, failing, evidence, excused)
    assert verdict.to_dict()["ok"] is ok


PASSED, FAILED = verdict_factory.scene("a"), verdict_factory.scene("b", ok=False)
DECLINED = replace(verdict_factory.scene("c", problem="declined"), waived="unsupported")
EXPECTED = replace(FAILED, waived="expected")


@pytest.mark.parametrize(
    ("verdict", "ok"),
    [
        (Verdict((PASSED,)), True),
        (Verdict((), 0), False),
        (Verdict((), 0, shard="1/2", selected=("a",)), True),
        (Verdict((), 0, shard="1/2"), False),
        (Verdict((PASSED,), 2), False),
        (Verdict((PASSED, FAILED), 2), False),
        (Verdict((PASSED, EXPECTED), 2), True),
        (Verdict((PASSED, DECLINED), 2), True),
        (Verdict((DECLINED,), 1), False),
        (Verdict((DECLINED,), 1, shard="1/2", selected=("c",)), True),
        (Verdict((PASSED, DECLINED), 2, min_scenes=1), True),
        (Verdict((PASSED, DECLINED), 2, min_scenes=2), False),
        (Verdict((PASSED, PASSED), 2, min_scenes=2), True),
        (Verdict((EXPECTED,), 1, min_scenes=1), True),
    ],
)
def test_a_run_passes_where_every_scene_does_or_is_waived(verdict, ok):
    assert verdict.ok is ok
    assert (exit_code(verdict, ()) == OK) is ok


WINDOW_FAULTS = {
    "a check": lambda checks: {"checks": (checks[0], replace(checks[1], ratio=2.0))},
    "a check without a number": lambda checks: {"checks": (checks[0], replace(checks[1], ratio=np.nan))},
    "a check that others lack": lambda checks: {"checks": (*checks, SceneCheck("placement", np.inf, ""))},
    "a pixel": lambda checks: {"counts": PASSED.counts | {"undecided": 1}},
    "an unknown error of Mitsuba": lambda checks: {"cases": {UNLISTED: 1}},
    "no comparison": lambda checks: {"problem": "killed"},
}


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("fault", WINDOW_FAULTS)
def test_a_film_passes_only_where_each_of_its_windows_does(fault, place):
    checks = SceneCheck("camera", 0.5, ""), SceneCheck("culling", 0.0, "")
    windows = [replace(PASSED, checks=checks)] * 3
    assert merge_windows(windows).ok
    windows[place] = replace(windows[place], **WINDOW_FAULTS[fault](checks))
    assert not windows[place].ok and not merge_windows(windows).ok
