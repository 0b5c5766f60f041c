"""The diagnosis of planted errors: every failing row has a cause, and what separates wrong pixels is found.

Each row of the table of mistakes is named by its own sentence, and not where right pixels contradict it.
"""

from dataclasses import replace

import numpy as np
import pytest
from candidates import ours
from mitsuba_scenes import scene_judge

import caster
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.judge.classification import CLASS_CODE, Judge
from mitsuba_ref.judge.comparison import pair_images
from mitsuba_ref.judge.diagnosis import diagnose, failing_rows, sentence_by_row, separators
from mitsuba_ref.judge.hypotheses import WrongPixels, explanations, mistakes, normal_mistakes
from mitsuba_ref.reference.shared_input import pixel_centers
from mitsuba_ref.subjects.function import FunctionSubject
from mitsuba_ref.subjects.subject import Answer

WIDTH, HEIGHT = 24, 16
TURN = {"rotate": {"axis": [1, 2, 3], "degrees": 37}}
CAMERA = caster.Pinhole(eye=(0.3, 0.2, 2.5), look_at=(0, 0, 0), fov=60)
SHAPES = (
    caster.Sphere(name="room", center=(0.7, -0.4, 1.1), radius=4.0),
    caster.Sphere(name="ball", center=(-0.7, 0.3, 0.2), radius=0.5),
    caster.Torus(name="ring", to_world=[{"scale": 0.6}, TURN, {"translate": [0.5, -0.4, 0]}], segments=9, sides=5),
    caster.Rectangle(name="wall", to_world=[{"scale": 0.6}, {"translate": [0.5, 0.6, -0.5]}]),
)


@pytest.fixture(scope="module")
def right(send) -> Judge:
    scene = Scene(film=caster.Film(width=WIDTH, height=HEIGHT), camera=CAMERA, shapes=SHAPES)
    return scene_judge(scene, FunctionSubject("right", ours, "float64"), send=send)


@pytest.fixture(scope="module")
def agreed(right):
    found = right.judge()
    assert not len(failing_rows(found))
    return found


def answering(judge: Judge, **change) -> Judge:
    answer: Answer = replace(judge.answer, **change)
    return Judge(judge.scene, judge.model, pair_images(judge.scene, judge.rays, answer, judge.result), judge.view)


def causes_of(judge: Judge):
    judgement = judge.judge()
    found = diagnose(judge, judgement)
    assert sorted(sentence_by_row(found)) == failing_rows(judgement).tolist()
    assert all(np.array_equal(cause.rows, np.unique(cause.rows)) for cause in found)
    return found


def shape_of(judge: Judge) -> np.ndarray:
    return judge.result.shape_id


# ---- what is off, without a hypothesis


def uneven(count: int) -> np.ndarray:
    return np.random.default_rng(11).uniform(0.002, 0.02, count)


def some_hits(judge: Judge, share: int = 3) -> np.ndarray:
    chosen = np.random.default_rng(12).integers(share, size=WIDTH * HEIGHT) == 0
    return np.flatnonzero(judge.result.hit & chosen & judge.at.certain)


@pytest.mark.parametrize(("sign", "word"), [(1.0, "behind"), (-1.0, "before")])
def test_t_that_is_off_by_no_rule_is_described_by_its_range(right, sign, word):
    rows = some_hits(right)
    t = right.answer.t.copy()
    share = uneven(len(rows))
    t[rows] *= 1.0 + sign * share
    (cause,) = causes_of(answering(right, t=t))
    words = f"t is off: {word} what is hit, by {share.min():.2g} to {share.max():.2g} of itself"
    assert cause.what == words and cause.rows.tolist() == rows.tolist() and not cause.remedy


def test_misses_in_place_of_hits_are_a_cause_of_their_own_and_both_ways_of_t_one(right):
    rows = some_hits(right)
    t, n = right.answer.t.copy(), right.answer.n.copy()
    missed, before, behind = rows[::3], rows[1::3], rows[2::3]
    t[missed], n[missed] = np.inf, 0.0
    t[before] *= 1.0 - uneven(len(before))
    t[behind] *= 1.0 + uneven(len(behind))
    found = {cause.what.split(" what")[0]: cause.rows.tolist() for cause in causes_of(answering(right, t=t, n=n))}
    assert found == {
        "missed; exact arithmetic hits": missed.tolist(),
        "t is off: before or behind": sorted([*before, *behind]),
    }


