"""The diagnosis of failing pixels by tables: causes in their order, numbers of primitives, outlines and separators."""

from types import SimpleNamespace

import numpy as np
import pytest
from pixel_tables import INF, NAN, Z, intersections, pixels, roots_of

import caster
from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.judge import diagnosis, hypotheses
from mitsuba_ref.judge.adjudication import Adjudication
from mitsuba_ref.judge.classification import CLASS_CODE, Judgement
from mitsuba_ref.judge.diagnosis import Cause, best_split, necessary_share
from mitsuba_ref.judge.hypotheses import Explained
from mitsuba_ref.reference.shared_input import packed_float32


def bools(count: int, *rows: int) -> np.ndarray:
    return np.isin(np.arange(count), rows)


def judgement_of(classes, right=(), cases=None, ratios=None) -> Judgement:
    """right: rows whose answer is exactly right; every row is adjudicated."""
    codes = np.array([CLASS_CODE[name] for name in classes])
    rows = np.arange(len(codes))
    answers = [SimpleNamespace(t=None, prim=-1) for _ in rows]
    exact = Adjudication(rows, answers, np.where(np.isin(rows, list(right)), 0.0, INF))
    return Judgement(codes, ratios or {}, {}, exact, cases or {}, 0.0)


MARK = " where nothing is hit; a miss has t inf"


def causes_with(failing, count=9) -> diagnosis._Causes:
    classes = ["wrong" if row in failing else "agree" for row in range(count)]
    return diagnosis._Causes(SimpleNamespace(t_max=np.zeros(count)), judgement_of(classes))


# ---- causes


def test_a_row_belongs_to_the_first_cause_that_takes_it(monkeypatch):
    separators = []
    monkeypatch.setattr(
        diagnosis, "separator_text", lambda judge, judgement, rows: separators.append(rows.tolist()) or f"at {rows[0]}"
    )
    causes = causes_with([1, 2, 3, 5, 7])
    causes.take("a", np.array([2, 4, 1]), 5, "remedy")
    causes.take("b", np.array([2, 3]), where=True)
    causes.take("none", np.array([0, 1, 2]), 9, "x", where=True)
    causes.take("a", np.array([5]), 6, "other")
    causes.take("b", np.array([7]))
    assert separators == [[3]] and not causes.left.any()
    found = [
        (cause.what, cause.rows.tolist(), cause.of, cause.remedy, cause.where) for cause in causes.diagnosis().causes
    ]
    assert found == [("a", [1, 2, 5], 6, "other", ""), ("b", [3, 7], 0, "", "at 3")]


def test_a_cause_beside_another_is_a_second_one():
    causes = causes_with([1, 2, 3, 5])
    causes.take("first", np.array([1, 2]), 4, "mend")
    f = SimpleNamespace(rows=np.array([1, 2, 3, 5]))
    diagnosis._take_or_add(causes, Explained("n", "turn", np.array([True, False, True, False])), f)
    diagnosis._take_or_add(causes, Explained("n", "turn", np.array([True, True, False, False])), f)
    diagnosis._take_or_add(causes, Explained("first", "mend", np.array([True, True, False, False])), f)
    diagnosis._take_or_add(causes, Explained("m", "", np.array([False] * 4)), f)
    found = [(each.what, each.rows.tolist(), each.of, each.remedy, each.second) for each in causes.diagnosis().causes]
    assert found == [
        ("first", [1, 2], 4, "mend", False), ("n", [3], 4, "turn", False), ("n", [1], 4, "turn", True),
        ("n", [1, 2], 4, "turn", True),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("t", "hit", "t_max", "hits_only", "found"),
    [
        ([9.0, 9.0, 1.0, 9.0], [0, 0, 1, 0], [INF] * 4, False, ("t is 9" + MARK, [0, 1, 3])),
        ([-1.0, -1.0, 1.0, INF], [0, 0, 1, 0], [0.0, 0.0, 1.0, -1.0], False, ("t is -1" + MARK, [0, 1])),
        ([9.0, 8.0, 1.0, 9.0], [0, 0, 1, 0], [INF] * 4, False, None),
        ([INF, INF, 1.0, INF], [0, 0, 1, 0], [INF] * 4, False, None),
        ([NAN, NAN, 1.0, NAN], [0, 0, 1, 0], [INF] * 4, False, None),
        ([9.0, 1.0, 1.0, 1.0], [0, 1, 1, 1], [INF] * 4, False, None),
        ([9.0, 9.0, 1.0, 9.0], [0, 0, 1, 0], [INF] * 4, True, None),
    ],
)  # fmt: skip
def test_one_number_at_all_misses_is_a_mark(t, hit, t_max, hits_only, found):
    judge = SimpleNamespace(
        result=SimpleNamespace(hit=np.array(hit, bool)), t_max=np.array(t_max),
        answer=SimpleNamespace(t=np.array(t), hits_only=hits_only),
    )  # fmt: skip
    marked = [(what, rows.tolist()) for what, rows in diagnosis._marked_misses(judge)]
    assert marked == ([] if found is None else [found])


