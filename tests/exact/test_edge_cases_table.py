"""The judging of the edge cases finds planted faults, and cases of every shape ask every shape."""

import numpy as np
import pytest
from cases import CASES
from cases.case import FLOAT32, FLOAT64, Maker
from cases.judging import judged, short_of
from cases.shapes import KINDS, rays_at, shape_of

from caster import Hits, Sphere
from caster.rendering import hits
from caster.shapes import SHAPES


def test_every_case_is_there_once():
    assert len({case.number for case in CASES}) == len({case.name for case in CASES}) == len(CASES) >= 40


@pytest.mark.parametrize("precision", [FLOAT64, FLOAT32], ids=lambda p: p.name)
def test_cases_about_every_shape_request_every_shape(precision):
    registered = {shape.model_fields["type"].default for shape in SHAPES}
    assert {shape_of(kind, np.random.default_rng(0)).type for kind in KINDS} == registered
    spread = [case for case in CASES if case.every_shape]
    assert len(spread) >= 7
    for case in spread:
        questions = case.questions(Maker(case.number, precision))
        asked = {shape.type for question in questions for shape in question.scene.shapes}
        assert asked == registered, f"case {case.number} leaves out {registered - asked}"


# ---- planted faults ----


def a_question():
    make = Maker(1, FLOAT64)
    scene = make.scene([Sphere(center=(0.1, 0.2, 0.3)), shape_of("cube", make.rng, 1.0, (3.0, 0.0, 0.0))])
    first, second = (rays_at(make, part, 12) for part in scene.derived["packed"].parts)
    return make.ask("planted", scene, *(np.concatenate(pair) for pair in zip(first, second, strict=True)), hit=15)


def test_nothing_is_wrong_without_a_fault_and_too_few_hits_are_reported():
    question = a_question()
    found = judged(question)
    assert not found.wrong and not short_of(question, found.met)
    short = short_of(question._replace(wants={"hit": 10**6, "tangent": 1}, never=("miss", "hit")), found.met)
    assert len(short) >= 3 and any("of tangent, expected 1" in text for text in short)


FAULTS = {
    "a lost hit": (
        lambda n: n._replace(t=np.where(n.prim == 0, np.inf, n.t), prim=np.where(n.prim == 0, -1, n.prim)),
        "primitive -1, exactly 0 (inside)",
    ),
    "another primitive": (
        lambda n: n._replace(prim=np.where(n.prim > 0, n.prim % 12 + 1, n.prim).astype(np.int32)),
        "exactly",
    ),
    "a t beyond its bound": (lambda n: n._replace(t=n.t + 2.0 * n.error + 1e-9), "the caster's bound is"),
    "a t within too wide a bound": (lambda n: n._replace(t=n.t * (1.0 + 1e-11), error=n.error + n.t), "the judge's"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_hit_is_found(monkeypatch, fault):
    change, says = FAULTS[fault]
    where = hits.trace_rays.__globals__
    right = where["find_nearest"]
    monkeypatch.setitem(where, "find_nearest", lambda *given, **options: change(right(*given, **options)))
    wrong = judged(a_question()).wrong
    assert wrong and any(says in text for text in wrong)


NUDGE = np.array([1e-11, -1e-11, 1e-11])


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (lambda n: -n, "is off by 2, more than"),
        (lambda n: n * 1.0001, "has length"),
        (lambda n: n * np.nan, "has length nan"),
        (lambda n: n + NUDGE - n * (n @ NUDGE)[:, None], "is off by"),
    ],
    ids=["turned round", "too long", "no number", "a little off"],
)
def test_a_wrong_normal_is_found(monkeypatch, turn, says):
    right = Hits.surface.fget
    surface = property(lambda self: (s := right(self))._replace(n=turn(s.n)))
    monkeypatch.setattr(Hits, "surface", surface)
    wrong = judged(a_question()).wrong
    assert wrong and any(says in text for text in wrong)