def test_answers_that_are_none_are_their_own_cause(right):
    rows = some_hits(right)
    one, two = np.zeros((2, WIDTH * HEIGHT), bool)
    one[rows[:9]], two[rows[7:20]] = True, True
    found = causes_of(answering(right, broken={"t is this": one, "n is that": two}))
    assert [(cause.what, cause.rows.tolist()) for cause in found] == [
        ("no answer: t is this", rows[:9].tolist()),
        ("no answer: n is that", rows[9:20].tolist()),
    ]


# ---- numbers of what is hit


def numbers(judge: Judge) -> dict[str, np.ndarray]:
    prim, packed = judge.reference_prim, judge.model.packed
    hit = prim >= 0
    at = np.maximum(prim, 0)
    return {"shape_id": np.where(hit, packed.shape_of(at), -1), "prim_id": np.where(hit, packed.index_in_shape(at), -1)}


@pytest.mark.parametrize(("step", "remedy"), [(1, "subtract 1"), (-1, "add 1")])
@pytest.mark.parametrize(("column", "name"), [("shape_id", "shape"), ("prim_id", "primitive")])
def test_numbers_that_are_off_by_one_are_named(right, column, name, step, remedy):
    ids = numbers(right)
    ids[column] = ids[column] + step
    (cause, *rest) = causes_of(answering(right, **ids))
    assert cause.what == f"the {name}'s number is off by one ({step:+d})" and cause.of == WIDTH * HEIGHT
    assert cause.remedy == f"numbers count from 0: {remedy}" and not rest and len(cause.rows) == cause.of


# ---- what separates wrong pixels from right ones


def where(judge: Judge, judgement, rows: np.ndarray) -> str:
    classes = judgement.classes.copy()
    classes[rows] = CLASS_CODE["wrong"]
    return next(separators(judge, replace(judgement, classes=classes), rows), "")


FEATURES = {
    "t is": lambda judge: judge.answer.t,
    "the cosine of ray and normal is": lambda judge: np.abs((judge.own.n * judge.d).sum(1)),
    "the pixel's x is": lambda judge: np.arange(WIDTH * HEIGHT) % WIDTH,
    "the pixel's y is": lambda judge: np.arange(WIDTH * HEIGHT) // WIDTH,
}


@pytest.mark.parametrize("side", ["below", "above"])
@pytest.mark.parametrize("feature", FEATURES)
def test_a_threshold_of_one_quantity_is_found(right, agreed, feature, side):
    values = FEATURES[feature](right)
    low, middle, high = np.quantile(values, [0.0, 0.3 if side == "below" else 0.7, 1.0])
    wrong = values < middle if side == "below" else values > middle
    text = where(right, agreed, np.flatnonzero(wrong))
    m, rest = int(wrong.sum()), int((~wrong).sum())
    head, words = f"where {feature} {side} ", f": {m} of {m} wrong pixels, 0 of {rest} right ones"
    assert text.startswith(head) and text.endswith(words), text
    threshold = float(text.removeprefix(head).removesuffix(words))
    found = values < threshold if side == "below" else values > threshold
    assert low < threshold <= high and (found == wrong).mean() > 0.99


PROPERTIES = {
    "what is hit is one of the spheres": lambda judge: shape_of(judge) < 2,
    "what is hit is one of the triangles": lambda judge: shape_of(judge) >= 2,
    "ring is hit": lambda judge: shape_of(judge) == 2,
    "ball is hit": lambda judge: shape_of(judge) == 1,
    "room is not hit": lambda judge: shape_of(judge) != 0,
    "ball is not hit": lambda judge: shape_of(judge) != 1,
    "the surface is not seen from behind": lambda judge: (judge.own.n * judge.d).sum(1) < 0.0,
}


@pytest.mark.parametrize("what", PROPERTIES)
def test_a_property_of_wrong_pixels_is_found(right, agreed, what):
    flags = PROPERTIES[what](right)
    text = where(right, agreed, np.flatnonzero(flags))
    m = int(flags.sum())
    alike = {"the surface is not seen from behind": "room is not hit"}  # the only one seen from behind
    assert text == f"where {alike.get(what, what)}: {m} of {m} wrong pixels, 0 of {len(flags) - m} right ones"


def test_a_property_of_all_wrong_pixels_and_few_others_is_found(right, agreed):
    rows = np.flatnonzero(shape_of(right) == 1)[::2]
    others = np.flatnonzero(shape_of(right) == 1)[1::2]
    share = 100.0 * len(others) / (WIDTH * HEIGHT - len(rows))
    text = f"only where ball is hit: all {len(rows)} wrong pixels, {share:.2g} % of the right ones"
    assert where(right, agreed, rows) == text


