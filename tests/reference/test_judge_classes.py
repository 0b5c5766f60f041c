"""The class of a pixel as a table: answers that are altered by a share of a bound, and what the judge makes of them.

Mitsuba answers once; each row of a table alters the answer of one side, at some pixels of every kind of primitive.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from aimed_rays import direction
from candidates import ours
from mitsuba_scenes import lit_scene, scene_judge

import caster
from caster.aovs import Aovs
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE
from mitsuba_ref.judge.aggregate import class_counts, defect_counts, failing_by_check, listed_failures
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.diagnosis import diagnose, failing_rows, sentence_by_row
from mitsuba_ref.judge.explanations import open_reason
from mitsuba_ref.judge.verdict import CLASSES
from mitsuba_ref.subjects.function import FunctionSubject

INSIDE, OUTSIDE = 0.98, 1.02
TURN = {"rotate": {"axis": [1, 2, 3], "degrees": 37}}
SHAPES = (
    caster.Sphere(name="ball", center=(-0.9, 0.3, 0), radius=0.6),
    caster.Disk(name="lid", to_world=[{"scale": 0.6}, TURN, {"translate": [0.5, 0.7, 0]}]),
    caster.Cylinder(name="tube", to_world=[{"scale": 0.4}, TURN, {"translate": [0.8, -0.6, 0]}]),
    caster.Torus(name="ring", to_world=[{"scale": 0.4}, TURN, {"translate": [-0.5, -0.7, 0.4]}], segments=9, sides=5),
    caster.Rectangle(name="wall", to_world=[{"scale": 1.4}, {"translate": [0, 0, -1]}]),
)
LIGHTS = (
    caster.Point(position=(2, 5, 3), intensity=(30, 30, 30)),
    caster.Directional(direction=(0.3, -1, -0.6), irradiance=(1, 1, 1)),
    caster.Ambient(radiance=(0.1, 0.2, 0.3)),
)


SCENE = lit_scene(*SHAPES, film=caster.Film(width=24, height=16), lights=LIGHTS)


@pytest.fixture(scope="module")
def one(brought) -> Judge:
    return brought(SCENE)


@pytest.fixture(scope="module")
def first(one) -> Judgement:
    found = one.judge()
    shapes = aov_rows(one.subject, "shape_id")
    assert found.is_class("agree").all() and set(np.unique(shapes)) == {-1, 0, 1, 2, 3, 4}
    assert all((found.ratios[name][shapes < 0] == 0.0).all() for name in found.ratios)
    assert all(
        (found.ratios[name][shapes >= 0] > 0.0).any() for name in ("depth", "position", "normal", "uv", "diffuse")
    )
    return found


def altered(judge: Judge) -> Judge:
    """The same, of arrays that a test may alter; `again` judges what was made of them."""
    pair = judge.pair

    def images(aovs: Aovs) -> Aovs:
        return Aovs({name: image.copy() for name, image in aovs.items()}, aovs.hit.copy())

    def copies(record: Any) -> Any:
        arrays = {name: np.array(each) for name, each in vars(record).items() if isinstance(each, np.ndarray)}
        return replace(record, **arrays)

    answer, result = copies(pair.answer), copies(pair.result)
    wide = {name: getattr(result.answer, name).astype(np.float64) for name in ("t", "uv")}
    result = replace(result, answer=replace(copies(result.answer), **wide))
    subject = images(pair.subject)
    if answer.images is not None:
        answer = replace(answer, images=subject)
    made = replace(pair, subject=subject, reference=images(pair.reference), answer=answer, result=result)
    return Judge(judge.scene, judge.model, made, judge.view)


def again(judge: Judge) -> Judge:
    return Judge(judge.scene, judge.model, judge.pair, judge.view)


def directions(count: int) -> np.ndarray:
    return direction(np.random.default_rng(7), count)


def classes_at(judgement: Judgement, rows: np.ndarray) -> set[str]:
    return {CLASSES[code] for code in judgement.classes[rows]}


# ---- one quantity, by a share of its bound

QUANTITIES = ("depth", "position", "normal", "shading_normal", "uv", "diffuse")


def move_reference(judge: Judge, name: str, share: float) -> np.ndarray:
    """Mitsuba's value is ours, and a share of the bound beside it, wherever both hit; the rows."""
    pair, at = judge.pair, judge.at
    rows = np.flatnonzero(judge.hit & at.certain)
    ours, theirs = (aov_rows(images, name) for images in (pair.subject, pair.reference))
    if name == "depth":
        off = share * at.t_error[rows]
        theirs[rows] = ours[rows] + off * judge.length[rows]
        pair.result.t[rows] = pair.result.answer.t[rows] = judge.answer.t[rows] + off
    elif name == "uv":
        step, points = np.array([1e-6, 0.0]), judge.model.uv_points
        moved = points(judge.prim, ours + step, REFERENCE_SIDE) - points(judge.prim, ours, OUR_SIDE)
        per_step = np.linalg.norm(moved, axis=1)
        rows = rows[(per_step[rows] > 1e-9) & judge.model.reference_has_uv(judge.prim)[rows]]
        theirs[rows] = ours[rows] + step * (share * at.uv_error[rows] / per_step[rows])[:, None]
        pair.result.answer.uv[rows] = theirs[rows]
    else:
        error = {"position": at.p_error, "normal": at.n_error, "shading_normal": at.sh_error}[name]
        theirs[rows] = ours[rows] + share * error[rows, None] * directions(len(rows))
    return rows


