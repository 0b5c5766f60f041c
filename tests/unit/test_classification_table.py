"""Every branch by which a pixel gets its class, as truth tables: what was found of it, and the class expected."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from mitsuba_ref.error_model.bracket import CLAIMED_MISS, Claims
from mitsuba_ref.judge import classification
from mitsuba_ref.judge.adjudication import Adjudication
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judge, Judgement
from mitsuba_ref.judge.diffuse import DiffuseComparison
from mitsuba_ref.judge.verdict import CLASSES

INF, NAN = np.inf, np.nan


def judge_with(**given) -> Judge:
    """A judge that has these attributes and no others."""
    judge = object.__new__(Judge)
    for name, value in given.items():
        judge.__dict__[name] = value
    return judge


def names(classes: np.ndarray) -> list[str]:
    return [CLASSES[code] for code in classes]


def bools(count: int) -> np.ndarray:
    """(count, 2^count) bool: every combination."""
    return np.array(list(itertools.product([False, True], repeat=count))).T


def adjudicated(ratio, answered=None, rows=None) -> Adjudication:
    ratio = np.asarray(ratio, float)
    answered = np.ones(len(ratio), bool) if answered is None else answered
    rows = np.arange(len(ratio)) if rows is None else rows
    return Adjudication(
        rows, [SimpleNamespace(row=row) if yes else None for row, yes in zip(rows, answered, strict=True)], ratio
    )


def test_right_and_wrong_are_of_what_was_answered():
    found = adjudicated(
        [0.0, 1.0, 1.0000001, INF, NAN, 0.0], np.array([1, 1, 1, 1, 1, 0], bool), np.array([2, 3, 5, 7, 8, 9])
    )
    assert found.right.tolist() == [True, True] + [False] * 4
    assert found.wrong.tolist() == [False, False, True, True, True, False]
    assert found.of(5).row == 5 and found.of(9) is None and found.of(4) is None
    assert found.are_right(np.array([1, 2, 3, 5, 9])).tolist() == [False, True, True, False, False]
    judgement = Judgement(np.array([0, 5]), {}, {}, found, {}, 0.0)
    assert (
        judgement.is_right(3) and not judgement.is_right(5) and not judgement.is_right(4) and not judgement.is_right(9)
    )
    assert judgement.is_class("agree").tolist() == [True, False] and len(judgement.not_adjudicated) == 0
    judgement = Judgement(np.array([0]), {"a": np.array([0.5]), EXACT: np.array([3.0])}, {"a": 0.25}, found, {}, 0.0)
    assert judgement.excess("a") == [2.0] and judgement.excess(EXACT) == [3.0] and judgement.names == ("a", EXACT)


# ---- the reference's answer where the subject is exactly right


def reference_classes(monkeypatch, allowed, is_open, miss, at_origin, loose, unresolved, tied, *, is_list=False):
    count = len(allowed)
    shape = np.where(miss, CLAIMED_MISS, 4)
    claims = Claims(np.where(at_origin, 0.0, 2.0), shape, *np.zeros((3, count, 3)))
    asked = {}

    def other_tie(model, o, d, given, answers, closest):
        asked.update(t=given.t, answers=answers, closest=closest)
        return tied

    monkeypatch.setattr(classification, "claims_other_tie", other_tie)
    o, d = np.zeros((count, 3)), np.ones((count, 3))
    rays = SimpleNamespace(
        is_list=is_list, rows=lambda rows: SimpleNamespace(reference_exponent=np.ones(len(rows), int))
    )
    judge = judge_with(
        reference_lines=(o, 0.5 * d if is_list else d, np.full(count, INF)), o=o, d=d, model="model",
        reference_bracket=SimpleNamespace(judge=lambda *given: SimpleNamespace(allowed=allowed, open=is_open)),
        pair=SimpleNamespace(rays=rays), result=SimpleNamespace(t=np.arange(count) + 7.0),
        _reference_claims=lambda rows: claims, _is_unresolved=lambda: unresolved,
    )  # fmt: skip
    classes = np.full(count, CLASS_CODE["undecided"])
    judge._classify_reference(classes, np.ones(count, bool), loose, adjudicated(np.zeros(count)))
    return names(classes), asked


@pytest.mark.parametrize("is_list", [False, True])
def test_what_becomes_of_mitsubas_answer(monkeypatch, is_list):
    table = bools(7)
    found, asked = reference_classes(monkeypatch, *table, is_list=is_list)
    for row, (allowed, is_open, miss, at_origin, loose, unresolved, tied) in enumerate(table.T):
        possible = allowed and (miss or not at_origin)  # no numbers within bounds give a hit at the origin
        expected = "reference_wrong"
        if possible:
            expected = "out_of_domain" if loose or unresolved else "explained"
        elif is_open:
            expected = "out_of_domain"
        assert found[row] == ("tie" if tied else expected), table[:, row]
    # of the ray as the subject has it: direction and power of two are told apart from another ray
    assert all(answer is not None for answer in asked["answers"]) and asked["closest"] == 2.0**-4
    assert asked["t"].tolist() == (np.arange(128) + 7.0).tolist()


def test_rows_that_are_not_disputed_or_not_right_keep_their_class(monkeypatch):
    table = np.zeros((7, 4), bool)
    judge = judge_with(reference_lines=(), o=None, d=None)
    classes = np.full(4, CLASS_CODE["agree"])
    judge._classify_reference(classes, np.zeros(4, bool), table[0], adjudicated(np.zeros(4)))
    judge._classify_reference(classes, np.ones(4, bool), table[0], adjudicated(np.full(4, 2.0)))
    assert names(classes) == ["agree"] * 4


# ---- a subject that is not exactly right


@pytest.mark.parametrize("exact_visibility", [True, False])
@pytest.mark.parametrize("resolves", [True, False])
def test_whose_rounding_excuses_an_inexact_answer(monkeypatch, exact_visibility, resolves):
    allowed, is_open, miss, at_origin, lost, wrong = table = bools(6)
    count = table.shape[1]
    rows = np.flatnonzero(wrong)
    claims = Claims(
        np.where(at_origin, 0.0, 2.0)[rows], np.where(miss, CLAIMED_MISS, 4)[rows], *np.zeros((3, len(rows), 3))
    )
    found = SimpleNamespace(allowed=allowed[rows], open=is_open[rows])
    asked = []

    class View(classification.UncertainRaysModel):
        def __init__(self):
            pass

        def is_unresolved(self, prim, d, t):
            asked.append((prim.tolist(), t.tolist()))
            return lost[rows]

    exact = adjudicated(np.where(wrong, 2.0, 1.0))
    exact = Adjudication(
        exact.rows, [SimpleNamespace(prim=3, t=1.5 if i % 2 else None) for i in range(count)], exact.ratio
    )
    judge = judge_with(
        answer=SimpleNamespace(exact_visibility=exact_visibility), o=np.zeros((count, 3)), d=np.ones((count, 3)),
        t_max=np.full(count, INF), t_min=np.zeros(count), view=object() if resolves else View(),
        bracket=SimpleNamespace(judge=lambda *given, t_min: found), _subject_claims=lambda rows: claims,
    )  # fmt: skip
    classes = np.full(count, CLASS_CODE["agree"])
    judge._classify_inexact(classes, exact)
    excused = judge._excused(exact)
    assert len(excused) == len(rows)
    for i, row in enumerate(rows):
        expected = "wrong"
        if not exact_visibility:
            if is_open[row] or (lost[row] and not resolves):
                expected = "out_of_domain"
            if allowed[row] and (miss[row] or not at_origin[row]):
                expected = "explained"
        assert CLASSES[classes[row]] == expected and excused[i] == (expected != "wrong")
    assert set(names(classes[~wrong])) == {"agree"}
    if not exact_visibility and not resolves:
        assert asked[0] == ([3] * len(rows), [1.5 if row % 2 else INF for row in rows])
    assert not len(judge._excused(adjudicated([0.0])))


# ---- light


@pytest.mark.parametrize("allowed", [0.5, 1.0, 2.0])
def test_what_becomes_of_light(monkeypatch, allowed):
    """Of pixels that agree in geometry; held to float64 alone where Mitsuba's light is another."""
    ratios = np.array([0.25, 0.5, np.nextafter(0.5, 1), 1.0, np.nextafter(1.0, 2), 2.0, 3.0, INF])
    flags = bools(3)
    which, ratio = (a.ravel() for a in np.meshgrid(np.arange(8), ratios, indexing="ij"))
    explained, unresolvable, right = flags[:, which]
    count = len(ratio)
    own = SimpleNamespace(t_error=np.where(np.arange(count) % 2, 1.0, 1.0))
    judge = judge_with(
        scene=None, hit=np.ones(count, bool), prim=np.arange(count), bracket="ours", reference_bracket="theirs",
        pair=SimpleNamespace(subject=None), bounds=SimpleNamespace(own=own),
    )  # fmt: skip
    monkeypatch.setattr(
        classification, "judge_diffuse", lambda *given: DiffuseComparison(ratio.copy(), explained, unresolvable)
    )
    monkeypatch.setattr(classification, "aov_rows", lambda images, name: np.arange(count))
    monkeypatch.setattr(classification, "shading_points", lambda pair, at, rows: rows)
    monkeypatch.setattr(
        classification, "diffuse_within_float64", lambda scene, points, prim, values, bracket: right[values]
    )
    classes = np.full(count, CLASS_CODE["agree"])
    found = judge._classify_diffuse(classes, allowed)
    for i in range(count):
        expected, beyond = "agree", ratio[i] > allowed
        if beyond:
            expected = "undecided"
            if ratio[i] > 1.0 and unresolvable[i]:
                expected = "out_of_domain"
            if explained[i]:
                expected = "explained"
        disputed = expected == "undecided" and ratio[i] > 1.0
        held = expected in ("agree", "explained", "out_of_domain") or disputed
        if disputed and right[i]:
            expected = "reference_wrong"
        if held and not right[i]:
            expected = "wrong"
        assert CLASSES[classes[i]] == expected, (ratio[i], explained[i], unresolvable[i], right[i])
        assert found.ratio[i] == (INF if expected == "wrong" else ratio[i])


