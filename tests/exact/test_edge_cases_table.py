"""The tables of the 77 cases are whole, none is asked nothing, and the judging of them finds planted faults."""

from pathlib import Path

import numpy as np
import pytest
from cases import CASES, behaviour, judging
from cases.case import FLOAT32, FLOAT64, Maker, no_questions
from cases.conditions import T_ULPS, ULP
from cases.judging import judged, short_of
from cases.page import page
from cases.refusal_check import refused
from cases.shapes import KINDS, rays_at, shape_of

from caster import Hits, SceneError, Sphere
from caster.kernels.nearest import Nearest
from caster.rendering import hits
from caster.shapes import SHAPES

DOCS = Path(__file__).resolve().parents[2] / "docs" / "edge-cases.md"


def test_the_numbers_1_to_77_are_there_once_each():
    assert [case.number for case in CASES] == list(range(1, 78))
    assert len({case.name for case in CASES}) == 77


def test_every_case_requests_or_checks_something():
    for case in CASES:
        asked = case.questions is not no_questions
        assert asked or case.checks, case.number
        assert case.name and case.ours and (asked or case.shapes), case.number


@pytest.mark.parametrize("precision", [FLOAT64, FLOAT32], ids=lambda p: p.name)
def test_cases_about_every_shape_request_every_shape(precision):
    registered = {shape.model_fields["type"].default for shape in SHAPES}
    assert {shape_of(kind, np.random.default_rng(0)).type for kind in KINDS} == registered
    spread = [case for case in CASES if case.every_shape]
    assert len(spread) >= 8
    for case in spread:
        asked = {
            shape.type for question in case.questions(Maker(case.number, precision)) for shape in question.scene.shapes
        }
        assert asked == registered, f"case {case.number} leaves out {registered - asked}"


def test_questions_are_the_same_in_every_run():
    for precision in (FLOAT64, FLOAT32):
        first, second = ([*CASES[4].questions(Maker(5, precision))] for _ in range(2))
        assert len(first) == len(second) > 4
        assert all(
            a.o.tobytes() == b.o.tobytes() and a.d.tobytes() == b.d.tobytes()
            for a, b in zip(first, second, strict=True)
        )


def test_float32_questions_hold_float32_numbers_only():
    for case in (CASES[0], CASES[15], CASES[28], CASES[45]):
        for question in case.questions(Maker(case.number, FLOAT32)):
            for numbers in (question.o, question.d):
                assert np.array_equal(numbers.astype(np.float32).astype(np.float64), numbers)


# ---- planted faults ----


def a_question():
    make = Maker(1, FLOAT64)
    scene = make.scene([Sphere(center=(0.1, 0.2, 0.3)), shape_of("cube", make.rng, 1.0, (3.0, 0.0, 0.0))])
    first, second = (rays_at(make, part, 12) for part in scene.derived["packed"].parts)
    return make.ask("planted", scene, *(np.concatenate(pair) for pair in zip(first, second, strict=True)), hit=15)


def planted(monkeypatch, fault):
    """What is found wrong where `fault` changes the record of the nearest hits."""

    def faulty(packed, rays, *more, **threads):
        return fault(right(packed, rays, *more, **threads))

    right = hits.trace_rays.__globals__["find_nearest"]
    monkeypatch.setitem(hits.trace_rays.__globals__, "find_nearest", faulty)
    return judged(a_question()).wrong


def test_nothing_is_wrong_without_a_fault():
    question = a_question()
    found = judged(question)
    assert not found.wrong and not short_of(question, found.met)


def test_a_lost_hit_is_found(monkeypatch):
    def fault(n: Nearest) -> Nearest:
        return Nearest(np.where(n.prim == 0, np.inf, n.t), np.where(n.prim == 0, -1, n.prim), n.error)

    wrong = planted(monkeypatch, fault)
    assert wrong and all("primitive -1, exactly 0 (inside)" in text and "0x" in text for text in wrong)


def test_another_primitive_is_found(monkeypatch):
    wrong = planted(
        monkeypatch, lambda n: n._replace(prim=np.where(n.prim > 0, n.prim % 12 + 1, n.prim).astype(np.int32))
    )
    assert wrong and all("exactly" in text for text in wrong)


def test_a_t_beyond_its_bound_is_found(monkeypatch):
    wrong = planted(monkeypatch, lambda n: n._replace(t=n.t + 2.0 * n.error + 1e-9))
    assert any("more than the" in text for text in wrong)


def test_a_t_that_is_within_a_wide_bound_but_not_within_its_ulps_is_found(monkeypatch):
    far = 1e4 * T_ULPS * ULP
    wrong = planted(monkeypatch, lambda n: n._replace(t=n.t * (1.0 + far), error=n.error + n.t))
    assert any("ulps of its condition" in text for text in wrong)


def test_a_bound_that_states_nothing_is_found(monkeypatch):
    wrong = planted(monkeypatch, lambda n: n._replace(error=np.where(n.prim < 0, n.error, 1e-3)))
    assert wrong and all("the bound 0.001" in text for text in wrong)


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (lambda n: -n, "is off by 2, more than"),
        (lambda n: n * 1.0001, "has length"),
        (lambda n: n * np.nan, "has length nan"),
    ],
    ids=["turned round", "too long", "no number"],
)
def test_a_wrong_normal_is_found(monkeypatch, turn, says):
    right = Hits.surface.fget
    surface = property(lambda self: (s := right(self))._replace(n=turn(s.n)))
    monkeypatch.setattr(Hits, "surface", surface)
    wrong = judged(a_question()).wrong
    assert wrong and any(says in text for text in wrong)


def test_a_normal_a_little_off_is_found(monkeypatch):
    right = Hits.surface.fget
    nudge = np.array([1e-11, -1e-11, 1e-11])
    monkeypatch.setattr(
        Hits,
        "surface",
        property(lambda self: (s := right(self))._replace(n=s.n + nudge - s.n * (s.n @ nudge)[:, None])),
    )
    assert any("is off by" in text for text in judged(a_question()).wrong)


def test_a_question_that_hits_too_little_is_found():
    question = a_question()._replace(wants={"hit": 10**6, "tangent": 1}, never=("miss", "hit"))
    short = short_of(question, judged(question).met)
    assert len(short) >= 3 and any("of tangent, expected 1" in text for text in short)


def test_what_is_not_refused_is_found():
    def complain() -> None:
        raise SceneError("radius")

    with pytest.raises(AssertionError, match="expected a refusal"):
        refused(lambda: 1, "radius")
    with pytest.raises(AssertionError, match="expected"):
        refused(complain, "center")


def test_the_page_is_what_the_tables_and_the_data_say():
    assert DOCS.read_text(encoding="utf-8") == page(CASES, behaviour.kept()["cases"]), (
        "docs/edge-cases.md is not up to date: python tests/exact/edge_cases.py"
    )


def test_rays_are_reported_to_the_bit():
    question = a_question()
    text = judging.ray(question, 3)
    assert all(float(x).hex() in text for x in (*question.o[3], *question.d[3]))