def move_subject(judge: Judge, name: str, share: float) -> np.ndarray:
    """Our value is a share of float64's bound beside that of the primitive that we name; the rows."""
    pair, own = judge.pair, judge.own
    rows, ours = np.flatnonzero(judge.hit), aov_rows(pair.subject, name)
    if name == "depth":
        t = judge.answer.t[rows] = own.t[rows] + share * own.t_error[rows]
        ours[rows] = t * judge.length[rows]
        aov_rows(pair.subject, "position")[rows] = judge.o[rows] + t[:, None] * judge.d[rows]
        return rows
    value, error = {
        "position": (judge.point, own.p_error),
        "normal": (own.n, own.n_error),
        "shading_normal": (own.sh_n, own.sh_error),
    }[name]
    ours[rows] = value[rows] + share * error[rows, None] * directions(len(rows))
    return rows


@pytest.mark.parametrize("name", QUANTITIES[:5])
def test_mitsubas_value_may_be_off_by_its_bound_and_no_more(one, first, name):
    for share in (INSIDE, OUTSIDE):
        judge = altered(one)
        rows = move_reference(judge, name, share)
        found = again(judge).judge()
        assert len(rows) > 200 and not set(np.flatnonzero(first.ratios[name] != found.ratios[name])) - set(rows)
        assert found.ratios[name][rows] == pytest.approx(np.full(len(rows), share), rel=0.01)
        # Ours is exactly right, no rounding allows Mitsuba's answer, and no defect that is known is like it.
        expected = {"agree"} if share == INSIDE else {"reference_wrong"}
        assert classes_at(found, rows) == expected
        assert set(found.cases.values()) == (set() if share == INSIDE else {None})
        failing = failing_rows(found)
        assert failing.tolist() == ([] if share == INSIDE else rows.tolist())
        assert defect_counts(found) == ({} if share == INSIDE else {"unlisted": len(rows)})


@pytest.mark.parametrize("name", ["position", "normal", "shading_normal"])
def test_our_value_may_be_off_by_float64s_bound_and_no_more(one, name):
    inside, outside = altered(one), altered(one)
    rows = move_subject(inside, name, 0.9)
    judge = again(inside)
    check = judge.self_checks[name]
    assert check.counts[rows].all() and check.error[rows] / check.bound[rows] == pytest.approx(0.9, rel=0.08)
    assert classes_at(judge.judge(), rows) == {"agree"}
    move_subject(outside, name, 1.1)
    judge = again(outside)
    found = judge.judge()
    assert classes_at(found, rows) == {"wrong"} and failing_rows(found).tolist() == rows.tolist()
    check = judge.self_checks[name]
    assert check.fails[rows].all()
    assert np.array_equal(np.sort(failing_by_check(found)[name]), rows)


def test_our_t_may_be_off_by_float64s_bound_and_no_more(one):
    """Exact arithmetic is asked at some pixels; nearly all of its bound may be used up by its own value of t."""
    judge = altered(one)
    rows = move_subject(judge, "depth", 0.5)
    found = again(judge).judge()
    assert (found.ratios["exact"] <= 1.0).all() and (found.ratios["on_surface"] <= 0.8).all()
    judge = altered(one)
    move_subject(judge, "depth", 1.6)
    judge = again(judge)
    found = judge.judge()
    asked = np.intersect1d(rows, found.exact.rows)
    assert len(asked) == len(rows) and classes_at(found, rows) == {"wrong"}
    assert (found.ratios["exact"][rows] > 1.0).all() and (found.ratios["on_surface"][rows] > 1.0).all()
    assert (found.ratios["depth"][rows] < 1.0).all()  # float32 would not see it