def test_light_is_held_to_float64_where_something_is_hit_at_a_resolved_t(monkeypatch):
    hit, resolved = bools(2)
    judge = judge_with(
        scene=None, hit=hit, prim=np.arange(4), bracket=0, reference_bracket=0, pair=SimpleNamespace(subject=None),
        bounds=SimpleNamespace(own=SimpleNamespace(t_error=np.where(resolved, 1.0, INF))),
    )  # fmt: skip
    asked = []
    plain = DiffuseComparison(np.zeros(4), np.zeros(4, bool), np.zeros(4, bool))

    def compared(scene, pair, bounds, rows, brackets):
        asked.append(rows.tolist())
        return plain

    monkeypatch.setattr(classification, "judge_diffuse", compared)
    monkeypatch.setattr(classification, "aov_rows", lambda images, name: np.arange(4))
    monkeypatch.setattr(classification, "shading_points", lambda pair, at, rows: rows)
    monkeypatch.setattr(classification, "diffuse_within_float64", lambda scene, points, *rest: points < 0)
    classes = np.full(4, CLASS_CODE["explained"])
    judge._classify_diffuse(classes, 1.0)
    assert names(classes) == ["explained"] * 3 + ["wrong"] and asked == [[]]
    classes = np.full(4, CLASS_CODE["agree"])
    judge._classify_diffuse(classes, 1.0)
    assert asked[1] == np.flatnonzero(hit).tolist()