def test_where_numbers_were_not_rounded_mitsuba_is_not_called_wrong(monkeypatch):
    """It was given others than the subject, and exact arithmetic speaks of the subject's alone."""
    monkeypatch.setattr(diagnosis, "subject_name", lambda judge: "ours")
    scene = Scene(camera=caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0)), shapes=[caster.Sphere(radius=0.1)])
    for numbers, said in (
        (packed_float32(scene), "ours is right, and Mitsuba wrong in no known way"),
        (packed(scene), "each is right for its own numbers: those of the subject were not rounded to float32"),
    ):
        judge = SimpleNamespace(model=SimpleNamespace(packed=numbers))
        assert diagnosis._of_two_right_answers(judge).startswith(said)


def test_causes_are_looked_for_in_their_order(monkeypatch):
    """One row of each kind, and the last of each is taken by what comes before."""
    classes = ["agree", *["wrong"] * 6, "reference_wrong", "wrong", "undecided", "undecided", "wrong", "wrong"]
    count = len(classes)
    not_answered = np.zeros(count, bool)
    not_answered[[2, 12]] = True
    judge = SimpleNamespace(
        t_max=np.where(np.arange(count) == 3, -1.0, np.arange(count) % 2.0), hit=np.ones(count, bool),
        answer=SimpleNamespace(broken={"not finite": not_answered}),
        model=SimpleNamespace(packed=SimpleNamespace(parts=())),
    )  # fmt: skip
    judge.hit[12] = False
    judgement = judgement_of(classes, right=[5, 6, 8, 11], cases={7: None, 0: 8})
    judgement = Judgement(
        judgement.classes, judgement.ratios, judgement.allowed, judgement.exact, judgement.cases, 0.0, np.array([9])
    )
    seen = {}

    def explain(causes, rows):
        seen["explained"] = rows.tolist()
        causes.take("explained", rows[:1])

    def wrong_surface(given, found, rows):
        assert given is judge and found is judgement
        seen["surface"] = rows.tolist()
        yield Explained("normals", "mend", np.array([True])), rows[:1]
        yield Explained("uv", "", np.array([True])), rows[1:2]

    monkeypatch.setattr(diagnosis, "_marked_misses", lambda judge: [("marked", np.array([1]))])
    monkeypatch.setattr(diagnosis, "subject_name", lambda judge: "the candidate")
    monkeypatch.setattr(diagnosis, "open_reason", lambda judge, judgement, row: f"open {row}")

    def taken(given, found, rows):
        assert given is judge and found is judgement
        return rows

    monkeypatch.setattr(diagnosis, "_pixels", taken)
    monkeypatch.setattr(diagnosis, "_explain", explain)
    monkeypatch.setattr(diagnosis, "_wrong_surface", wrong_surface)

    def found():
        return [
            (each.what, each.rows.tolist(), each.of, each.remedy)
            for each in diagnosis.diagnose(judge, judgement).causes
        ]

    expected = [
        ("marked", [1], 1, "a miss is t = inf"), ("no answer: not finite", [2, 12], 0, ""),
        ("a hit where the camera has no ray", [3], 0, ""),
        ("the candidate is right, and Mitsuba wrong in no known way", [7], 0, ""), ("explained", [4], 0, ""),
        (diagnosis.NOT_ADJUDICATED, [9], 0, ""), ("open 10", [10], 0, ""), ("normals", [5], 4, "mend"),
        ("uv", [6], 0, ""),
        ("not what is there, in no way that is recognised", [8, 11], 0, ""),
    ]  # fmt: skip
    assert found() == expected and seen == {"explained": [4], "surface": [5, 6, 8, 11]}
    judgement.exact.ratio[[5, 6]] = INF
    monkeypatch.setattr(diagnosis, "MAX_DIAGNOSED_PIXELS", 2)
    many = found()
    assert len(seen["explained"]) == 2
    rest = [each for each in many if each[0].startswith("wrong, as")]
    assert rest == [
        ("wrong, as the others are; the cause was looked for at some of them",
         sorted({4, 5, 6} - {seen["explained"][0]}), 0, "")
    ]  # fmt: skip
    monkeypatch.setattr(diagnosis, "MAX_DIAGNOSED_PIXELS", 3)
    assert not [each for each in found() if each[0].startswith("wrong, as")]
    nothing = judgement_of(["agree", "explained", "tie"])
    assert diagnosis.diagnose(SimpleNamespace(t_max=np.zeros(3)), nothing).causes == ()


def test_exact_answers_of_rows():
    asked = []
    judge = SimpleNamespace(near=lambda *given: asked.extend(each.tolist() for each in given) or "near")
    answers = [SimpleNamespace(t=2.5, prim=0), SimpleNamespace(t=None, prim=-1), None]
    exact = Adjudication(np.array([3, 5, 8]), answers, np.zeros(3))
    found = diagnosis._pixels(judge, SimpleNamespace(exact=exact), np.array([3, 5, 8]))
    assert asked == [[3, 5, 8], [0, -1, -1], [2.5, INF, INF]] and found.at == "near"
    assert (found.hit.tolist(), found.t.tolist(), found.prim.tolist()) == (
        [True, False, False],
        [2.5, INF, INF],
        [0, -1, -1],
    )


def hypothesis(*fits, what="h", single=False):
    def found(f, right):
        yield Explained(what, "mend", np.array(fits, bool), single)

    return found