def test_what_is_hit_at_random_has_no_threshold(right, agreed):
    rows = some_hits(right)
    assert where(right, agreed, rows) == ""


def test_a_threshold_needs_eight_wrong_pixels(right, agreed):
    nearest = np.argsort(right.answer.t, kind="stable")
    assert where(right, agreed, nearest[:8]).startswith("where t is below ")
    assert where(right, agreed, nearest[:7]) == ""


# ---- the table of mistakes


def pixels(judge: Judge, rows: np.ndarray) -> WrongPixels:
    prim = judge.reference_prim[rows].astype(np.int64)
    at = judge.near(rows, prim, judge.result.t[rows])
    return WrongPixels(judge, rows, prim, np.where(prim >= 0, at.t, np.inf), at)


def explained(judge: Judge) -> tuple[int, dict[str, int]]:
    """(wrong pixels, sentence -> how many of them become right)."""
    every = pixels(judge, np.arange(WIDTH * HEIGHT))
    wrong, right = every.take(every.off), every.take(~every.off)
    found = explanations(wrong, right, mistakes(wrong))
    return len(wrong.rows), {mistake.what: int(fits.sum()) for mistake, fits in found}


def image(t: np.ndarray) -> np.ndarray:
    return t.reshape(HEIGHT, WIDTH)


def cast_along(lines, factor=1.0):
    """change(judge, t): t along other rays."""
    return lambda judge, t: factor * caster.cast(judge.scene, *lines(judge.o, judge.d)).t


def beside(x: float, y: float):
    """change(judge, t): t through another place of the pixels."""

    def change(judge, t):
        at = (centers + step for centers, step in zip(pixel_centers(judge.scene), (x, y), strict=True))
        rays = reference_of_camera(CAMERA).rays(CAMERA, judge.scene.film, *at)
        return caster.cast(judge.scene, rays.o, rays.d).t

    return change


# What is said, unless right pixels contradict it -> what a caster does to t, beside the mistakes of mistakes.py.
WHOLE = {
    "t is -2 times what it should be": lambda judge, t: -2.0 * t,
    "t is 1.005 times what it should be": lambda judge, t: 1.005 * t,
    "t is (1 + 2e-06) times what it should be": lambda judge, t: (1.0 + 2e-6) * t,
    "t is 2e-06 too large everywhere, a constant": lambda judge, t: t + 2e-6,
    "t is 0, whatever is hit": lambda judge, t: 0.0 * t,
    **{
        f"the image is moved by a whole pixel: {x:+d} to the right, {y:+d} down": (
            lambda judge, t, x=x, y=y: np.roll(image(t), (y, x), (0, 1))
        )
        for x, y in ((1, 0), (-1, 1))
    },
    "rays beside the pixel centres, by (+0.00, -0.50) of a pixel to the right and down": beside(0.0, -0.5),
    "the axes of directions are exchanged: (z, x, y) in place of (x, y, z)": cast_along(
        lambda o, d: (o, d[:, [2, 0, 1]])
    ),
    "the axes of rays are exchanged: (z, y, x) in place of (x, y, z)": cast_along(
        lambda o, d: (o[:, [2, 1, 0]], d[:, [2, 1, 0]])
    ),
    **{
        f"the scene is {s:g} times as large as it should be": cast_along(lambda o, d, s=s: (o / s, d), s)
        for s in (0.1, 0.5, 1000.0)
    },
}


@pytest.mark.parametrize("what", WHOLE)
def test_a_mistake_is_named_by_its_own_sentence_unless_right_pixels_contradict_it(right, what):
    t = np.ascontiguousarray(WHOLE[what](right, right.answer.t)).ravel()
    count, found = explained(answering(right, t=t))
    assert count > 30 and found.get(what, 0) >= 0.95 * count, (found, count)
    assert next(iter(found)) == what
    half = np.arange(len(t)) % 16 < 8
    assert what not in explained(answering(right, t=np.where(half, t, right.answer.t)))[1]


def test_a_mistake_of_few_normals_is_not_named_by_chance(right):
    n, other = right.answer.n[:, [1, 2, 0]], np.random.default_rng(9).normal(size=right.answer.n.shape)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    for share, named in ((3, False), (1, True)):
        some = (np.arange(len(n)) % share == 0)[:, None]
        f = pixels(answering(right, n=np.where(some, n, other)), np.flatnonzero(right.result.hit))
        found = [mistake.what for mistake, _ in explanations(f, f.take(np.zeros(0, int)), normal_mistakes(f))]
        assert any("(y, z, x) in place of (x, y, z)" in what for what in found) is named