def test_agreeing_pixels_are_held_to_float64_by_a_sample(monkeypatch):
    codes = np.arange(7).repeat(5000)
    chosen = judge_with()._held_to_float64(codes)
    counts = {name: int(chosen[codes == CLASS_CODE[name]].sum()) for name in CLASSES}
    assert counts == {
        "agree": 4096, "explained": 5000, "tie": 5000, "reference_wrong": 5000, "out_of_domain": 5000,
        "wrong": 0, "undecided": 0,
    }  # fmt: skip


# ---- what a pixel is before


def at(**arrays) -> SimpleNamespace:
    return SimpleNamespace(**{name: np.array(value) for name, value in arrays.items()})


LIMIT = 2.0**-4


def test_a_normal_without_a_useful_bound_is_loose():
    cases = [0.0, LIMIT, np.nextafter(LIMIT, 1.0), INF, NAN]
    errors = np.array(list(itertools.product(cases, cases, [0.0, 1.0])))
    for named, hits_only in itertools.product([True, False], repeat=2):
        judge = judge_with(
            bounds=SimpleNamespace(at=at(n_error=errors[:, 0], sh_error=errors[:, 1]), own=at(n_error=errors[:, 0])),
            names_prims=named, pixels=SimpleNamespace(both_hit=errors[:, 2] > 0.0),
            answer=SimpleNamespace(hits_only=hits_only),
        )  # fmt: skip
        worst = np.maximum(errors[:, 0], errors[:, 1]) if named else errors[:, 0]
        expected = (errors[:, 2] > 0.0) & ~(worst <= LIMIT) & (not hits_only)
        assert judge._has_loose_normals().tolist() == expected.tolist()