@pytest.mark.parametrize(
    ("fits", "single", "found"),
    [
        ([1] * 9 + [0], False, True), ([1] * 8 + [0] * 2, False, False), ([1] * 3, False, True),
        ([1] * 2, False, False),
        ([1] * 2, True, True), ([0] * 3, True, False), ([], True, False),
    ],
)  # fmt: skip
def test_the_simplest_hypothesis_explains_nearly_all(monkeypatch, fits, single, found):
    late = hypothesis(*[1] * len(fits), what="late", single=True)
    first = hypothesis(*fits, single=single)
    monkeypatch.setattr(diagnosis, "HYPOTHESES", (first, late))
    monkeypatch.setattr(diagnosis, "OF_THE_SAME_SURFACE", (first,))
    simplest = diagnosis._simplest(pixels([1.0] * len(fits), [2.0] * len(fits)), None)
    if len(fits):
        assert (simplest[0].what, simplest[1]) == (("h", True) if found else ("late", False))
    else:
        assert simplest is None


def explanation(monkeypatch, exact, given, hypotheses=(), descriptions=(), same=(), **more):
    """Causes of pixels that are all wrong but for `right`, in their order."""
    count = len(exact)
    f = pixels(exact, given, **({"prim": np.where(np.isfinite(exact), np.arange(count), -1)} | more))
    f.judge.n = None
    monkeypatch.setattr(diagnosis, "HYPOTHESES", hypotheses)
    monkeypatch.setattr(diagnosis, "DESCRIPTIONS", descriptions)
    monkeypatch.setattr(diagnosis, "OF_THE_SAME_SURFACE", same)
    monkeypatch.setattr(diagnosis, "_pixels", lambda judge, judgement, rows: pixels([], []))
    monkeypatch.setattr(diagnosis, "_wrong_ids", lambda f: iter(()))
    monkeypatch.setattr(diagnosis, "_outline_text", lambda f: "")
    monkeypatch.setattr(diagnosis, "separator_text", lambda *given: "separated")
    judgement = judgement_of(["wrong"] * count)
    causes = diagnosis._Causes(f.judge, judgement)
    return causes, f


def texts(causes) -> list:
    return [(each.what, each.rows.tolist(), each.of, each.remedy, each.where) for each in causes.diagnosis().causes]


def test_what_explains_nearly_all_is_the_cause_of_pixels_that_are_off(monkeypatch):
    exact, given = [1.0] * 6, [2.0] * 4 + [1.0] * 2
    one = hypothesis(1, 1, 1, 1, what="another ray")
    causes, f = explanation(monkeypatch, exact, given, (one,))
    diagnosis._explain(causes, f)
    # it moves rays, of most pixels: other normals follow from it
    assert texts(causes) == [("another ray", [0, 1, 2, 3, 4, 5], 6, "mend", "")]
    causes, f = explanation(monkeypatch, exact, given, (one,), same=(one,))
    diagnosis._explain(causes, f)
    assert texts(causes) == [("another ray", [0, 1, 2, 3], 4, "mend", "")]
    three = hypothesis(1, 1, 1, what="another ray")
    causes, f = explanation(monkeypatch, exact, [2.0] * 3 + [1.0] * 3, (three,))
    diagnosis._explain(causes, f)
    assert texts(causes) == [("another ray", [0, 1, 2], 3, "mend", "")]  # no majority


def test_what_explains_some_is_a_cause_if_it_is_most_of_what_is_left(monkeypatch):
    exact, given = [1.0] * 10, [2.0] * 10
    half, third = (hypothesis(*[1] * 5 + [0] * 5, what="half"), hypothesis(*[0] * 5 + [1, 1] + [0] * 3, what="two"))
    rest = hypothesis(*[0] * 7 + [1] * 3, what="three")
    one = hypothesis(*[0] * 7 + [1] + [0] * 2, what="one", single=True)
    causes, f = explanation(monkeypatch, exact, given, (half, third, one, rest), (hypothesis(*[1] * 10, what="words"),))
    diagnosis._explain(causes, f)
    assert texts(causes) == [
        ("half", [0, 1, 2, 3, 4], 10, "mend", ""), ("one", [7], 10, "mend", ""),
        ("words", [5, 6, 8, 9], 10, "mend", ""),
    ]  # fmt: skip
    causes, f = explanation(monkeypatch, exact, given, (half, rest))
    diagnosis._explain(causes, f)
    found = texts(causes)
    assert found[:2] == [("half", [0, 1, 2, 3, 4], 10, "mend", ""), ("three", [7, 8, 9], 10, "mend", "")]
    assert found[2] == ("t is off: behind what is hit, by 1 of itself", [5, 6], 0, "", "separated")