@pytest.mark.parametrize("side", ["subject", "reference"])
def test_light_is_wrong_where_float64_does_not_give_it_and_else_it_is_mitsubas(one, first, side):
    judge = altered(one)
    rows = np.flatnonzero(judge.hit)
    if side == "subject":
        aov_rows(judge.subject, "diffuse")[rows] *= 1.0 + 1e-4
    else:
        judge.result.ambient[rows] += 0.01
    found = again(judge).judge()
    lit = rows[aov_rows(one.subject, "diffuse")[rows].any(axis=1)]
    assert len(lit) > 200 and classes_at(found, lit) == {"wrong" if side == "subject" else "reference_wrong"}
    ratio = found.ratios["diffuse"][lit]
    assert np.isinf(ratio).all() if side == "subject" else ((ratio > 1.0) & np.isfinite(ratio)).all()
    rest = np.setdiff1d(np.arange(len(judge.hit)), lit)
    assert np.array_equal(found.classes[rest], first.classes[rest])


@pytest.mark.parametrize("light", [0, 1])
def test_a_shadow_that_is_not_there_or_missing_is_the_fault_of_who_has_it(one, light):
    """Mitsuba's answer for one light turned round, then ours: no rounding allows either away from a shadow's edge."""
    judge = altered(one)
    unlit = judge.result.unshadowed[light]
    rows = np.flatnonzero(judge.hit & judge.at.certain & (unlit > 1e-3).any(axis=1))
    both = judge.result.visible[light, rows]
    assert both.any() and not both.all()
    judge.result.visible[light, rows] ^= True
    found = again(judge).judge()
    assert (classes_at(found, rows) - {"explained"}) == {"reference_wrong"}
    assert found.is_class("reference_wrong")[rows].mean() > 0.9
    ours = altered(one)
    value = aov_rows(ours.subject, "diffuse")
    value[rows] += np.where(both[:, None], -1.0, 1.0) * unlit[rows]
    found = again(ours).judge()
    assert (classes_at(found, rows) - {"explained", "agree"}) == {"wrong"}
    assert found.is_class("wrong")[rows].mean() > 0.9


@pytest.mark.parametrize("part", ["unshadowed", "ambient"])
def test_mitsubas_light_is_held_to_a_few_roundings(one, part):
    """Neither a thousandth of what is allowed is a difference, nor does a thousandth of the light pass."""
    for share, expected in ((2.0**-26, "agree"), (1e-3, "reference_wrong")):
        judge = altered(one)
        light = getattr(judge.result, part)
        total = judge.result.diffuse
        light *= 1.0 + share
        changed = np.abs(judge.result.diffuse - total).max(axis=1)
        rows = np.flatnonzero(judge.hit & (changed > 0.3 * share * total.max(axis=1)) & (total > 0.0).all(axis=1))
        found = again(judge).judge()
        assert len(rows) > 50 and classes_at(found, rows) == {expected}
        assert (found.ratios["diffuse"][rows] > 0.0).all()


# ---- other hits


def set_to_miss(images: Aovs, rows: np.ndarray) -> None:
    """Make all values of one side at these rows those of a miss."""
    for name in images:
        aov_rows(images, name)[rows] = {"depth": np.inf, "shape_id": -1, "prim_id": -1}.get(name, 0)
    images.hit.ravel()[rows] = False


def miss(judge: Judge, rows: np.ndarray) -> None:
    judge.answer.t[rows], judge.answer.prim[rows] = np.inf, -1
    set_to_miss(judge.subject, rows)


def reference_misses(judge: Judge, rows: np.ndarray) -> None:
    judge.result.t[rows] = judge.result.answer.t[rows] = np.inf
    judge.result.shape_id[rows] = -1
    set_to_miss(judge.pair.reference, rows)


def some_of_each_shape(judge: Judge, count: int = 3) -> np.ndarray:
    """Rows away from edges, of every shape, whose normals are known."""
    shapes, own = judge.result.shape_id, judge.own
    certain = judge.at.certain & own.certain & np.isfinite(own.n_error)
    rows = [np.flatnonzero((shapes == shape) & certain)[:count] for shape in range(len(SHAPES))]
    return np.sort(np.concatenate(rows))


