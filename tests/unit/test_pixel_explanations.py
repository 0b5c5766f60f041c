"""What is said about a pixel, by its class and by what was found there: tables of every branch."""

from types import SimpleNamespace

import numpy as np
import pytest

from mitsuba_ref.judge.adjudication import Adjudication
from mitsuba_ref.judge.aggregate import defect_counts, listed_failures
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judgement
from mitsuba_ref.judge.comparison import reference_prims
from mitsuba_ref.judge.diagnosis import Cause, failing_rows, sentence_by_row
from mitsuba_ref.judge.explanations import (
    QUANTITY_NAMES,
    exceeded_bounds,
    format_exact,
    full_reason,
    reason,
    tie_members,
)

INF = np.inf


def judgement_of(*classes, ratios=None, right=(), answered=None, cases=None, allowed=None) -> Judgement:
    """One row a class. right: rows where the subject is exactly right; answered: rows with an exact answer."""
    count = len(classes)
    rows = np.arange(count)
    answered = rows if answered is None else answered
    answers = [SimpleNamespace(t=1.0) if row in answered else None for row in rows]
    is_right = np.isin(rows, right)
    exact = Adjudication(rows, answers, np.where(is_right, 0.0, INF), is_right)
    given = {"depth": np.zeros(count), EXACT: np.zeros(count)} | (ratios or {})
    codes = np.array([CLASS_CODE[name] for name in classes])
    shares = {name: np.asarray(each, float) for name, each in given.items()}
    return Judgement(codes, shares, allowed or {}, exact, cases or {}, np.zeros(0, int))


def subject(*, ours: bool, precision="float64") -> SimpleNamespace:
    return SimpleNamespace(
        answer=SimpleNamespace(exact_visibility=ours, precision=precision), inconsistent={}, names_prims=ours
    )


def test_what_is_beyond_its_bound_is_said_with_its_factor():
    judge, judgement = (
        subject(ours=True),
        judgement_of("wrong", "wrong", ratios={"depth": [3.0, 0.75], "normal": [INF, 0.5]}),
    )
    assert full_reason(judge, judgement, {0: "why"}, 0) == "why; beyond their bounds: depth 3x, normal"
    assert full_reason(judge, judgement, {1: "why"}, 1) == "why"


@pytest.mark.parametrize(
    ("ratios", "told"),
    [
        ({}, ""),
        ({"t": 1.0, "normal": 0.0}, ""),  # a bound that is just reached is kept
        ({"t": np.nextafter(1.0, 2.0)}, "beyond its bound: {t} 1x"),
        ({"t": 2.5, "normal": 0.5}, "beyond its bound: {t} 2.5x"),
        ({"t": 2.5, "normal": 1234.5}, "beyond their bounds: {t} 2.5x, {normal} 1.23e+03x"),
        ({"t": INF}, "beyond its bound: {t}"),
        ({"t": np.nan}, "beyond its bound: {t}"),  # what is no number is not within
        ({"exact": INF}, "beyond its bound: {exact}"),
        ({"exact": INF, "t": 3.0}, "beyond its bound: {t} 3x"),
        ({"exact": 4.0, "t": 3.0}, "beyond their bounds: {exact} 4x, {t} 3x"),
    ],
)
def test_what_exceeds_its_bound_is_reported_with_its_factor(ratios, told):
    names = {name: QUANTITY_NAMES.get(name, name) for name in ("t", "normal", "exact")}
    assert exceeded_bounds(ratios) == told.format(**names)


def test_an_explained_pixel_is_a_shadow_where_light_is_compared_and_differs():
    lit, shadow = (judgement_of("explained", ratios={"diffuse": [ratio]}, right=[0]) for ratio in (0.5, 2.0))
    of_candidate = judgement_of("explained", right=[0])
    assert "a shadow" in reason(subject(ours=True), shadow, {}, 0)
    assert "a shadow" not in reason(subject(ours=True), lit, {}, 0)
    assert "a shadow" not in reason(subject(ours=False), of_candidate, {}, 0)


# ---- answers as text