def test_a_hit_without_a_bound_of_t_is_unresolved():
    hit, named, finite = bools(3)
    one, two = np.where(finite, 1.0, INF), np.where(finite, NAN, 2.0)
    for names_prims, expected in ((True, ~finite), (False, finite)):
        judge = judge_with(
            bounds=SimpleNamespace(at=at(t_error=one), own=at(t_error=two)), names_prims=names_prims, hit=hit,
            prim=np.where(named, 0, -1),
        )  # fmt: skip
        assert judge._is_unresolved().tolist() == (hit & named & expected).tolist()


FITS = {
    "as it is": ({}, True),
    "within": ({"t": 2.25}, True),
    "beyond": ({"t": 2.2500001}, False),
    "before": ({"t": 1.7499999}, False),
    "not possible": ({"possible": False}, False),
    "at the origin": ({"t": 0.0, "model_t": 0.0}, False),
    "behind": ({"t": -2.0, "model_t": -2.0}, False),
    "normal within": ({"n": (0.0, 0.009, 1.0)}, True),
    "normal beyond": ({"n": (0.0, 0.011, 1.0)}, False),
    "no number": ({"t": NAN}, False),
    "a miss": ({"hit": False, "possible": False, "t": INF}, True),
}


@pytest.mark.parametrize("what", FITS)
def test_mitsubas_answer_lies_on_the_primitive_that_it_names(monkeypatch, what):
    change, fits = FITS[what]
    plain = {"t": 2.0, "model_t": 2.0, "possible": True, "n": (0.0, 0.0, 1.0), "hit": True} | change
    bounds = at(possible=[plain["possible"]], t=[plain["model_t"]], t_error=[0.25], n=[(0.0, 0.0, 1.0)], n_error=[0.01])
    monkeypatch.setattr(classification, "aov_rows", lambda images, name: np.array([plain["n"]]))
    result = SimpleNamespace(hit=np.array([plain["hit"]]), answer=SimpleNamespace(t=np.array([plain["t"]])))
    judge = judge_with(
        names_prims=False, bounds=SimpleNamespace(at=bounds), result=result, t_max=np.ones(1),
        pair=SimpleNamespace(reference=None),
    )  # fmt: skip
    assert judge._reference_fits().tolist() == [fits]
    judge.names_prims = True
    assert judge._reference_fits().tolist() == [True]


def test_a_hit_near_an_end_of_its_ray_is_adjudicated():
    own = at(t=[2.0] * 6, t_error=[0.25] * 6)
    judge = judge_with(
        bounds=SimpleNamespace(own=own),
        t_min=np.array([0.0, 1.74, 1.75, 2.1, 0.0, 0.0]),
        t_max=np.array([INF, INF, INF, INF, 2.25, 2.24]),
    )
    assert judge._near_end().tolist() == [False, False, True, True, False, True]
    judge.bounds.own.t[0] = NAN
    assert judge._near_end()[0]


def test_a_miss_where_something_may_be_hit_is_adjudicated(monkeypatch):
    monkeypatch.setattr(classification, "RAYS_PER_BATCH", 4)
    count = 23
    asked = []

    def possible(o, d, t_max, t_min):
        asked.append(o[:, 0].astype(int).tolist())
        assert (t_max == o[:, 0] + 1.0).all() and (t_min == o[:, 0] + 0.5).all() and (d[:, 1] == o[:, 0]).all()
        return SimpleNamespace(ray=np.flatnonzero(o[:, 0] % 3 == 0))

    rows = np.arange(count)
    o, d = np.zeros((2, count, 3))
    o[:, 0] = d[:, 1] = rows
    t_max = np.where(rows == 21, -1.0, rows + 1.0)
    judge = judge_with(
        hit=rows % 2 == 1, t_max=np.where(rows == 6, -1.0, t_max), t_min=rows + 0.5, o=o, d=d,
        bracket=SimpleNamespace(possible_hits=possible),
    )  # fmt: skip
    assert np.flatnonzero(judge._may_hit()).tolist() == [0, 12, 18]
    assert (
        list(itertools.chain(*asked)) == [row for row in range(0, count, 2) if row != 6] and max(map(len, asked)) == 4
    )