def test_numbers_and_normals_are_looked_at_where_the_surface_is_right(monkeypatch):
    """Off by another quantity (0, 1, 2), off otherwise (3), right (4, 5, 6), a miss on either side (7)."""
    exact, given = [1.0] * 7 + [INF], [2.0] * 4 + [1.0] * 3 + [INF]
    one = hypothesis(1, 1, 1, 0, what="quantity")
    seen = {}

    def found(same, wrong_ids=(), n=True):
        causes, f = explanation(monkeypatch, exact, given, (), (one,), same)
        f.judge.n = np.zeros((8, 3)) if n else None

        def numbers(f):
            seen["ids"] = f.rows.tolist()
            for what, remedy, rows in wrong_ids:
                yield Explained(what, remedy, np.isin(f.rows, rows))

        def normals(f, n):
            seen["normals"] = f.rows.tolist()
            yield Explained("normals", "turn", f.rows == 5)

        monkeypatch.setattr(diagnosis, "_wrong_ids", numbers)
        monkeypatch.setattr(diagnosis, "explain_normals", normals)
        diagnosis._explain(causes, f)
        return [each[:4] for each in texts(causes)]

    off = ("t is off: behind what is hit, by 1 of itself", [3], 0, "")
    assert found(()) == [("quantity", [0, 1, 2], 4, "mend"), off, ("normals", [5], 3, "turn")]
    assert seen == {"ids": [4, 5, 6], "normals": [4, 5, 6]}
    found((one,))
    assert seen == {"ids": [0, 1, 2, 4, 5, 6], "normals": [0, 1, 2, 4, 5, 6]}
    named = found((), [("off by one", "add 1", [4]), ("another", "", [6])])
    assert seen["normals"] == [4, 5] and ("off by one", [4], 3, "add 1") in named and ("another", [6], 3, "") in named
    seen.clear()
    assert found((), n=False)[-1] == off and list(seen) == ["ids"]


def test_what_no_hypothesis_explains_is_described(monkeypatch):
    monkeypatch.setattr(diagnosis, "_outline_text", lambda f: f" [{f.rows.tolist()}]")
    exact, given = [2.0, INF, 2.0, 4.0, 2.0, 4.0, 0.0, 2.0], [INF, 3.0, 1.0, 1.0, 3.0, 7.0, 0.0, 2.0]
    found = [
        (what, np.flatnonzero(fits).tolist()) for what, fits in diagnosis._plain_descriptions(pixels(exact, given))
    ]
    assert found == [
        ("missed; exact arithmetic hits", [0]), ("a hit; exact arithmetic misses [[1]]", [1]),
        ("t is off: before what is hit, by 0.5 to 0.75 of itself [[2, 3]]", [2, 3]),
        ("t is off: behind what is hit, by 0.5 to 0.75 of itself", [4, 5]), ("t is off", [2, 3, 4, 5, 6, 7]),
    ]  # fmt: skip
    (missed, off) = diagnosis._plain_descriptions(pixels([2.0], [INF]))
    assert missed[1].tolist() == [True] and off[1].tolist() == [False]


# ---- numbers of shapes and primitives