HIT_FAULTS = {
    "ours misses": (miss, "wrong", {"mask", "shape_id", "exact"}, "missed; exact arithmetic hits"),
    "Mitsuba misses": (reference_misses, "reference_wrong", {"mask", "shape_id"}, "Mitsuba wrong in no known way"),
    "both miss": (
        lambda judge, rows: (miss(judge, rows), reference_misses(judge, rows)),
        "wrong",
        {"exact"},
        "missed; exact arithmetic hits",
    ),
}


@pytest.mark.parametrize("fault", HIT_FAULTS)
def test_another_hit_or_miss_is_the_fault_of_who_is_not_exact(one, first, fault):
    plant, expected, checks, what = HIT_FAULTS[fault]
    judge = altered(one)
    rows = some_of_each_shape(judge)
    plant(judge, rows)
    judge = again(judge)
    found = judge.judge()
    assert classes_at(found, rows) == {expected} and failing_rows(found).tolist() == rows.tolist()
    rest = np.setdiff1d(np.arange(len(judge.hit)), rows)
    assert np.array_equal(found.classes[rest], first.classes[rest])
    by = failing_by_check(found)
    assert set(by) == checks
    assert all(sorted(each) == rows.tolist() for each in by.values())
    assert all(np.isinf(found.ratios[name][rows]).all() for name in checks)
    diagnosis = diagnose(judge, found)
    assert all(what in cause.what for cause in diagnosis)
    assert sorted(sentence_by_row(diagnosis)) == rows.tolist()
    counts = class_counts(found, judge.any_hit)
    assert counts[expected] == len(rows) and sum(counts.values()) == judge.any_hit.sum() + (
        len(rows) if fault == "both miss" else 0
    )
    listed = listed_failures(judge, found, diagnosis)
    assert len(listed) == 10 and {each.verdict for each in listed} == {expected}
    assert [(each.x, each.y) for each in listed] == [(row % 24, row // 24) for row in rows[:10].tolist()]


@pytest.mark.parametrize(
    ("name", "off", "reported"),
    [("depth", 1e-12, "depth"), ("prim_id", 1, "shape_id"), ("hit", True, "mask"), ("albedo", 0.001, "diffuse")],
)
def test_an_image_that_contradicts_its_hit_is_undecided(one, name, off, reported):
    """No rounding excuses it, and no exact answer makes it right. Other contradictions are in compared.toml."""
    judge = altered(one)
    rows = np.flatnonzero(~judge.hit)[:12] if name == "hit" else some_of_each_shape(judge)
    image = aov_rows(judge.subject, name)
    channel = rows % 3  # one is enough: each in some pixels
    image[(rows, channel) if image.ndim == 2 else rows] += off
    judge = again(judge)
    found = judge.judge()
    assert classes_at(found, rows) == {"undecided"}
    assert np.isinf(found.ratios[reported][rows]).all() and judge.inconsistent[reported][rows].all()
    assert sum(each.sum() for each in judge.inconsistent.values()) == len(rows)
    expected = f"our image contradicts our own hit: {reported}"
    assert {open_reason(judge, found, int(row)) for row in rows} == {expected}
    assert [cause.what for cause in diagnose(judge, found)] == [expected]
    assert not judge.consistent[rows].any() and judge.consistent.sum() == len(judge.hit) - len(rows)


# ---- candidates: t and normals, of float64 or float32, and numbers of what is hit


@pytest.fixture(scope="module", params=["float64", "float32"])
def candidate(request, send) -> Judge:
    subject = FunctionSubject("right", ours, request.param)
    return scene_judge(SCENE, subject, send=send)


@pytest.mark.parametrize("what", ["t", "normal"])
def test_a_candidate_may_be_off_by_its_own_bound_and_no_more(candidate, what):
    own = candidate.own
    rows = some_of_each_shape(candidate, 5)
    name = "depth" if what == "t" else "normal"
    for share in (0.9, 1.1):
        judge = altered(candidate)
        if what == "t":
            judge.answer.t[rows] = own.t[rows] + share * own.t_error[rows]
        else:
            judge.answer.n[rows] = own.n[rows] + share * own.n_error[rows, None] * directions(len(rows))
        found = again(judge).judge()
        assert found.ratios[name][rows] == pytest.approx(np.full(len(rows), share), rel=0.08)
        expected = {"agree"} if share < 1.0 else {"wrong"}
        assert classes_at(found, rows) <= expected | ({"explained"} if what == "t" else set())
        assert (classes_at(found, rows) & expected) == expected
        rest = np.setdiff1d(np.arange(len(judge.hit)), rows)
        assert classes_at(found, rest) <= {"agree", "explained", "tie"}
