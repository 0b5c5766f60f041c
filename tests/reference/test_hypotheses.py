"""The table of mistakes: each row is named by its own sentence, and not where right pixels contradict it."""

from dataclasses import replace

import numpy as np
import pytest
from mitsuba_scenes import scene_judge

import caster
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.judge.comparison import pair_images
from mitsuba_ref.judge.hypotheses import WrongPixels, explanations, mistakes, normal_mistakes
from mitsuba_ref.reference.shared_input import pixel_centers
from mitsuba_ref.subjects.function import FunctionSubject

WIDTH, HEIGHT = 16, 12
TURN = {"rotate": {"axis": [1, 2, 3], "degrees": 37}}
CAMERA = caster.Pinhole(eye=(0.3, 0.2, 1.5), look_at=(0, 0, 0), fov=70)
MIXED = (
    caster.Sphere(name="room", center=(0.7, -0.4, 1.1), radius=4.0),
    caster.Sphere(name="ball", center=(-0.5, 0.3, 0.2), radius=0.5),
    caster.Torus(name="ring", to_world=[{"scale": 0.4}, TURN, {"translate": [0.5, -0.4, 0]}], segments=9, sides=5),
    caster.Rectangle(name="wall", to_world=[{"scale": 0.7}, TURN, {"translate": [0.7, 0.6, -1]}]),
)


def cast(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t.copy(), hits.normal.copy()


@pytest.fixture(scope="module")
def brought_candidate(send):
    """The judge of a right candidate, one for each scene."""
    known: dict[tuple, Judge] = {}

    def bring(shapes=MIXED) -> Judge:
        if shapes not in known:
            scene = Scene(film=caster.Film(width=WIDTH, height=HEIGHT), camera=CAMERA, shapes=shapes)
            known[shapes] = scene_judge(scene, FunctionSubject("right", cast, "float64"), send=send)
        return known[shapes]

    return bring


def answering(judge: Judge, t=None, n=None) -> Judge:
    """The same judge with another answer."""
    given = judge.answer
    answer = replace(given, t=given.t if t is None else t, n=given.n if n is None else n)
    return Judge(judge.scene, judge.model, pair_images(judge.scene, judge.pair.rays, answer, judge.result), judge.view)


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
def test_a_mistake_is_named_by_its_own_sentence_unless_right_pixels_contradict_it(brought_candidate, what):
    judge = brought_candidate()
    t = np.ascontiguousarray(WHOLE[what](judge, judge.answer.t)).ravel()
    count, found = explained(answering(judge, t))
    assert count > 30 and found.get(what, 0) >= 0.95 * count, (found, count)
    assert next(iter(found)) == what
    half = np.arange(len(t)) % 16 < 8
    assert what not in explained(answering(judge, np.where(half, t, judge.answer.t)))[1]


def test_a_mistake_of_few_normals_is_not_named_by_chance(brought_candidate):
    judge = brought_candidate()
    n, other = judge.answer.n[:, [1, 2, 0]], np.random.default_rng(9).normal(size=judge.answer.n.shape)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    for share, named in ((3, False), (1, True)):
        some = (np.arange(len(n)) % share == 0)[:, None]
        f = pixels(answering(judge, n=np.where(some, n, other)), np.flatnonzero(judge.result.hit))
        found = [mistake.what for mistake, _ in explanations(f, f.take(np.zeros(0, int)), normal_mistakes(f))]
        assert any("(y, z, x) in place of (x, y, z)" in what for what in found) is named