PACKED = SimpleNamespace(shape_of=lambda prim: prim // 10, index_in_shape=lambda prim: prim % 10)


def ids(prims, shape_id=None, prim_id=None, prim=None, hit=None, roots=None):
    count = len(prims)
    arrays = {name: None if value is None else np.array(value) for name, value in
              (("shape_id", shape_id), ("prim_id", prim_id))}  # fmt: skip
    f = pixels([1.0] * count, [1.0] * count, prim=prims, roots=roots or roots_of(), **arrays)
    f.judge.answer.prim = None if prim is None else np.array(prim)
    f.judge.model = SimpleNamespace(packed=PACKED)
    if hit is not None:
        f.judge.hit = np.array(hit, bool)
    return [
        (each.what, each.remedy, np.flatnonzero(each.fits).tolist())
        for each in diagnosis._wrong_ids(f)
        if each.fits.any()
    ]


ANOTHER = "another primitive than the first one, at the same t"
PRIMS = [10, 11, 12, 13, 24, 25, 26, 27, 28, 29]
SHAPES, INDICES = [p // 10 for p in PRIMS], [p % 10 for p in PRIMS]


def test_a_number_that_is_off_by_one_counts_from_0():
    assert ids(PRIMS, SHAPES, INDICES) == []
    for step, word in ((1, "subtract"), (-1, "add")):
        found = ids(PRIMS, SHAPES, [i + step for i in INDICES])
        what = f"the primitive's number is off by one ({step:+d})"
        assert found == [(what, f"numbers count from 0: {word} 1", list(range(10)))]
        found = ids(PRIMS, [s + step for s in SHAPES], INDICES)
        assert found[0][0] == f"the shape's number is off by one ({step:+d})"
    nine = [i + 1 for i in INDICES[:9]] + [7]
    assert [each[2] for each in ids(PRIMS, prim_id=nine)] == [list(range(9)), [9]]
    eight = [i + 1 for i in INDICES[:8]] + [1, 2]
    assert ids(PRIMS, prim_id=eight) == [(ANOTHER, "", list(range(10)))]
    assert ids(PRIMS, prim_id=[i + 2 for i in INDICES]) == [(ANOTHER, "", list(range(10)))]
    two = [i + 1 for i in INDICES[:2]] + INDICES[2:]
    assert ids(PRIMS, prim_id=two) == [(ANOTHER, "", [0, 1])]
    three = [i + 1 for i in INDICES[:3]] + INDICES[3:]
    assert ids(PRIMS, prim_id=three)[0][0].startswith("the primitive's number is off by one")
    unsigned = np.array([i - 1 for i in INDICES[1:4]]).astype(np.uint32)
    assert ids(PRIMS[1:4], prim_id=unsigned)[0][0].endswith("(-1)")


def test_few_numbers_for_many_primitives():
    remedy = "return the number of the primitive in the order of the scene, or leave the column out"
    found = ids(PRIMS, [1] * 10, [0] * 10)
    assert found == [("the same primitive is named at all 10 hits", remedy, list(range(1, 10)))]
    hit = [1] * 8 + [0] * 2
    found = ids(PRIMS, prim_id=[0] * 4 + [3] * 4 + [8, 9], hit=hit)
    assert found == [("no more than 2 primitives are named at all 8 hits", remedy, [1, 2, 4, 5, 6, 7, 8, 9])] or (
        found[0][0] == "no more than 2 primitives are named at all 8 hits"
    )
    assert ids(PRIMS[:3], prim_id=[5] * 3)[0][0].startswith("the same primitive is")
    assert ids(PRIMS[:2] * 2, prim_id=[5] * 4)[0][0] == ANOTHER  # three times as many primitives, or more


def test_a_subject_that_names_primitives_names_another_one():
    assert ids(PRIMS[:4], prim=[10, 11, 10, 13]) == [(ANOTHER, "", [2])]


def test_numbers_of_another_surface_along_the_ray():
    """Of ray i, shape 2 i is hit first, at t = 1, and another one by more behind it."""
    first, behind = [20 * i for i in range(1, 9)], [10 * (2 * i + 3 + i * i) for i in range(1, 9)]
    roots = roots_of(
        *((ray, prim, 5.0) for ray, prim in enumerate(behind)), *((r, p, 1.0) for r, p in enumerate(first))
    )
    what = "the shape's number is that of another surface along the ray, t that of the first"
    remedy = "keep the number together with the smallest t"
    right, other = [p // 10 for p in first], [p // 10 for p in behind]
    beside = [number - 40 for number in other]  # of nothing on the ray
    for far, wrong, named in ((8, 0, True), (3, 3, True), (3, 4, False), (2, 0, False), (4, 4, True), (3, 0, True)):
        shapes = other[:far] + beside[far : far + wrong] + right[far + wrong :]
        found = ids(first, shapes, roots=roots)
        rest = [(ANOTHER, "", list(range(far, far + wrong)))] if wrong else []
        if named:
            assert found == [(what, remedy, list(range(far))), *rest]
        else:
            assert found == [(ANOTHER, "", list(range(far + wrong)))]


NAMES = [
    # roots of the ray (prim, t, bound), the ids given, whether another hit is named
    ([(25, 5.0, 0.0)], 2, 5, True), ([(25, 5.0, 0.0)], 2, 6, False), ([(25, 5.0, 0.0)], 1, 5, False),
    ([(25, 5.0, 0.0)], None, 5, True), ([(25, 5.0, 0.0)], 2, None, True), ([(25, 1.0, 0.0)], 2, 5, False),
    ([(25, 1.5, 0.25)], 2, 5, False), ([(25, 1.51, 0.25)], 2, 5, True), ([(25, 0.49, 0.25)], 2, 5, True),
    ([(25, 0.5, 0.25)], 2, 5, False), ([(14, 5.0, 0.0), (25, 6.0, 0.0)], 2, 5, True), ([], 2, 5, False),
]  # fmt: skip


@pytest.mark.parametrize(("roots", "shape", "number", "named"), NAMES)
def test_a_number_is_that_of_another_hit_of_the_ray(roots, shape, number, named):
    """The second of two rays; the first has a root of that primitive, too, which is none of the second's."""
    rows = [(0, 25, 1.0), *((1, prim, t) for prim, t, _ in roots)]
    every = roots_of(*rows, t_error=[0.0, *(bound for _, _, bound in roots)])
    given = {
        "shape_id": None if shape is None else np.array([9, shape]),
        "prim_id": None if number is None else np.array([9, number]),
    }
    f = pixels([1.0, 1.0], [1.0, 1.0], 0.25, prim=[10, 10], roots=every, **given)
    f.judge.model = SimpleNamespace(packed=PACKED)
    assert diagnosis._names_another_hit(f).tolist() == [False, named]


# ---- what float64 does not allow


def test_what_is_beyond_float64_at_a_right_surface_is_named_by_its_check(monkeypatch):
    monkeypatch.setattr(
        diagnosis, "explain_normals", lambda f, n: [Explained("n", "mend", bools(3, 0, 2))] if len(f.rows) else []
    )
    own = intersections([1.0] * 5)
    judge = SimpleNamespace(
        names_prims=True, bounds=SimpleNamespace(own=own), prim=np.arange(5), n=np.zeros((5, 3)),
        answer=SimpleNamespace(t=np.arange(5.0)),
        self_checks=[SimpleNamespace(name="uv", fails=bools(5, 1, 3)),
                     SimpleNamespace(name="position", fails=bools(5, 0))],
    )  # fmt: skip
    judgement = judgement_of(["wrong"] * 5, ratios={"diffuse": np.array([9.0, 1.0, NAN, 1.5, 0.0])})
    rows = np.array([1, 3, 4])
    found = [(each.what, each.remedy, at.tolist()) for each, at in diagnosis._wrong_surface(judge, judgement, rows)]
    beyond = "beyond what float64 rounding allows at the primitive that is hit, in"
    expected = [
        ("n", "mend", [1, 4]),
        (f"{beyond} uv", "", [1, 3]),
        (f"{beyond} position", "", []),
        (f"{beyond} diffuse", "", [3]),
    ]
    assert found == expected
    judge.n = None
    assert len(list(diagnosis._wrong_surface(judge, judgement_of(["wrong"] * 5), rows))) == 2
    assert not list(diagnosis._wrong_surface(judge, judgement, rows[:0]))
    judge.names_prims = False
    assert not list(diagnosis._wrong_surface(judge, judgement, rows))


# ---- outlines

TRIANGLE = ((10.0, 20.0, 0.0), (14.0, 20.0, 0.0), (10.0, 23.0, 0.0))


def outline(points, bound=1.0, exact=None, hits_only=False, d=Z) -> str:
    """Hits at t = 5 on these points of a triangle's plane, and of others far away."""
    many = caster.Icosphere(name="far", subdivisions=1, to_world=[{"translate": [100, 20, 50]}])
    shapes = [many, caster.Triangle(name="near", vertices=TRIANGLE)]
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=shapes)
    count = len(points)
    o = np.array(points, float) + TRIANGLE[0] - 5.0 * np.array(d)
    given = [5.0] * count
    f = pixels([INF] * count if exact is None else exact, given, bound, o=o, d=[d] * count, hits_only=hits_only)
    numbers = packed(scene)
    corners = hypotheses.triangle_corners(
        SimpleNamespace(model=SimpleNamespace(packed=numbers)), np.arange(numbers.first[-1])
    )
    f.judge.model = SimpleNamespace(packed=numbers, boxes=(corners.min(axis=1), corners.max(axis=1)))
    f.judge.scene = scene
    return diagnosis._outline_text(f)


def test_hits_beyond_an_outline_are_described_with_their_distance():
    said = ", beyond the outline of a triangle, on its plane, by {} (first: near, prim 0)"
    assert outline([(2.0, -0.5, 0.0), (-0.25, 1.0, 0.0)]) == said.format("0.25 to 0.5")
    assert outline([(2.0, -0.5, 0.0)], hits_only=True) == ""
    assert outline([(1.0, 1.0, 0.0)]) == ""  # inside
    nine, inside = [(2.0, -0.5, 0.0)] * 9, (1.0, 1.0, 0.0)
    assert outline([*nine, inside]) == said.format("0.5") and outline([*nine, inside, inside]) == ""
    # on the plane: within a thousandth of an edge, and twice the bound of t
    assert outline([(2.0, -0.5, 0.0039)]) != "" and outline([(2.0, -0.5, 0.0041)]) == ""
    near = {"exact": [5.0], "d": (0.0, 0.0, 2.0)}
    assert outline([(2.0, -0.5, 0.0039)], 0.001, **near) != "" and outline([(2.0, -0.5, 0.0039)], 0.0009, **near) == ""


# ---- separators


def split(values, wrong, tried=1):
    return best_split(np.array(values, float), np.array(wrong, bool), tried)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_threshold_lies_between_wrong_and_right_values(sign):
    wrong = np.arange(80) < 20
    values = sign * np.where(wrong, 1.0, 3.0)
    word = "below" if sign > 0 else "above"
    assert split(values, wrong) == diagnosis.Split(f"{word} {2 * sign:g}", 20, 0)
    mixed = values.copy()
    mixed[0], mixed[20:23] = sign * 3.0, sign  # one of 20 wrong, three of 60 right
    assert split(mixed, wrong) == diagnosis.Split(f"{word} {2 * sign:g}", 19, 3)
    mixed[1] = sign * 3.0
    assert split(mixed, wrong) is None
    mixed[1], mixed[23] = sign, sign
    assert split(mixed, wrong) is None
    some = values.copy()
    some[0] = NAN
    assert split(some, wrong) == diagnosis.Split(f"{word} {2 * sign:g}", 19, 0)
    some[1] = INF
    assert split(some, wrong) is None
    assert split(np.ones(80), wrong) is None


def test_a_threshold_is_no_chance_of_many_tries():
    """8 wrong ones of 24: (1/3)^8 = 1.5e-4, times 2 sides; of 48, (1/6)^8 = 6e-7, and of 96 (1/12)^8 = 2.3e-9."""
    for count, tried, found in ((24, 1, False), (48, 0.8, True), (48, 0.9, False), (96, 200, True), (96, 240, False)):
        wrong = np.arange(count) < 8
        assert (split(np.where(wrong, 1.0, 3.0), wrong, tried) is not None) is found
    wrong = np.arange(96) < 8  # as many thresholds as different values
    values = np.where(wrong, 1.0, np.arange(96.0) + 3.0)
    assert split(values, wrong, 2) is not None and split(values, wrong, 3) is None


def test_a_property_that_all_wrong_pixels_have_and_few_others():
    wrong = np.arange(200) < 20
    flags = wrong | (np.arange(200) >= 182)
    assert necessary_share(flags, wrong, 10) == 0.1
    flags[3] = False
    assert necessary_share(flags, wrong, 10) is None
    assert necessary_share(np.arange(200) < 182, wrong, 1) is None  # nearly all have it, or chance would do
    many = np.arange(20000)
    for having, share in ((18020, 0.802), (19000, 0.9), (19010, None)):
        assert necessary_share(many < having, many < 10000, 1) == share


@pytest.mark.parametrize(
    ("name", "negated"),
    [
        ("a component of d is 0", "no component of d is 0"), ("the box has no thickness", "the box has some thickness"),
        ("a sphere is hit", "a sphere is not hit"),
        ("the surface is seen from behind", "the surface is not seen from behind"),
    ],
)  # fmt: skip
def test_a_property_is_negated(name, negated):
    assert diagnosis._negation(name) == negated


def separated(monkeypatch, features, count=120, wrong=20, **change) -> str:
    """The first `wrong` pixels of an image fail; features as they would be computed."""
    classes = ["wrong"] * wrong + ["agree"] * (count - wrong)
    judgement = judgement_of(classes)
    plain = {"prims": np.zeros(count, int), "hit": np.ones(count, bool), "answers": None} | change
    exact = Adjudication(np.zeros(0, int), [], np.zeros(0))
    if plain["answers"] is not None:
        rows = np.array(sorted(plain["answers"]))
        exact = Adjudication(rows, [plain["answers"][row] for row in rows.tolist()], np.zeros(len(rows)))
    judgement = Judgement(judgement.classes, {}, {}, exact, {}, 0.0)
    judge = SimpleNamespace(result=SimpleNamespace(hit=plain["hit"]), reference_prim=plain["prims"])
    seen = {}

    def computed(judge, rows, prim):
        seen.update(rows=rows.tolist(), prim=prim.tolist())
        return [(name, np.asarray(values)[rows].astype(float)) for name, values in features]

    monkeypatch.setattr(diagnosis, "_features", computed)
    text = diagnosis.separator_text(judge, judgement, np.arange(wrong))
    return text, seen


FIRST = np.arange(120) < 20


def test_a_separator_states_its_threshold_and_its_shares(monkeypatch):
    def text(*features, **more):
        return separated(monkeypatch, features, **more)[0]

    size = ("the size is {}", np.where(FIRST, 1.0, 3.0))
    flag = ("a sphere is hit", FIRST)
    shares = "20 of 20 wrong pixels, 0 of 100 right ones"
    assert text(size) == f"where the size is below 2: {shares}"
    assert text(flag, size) == f"where a sphere is hit: {shares}"
    assert text(size, flag) == f"where the size is below 2: {shares}"
    lacking = ("a disk is hit", ~FIRST)
    assert text(lacking) == text(lacking, size) == f"where a disk is not hit: {shares}"
    assert text(lacking, flag) == f"where a sphere is hit: {shares}"  # rather of a property of wrong ones
    assert text(lacking, ("a cube is hit", ~FIRST)) == f"where a disk is not hit: {shares}"
    assert text(("the size is {}", np.zeros(120))) == "" == text()
    part = ("a torus is hit", np.arange(400) < 145)
    only = "only where a torus is hit: all 60 wrong pixels, 25 % of the right ones"
    assert text(part, count=400, wrong=60) == text(("x is {}", np.zeros(400)), part, count=400, wrong=60) == only
    assert text(("the size is {}", part[1]), count=400, wrong=60) == ""


def test_a_separator_needs_eight_pixels_on_either_side_that_hit(monkeypatch):
    size = ("the size is {}", np.where(np.arange(120) < 60, 1.0, 3.0))
    wide = [("the size is {}", np.arange(400) >= 8)]
    assert separated(monkeypatch, wide, 400, 8)[0].startswith("where the size is below 0.5: 8 of 8")
    assert separated(monkeypatch, wide, 400, 7)[0] == "" and separated(monkeypatch, [size], 120, 112)[1] != {}
    assert separated(monkeypatch, [size], 120, 113)[1] == {}
    hit = np.arange(120) >= 12
    text, seen = separated(monkeypatch, [size], hit=hit)
    assert seen["rows"] == list(range(12, 120)) and text == ""
    assert separated(monkeypatch, [size], hit=np.arange(120) >= 13)[1] == {}
    # exact answers count in place of the reference's
    answers = {12: SimpleNamespace(prim=7), 13: None, 30: SimpleNamespace(prim=-1), 2: SimpleNamespace(prim=3)}
    _, seen = separated(monkeypatch, [size], hit=np.arange(120) >= 11, answers=answers, prims=np.full(120, 5))
    place = dict(zip(seen["rows"], seen["prim"], strict=True))
    assert (
        place[12] == 7 and place[2] == 3 and 13 not in place and 30 not in place and 1 not in place and place[40] == 5
    )
    assert all(row < 20 for row in seen["rows"][:9]) and sorted(seen["rows"][9:]) == seen["rows"][9:]


def test_features_of_rays_and_primitives():
    """A triangle, a sphere and a slanted triangle; every quantity a second time, by hand."""
    slanted = ((10.0, 20.0, 0.0), (14.0, 20.0, 0.0), (10.0, 23.0, 1.0))
    shapes = [
        caster.Triangle(name="flat", vertices=TRIANGLE), caster.Sphere(name="ball", radius=2.0),
        caster.Triangle(name="slanted", vertices=slanted), caster.Cube(name="box"),
    ]  # fmt: skip
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=3, height=2), camera=camera, shapes=shapes)
    numbers = packed(scene)
    corners = hypotheses.triangle_corners(
        SimpleNamespace(model=SimpleNamespace(packed=numbers)), np.arange(numbers.first[-1])
    )
    corners[1] = [[-2.0] * 3, [2.0] * 3, [0.0] * 3]
    o, d = np.array([[11.0, 21.0, 5.0]] * 6), np.array([[0.0, 0.0, -2.0]] * 6)
    d[4] = [0.125, 0.25, -2.0]
    rows = np.array([1, 3, 4, 5, 0])
    prim = np.array([0, 1, 2, 0, 5])
    n = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, -0.6, 0.8], [0, 0, 1.0], [0, 1.0, 0]])
    at = intersections([2.0, 1.5, 2.5, 2.0, 3.0], n=n)._replace(p_error=np.full(5, 0.25))
    boxes = corners.min(axis=1), corners.max(axis=1)
    judge = SimpleNamespace(
        model=SimpleNamespace(packed=numbers, boxes=boxes),
        scene=scene, o=o, d=d,
        near=lambda r, p, t: at if (r.tolist(), p.tolist()) == (rows.tolist(), prim.tolist()) else None,
        result=SimpleNamespace(t=np.zeros(6, np.float32)),
        pair=SimpleNamespace(shape=(2, 3), rays=SimpleNamespace(is_list=False)),
    )  # fmt: skip
    found = dict(diagnosis._features(judge, rows, prim))
    p = o[rows] + at.t[:, None] * d[rows]
    edges = np.array(
        [
            np.cross(c[1] - c[0], c[2] - c[0])
            for c in np.array([TRIANGLE, np.full((3, 3), NAN), slanted, TRIANGLE, corners[5]])
        ]
    )
    extents = [[4, 3, 0], [4, 4, 4], [4, 3, 1], [4, 3, 0], np.ptp(corners[5], axis=0)]

    def distance(point, triangle):
        steps = np.linspace(0, 1, 200001)[:, None]
        return min(
            np.linalg.norm(a + steps * (b - a) - point, axis=1).min()
            for a, b in zip(triangle, np.roll(triangle, -1, 0), strict=True)
        )

    triangles = {0: np.array(TRIANGLE), 2: np.array(slanted), 5: corners[5]}
    outline = [NAN if prim[i] == 1 else distance(p[i], triangles[prim[i]]) for i in range(5)]
    corner = [NAN if prim[i] == 1 else np.linalg.norm(triangles[prim[i]] - p[i], axis=1).min() for i in range(5)]
    u = d[rows] / np.linalg.norm(d[rows], axis=1)[:, None]
    cosines = (n * u).sum(1)
    expected = {
        "one of the spheres is hit": [0, 1, 0, 0, 0], "one of the triangles is hit": [1, 0, 1, 1, 1],
        "flat is hit": [1, 0, 0, 1, 0],
        "ball is hit": [0, 1, 0, 0, 0], "slanted is hit": [0, 0, 1, 0, 0], "box is hit": [0, 0, 0, 0, 1],
        "the box of the shape has no thickness": [1, 0, 0, 1, 0],
        "the box of the primitive has no thickness": [1, 0, 0, 1, 1],
        "a component of d is 0": [1, 1, 0, 1, 1], "the surface is seen from behind": [0, 1, 0, 0, 0],
        "the determinant |d . (e1 x e2)| is {}": np.abs((d[rows] * edges).sum(1)), "t is {}": at.t,
        "the cosine of ray and normal is {}": np.abs(cosines),
        "twice the area of the triangle is {}": np.linalg.norm(edges, axis=1),
        "the size of the primitive is {}": np.linalg.norm(extents, axis=1),
        "the smallest extent of the primitive's box is {}": np.min(extents, axis=1),
        "the distance to the triangle's outline is {}": outline,
        "the distance to the triangle's outline is {} bounds of the position": np.array(outline) / 0.25,
        "the distance to the triangle's nearest corner is {}": corner,
        "the number of the primitive in its shape is {}": [0, 0, 0, 0, 2], "|d| is {}": np.linalg.norm(d[rows], axis=1),
        "|o| is {}": np.sqrt([11.0**2 + 21.0**2 + 25.0] * 5), "the pixel's x is {}": [1, 0, 1, 2, 0],
        "the pixel's y is {}": [0, 1, 1, 1, 0],
    }  # fmt: skip
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert np.asarray(found[name]) == pytest.approx(np.asarray(values, float), rel=1e-5, nan_ok=True), name
    judge.pair.rays.is_list = True
    assert list(dict(diagnosis._features(judge, rows, prim))) == list(expected)[:-2]


def test_a_cause_without_pixels_is_none():
    assert diagnosis.Diagnosis((Cause("a", np.zeros(0, int)),)).by_row() == {}