# ---- where nearly all of many pixels are wrong


@pytest.mark.parametrize(("share", "left_out"), [(0.0, True), (0.06, True), (0.14, False), (1.0, False)])
def test_pixels_like_many_wrong_ones_are_left_undecided(monkeypatch, share, left_out):
    """More than 512 that disagree in one way, of which a sample is wrong but for a tenth."""
    count = 2000
    shape = np.arange(count) // 1000
    rng = np.random.default_rng(3)
    right = rng.permutation(np.arange(count) < share * count)

    def asked(rows):
        return adjudicated(np.where(right[rows], 0.0, INF), rows=rows), None

    judge = judge_with(
        result=SimpleNamespace(shape_id=shape, hit=np.ones(count, bool)), hit=np.zeros(count, bool),
        model=SimpleNamespace(packed=SimpleNamespace(parts=[0, 0])), _adjudicated=asked,
        _excused=lambda exact: np.zeros(int(exact.wrong.sum()), bool),
    )  # fmt: skip
    rows = np.concatenate([np.arange(700), np.arange(1000, 1512)])  # 700 of one shape, 512 of another
    found = judge._surely_wrong(rows, count)
    assert found.sum() == (700 - 512 if left_out else 0) and not found[700:].any()
    judge._excused = lambda exact: np.ones(int(exact.wrong.sum()), bool)
    assert not judge._surely_wrong(rows, count).any()


def test_hits_and_misses_of_one_shape_are_kinds_of_their_own():
    count = 1200
    hit = np.arange(count) % 2 == 0
    judge = judge_with(
        result=SimpleNamespace(shape_id=np.zeros(count, int), hit=np.ones(count, bool)), hit=hit,
        model=SimpleNamespace(packed=SimpleNamespace(parts=[0])),
        _adjudicated=lambda rows: (adjudicated(np.where(hit[rows], 0.0, INF), rows=rows), None),
        _excused=lambda exact: np.zeros(int(exact.wrong.sum()), bool),
    )  # fmt: skip
    found = judge._surely_wrong(np.arange(count), count)
    assert found.sum() == 600 - 512 and not found[hit].any()
    judge.model.packed.parts = [0] * 65  # shapes are not told apart where there are so many
    judge.result.shape_id = np.arange(count) // 400
    assert judge._surely_wrong(np.arange(count), count).sum() == 600 - 512
    judge.model.packed.parts = [0] * 64
    assert judge._surely_wrong(np.arange(count), count).sum() == 0


# ---- known defects


def test_a_case_is_looked_up_where_geometry_is_wrong_and_not_where_light_is(monkeypatch):
    seen = {}

    class Measurement:
        def __init__(self, model, oracle):
            pass

        def all_of(self, lines, claims, answers, prims):
            seen.update(o=lines[0].tolist(), answers=[each.row for each in answers], prims=prims, claims=claims)
            return [f"features {prim}" for prim in prims]

    monkeypatch.setattr(classification, "FeatureMeasurement", Measurement)
    monkeypatch.setattr(classification, "defect_of", lambda features: 30 if features == "features 12" else None)
    judge = judge_with(
        reference_lines=(np.arange(6), np.zeros(6), np.zeros(6)), model=None, oracle=None,
        pair=SimpleNamespace(rays=SimpleNamespace(is_list=False)), reference_prim=np.arange(10, 16),
        _reference_claims=lambda rows: rows.tolist(),
    )  # fmt: skip
    agreeing = np.array([False, True, False, False, False, False])
    found = judge._known_cases(np.array([1, 2, 4]), agreeing, adjudicated(np.zeros(6)))
    assert found == {1: None, 2: 30, 4: None}
    assert seen == {"o": [2, 4], "answers": [2, 4], "prims": [12, 14], "claims": [2, 4]}
    assert judge._known_cases(np.array([], int), agreeing, adjudicated([])) == {}