SCENE = SimpleNamespace(shape_names=lambda: ["ball", "mesh"])
PACKED = SimpleNamespace(shape_of=lambda prim: prim // 10, index_in_shape=lambda prim: prim % 10)


def exact(*prims, t=1.5) -> SimpleNamespace:
    ties = [SimpleNamespace(prim=prim, where="edge") for prim in prims]
    return SimpleNamespace(ties=ties, prims=np.array(prims), t=t if prims else None)


def test_exact_answers_on_one_line():
    assert format_exact(SCENE, PACKED, None) == "no answer"
    assert format_exact(SCENE, PACKED, exact()) == "miss"
    assert format_exact(SCENE, PACKED, exact(12)) == "mesh, prim 2 (edge) at t 1.5 0x1.8000000000000p+0"
    two = "ball, prim 3 (edge) = mesh, prim 2 (edge)"
    assert format_exact(SCENE, PACKED, exact(3, 12), with_t=False) == two
    assert format_exact(SCENE, PACKED, exact(3, 12)) == f"{two} at t 1.5 0x1.8000000000000p+0"
    eight = format_exact(SCENE, PACKED, exact(*range(8)), with_t=False)
    assert eight.endswith("ball, prim 5 (edge) = 2 more") and eight.count(" = ") == 6
    assert [tuple(each) for each in tie_members(SCENE, PACKED, exact(3, 12))] == [
        ("ball", 3, "edge"),
        ("mesh", 2, "edge"),
    ]


# ---- sums


def test_failing_rows_are_those_of_failing_classes_and_unlisted_cases():
    judgement = judgement_of(
        "wrong", "agree", "undecided", "reference_wrong", "reference_wrong", "tie", cases={3: None, 4: 8}
    )
    assert failing_rows(judgement).tolist() == [0, 2, 3]
    assert defect_counts(judgement) == {"8": 1, "unlisted": 1}
    many = judgement_of(*["agree"] * 4, cases={0: 30, 1: 8, 2: 30, 3: None})
    assert list(defect_counts(many).items()) == [("8", 1), ("30", 2), ("unlisted", 1)]


def test_listed_failures_begin_with_one_of_each_cause(monkeypatch):
    from mitsuba_ref.judge import aggregate

    monkeypatch.setattr(aggregate, "failure_at", lambda judge, judgement, by_row, row: row)
    ratio = np.array([5.0, 9.0, 7.0, 8.0, 2.0, 3.0, 6.0, 4.0, 1.5, 1.25, 1.2, 1.1])
    judgement = judgement_of(*["wrong"] * 12, ratios={"depth": ratio})
    second = Cause("b", np.array([1, 2, 3, 6, 7]), alike=np.array([8, 9, 10, 11]))
    causes = Cause("a", np.array([0, 4, 5])), second
    assert sentence_by_row(causes)[9] == "b (same symptom, not looked at)"
    ours, theirs = SimpleNamespace(names_prims=True), SimpleNamespace(names_prims=False)
    assert listed_failures(ours, judgement, causes) == (1, 0, 3, 2, 6, 7, 5, 4, 8, 9)
    assert listed_failures(theirs, judgement, causes) == (1, 0, 3, 2, 6, 7, 5, 4, 8, 9)
    ratio[:] = ratio[::-1].copy()
    assert listed_failures(ours, judgement, causes)[:3] == (6, 5, 4)
    assert listed_failures(theirs, judgement, causes)[:3] == (1, 0, 5)


def test_a_primitive_of_mitsuba_is_counted_in_its_shape_and_of_a_stand_in_is_the_first():
    model = SimpleNamespace(packed=SimpleNamespace(first=np.array([0, 1, 5, 6])))
    shape, prim = np.array([0, 1, 1, 1, 2, 2, -1, 1]), np.array([0, 0, 3, 4, 7, 0, 2, 1])
    hit = np.array([1, 1, 1, 1, 1, 1, 1, 0], bool)
    result = SimpleNamespace(shape_id=shape, hit=hit, answer=SimpleNamespace(prim=prim))
    found = reference_prims(result, model)
    assert found.tolist() == [0, 1, 4, 1, 5, 5, -1, -1] and found.dtype == np.int32
