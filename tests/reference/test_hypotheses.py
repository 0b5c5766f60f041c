"""Hypotheses about wrong pixels: each mistake is named by its own sentence, and not where right pixels contradict.

The mistakes are computed here a second time, from the answers of a right caster or from roots of spheres by hand.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import caster
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.judge.classification import Judge, scene_judge
from mitsuba_ref.judge.comparison import pair_images
from mitsuba_ref.judge.hypotheses import (
    DESCRIPTIONS,
    HYPOTHESES,
    OTHER_RAYS,
    WrongPixels,
    _image_orders,
    _rotation,
    explain_normals,
    float32_inside,
    out_of_range,
    range_text,
)
from mitsuba_ref.reference.shared_input import packed_float32, pixel_centers
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
BALLS = (
    caster.Sphere(name="room", center=(0.7, -0.4, 1.1), radius=4.0),
    caster.Sphere(name="a", center=(-0.5, 0.3, 0), radius=0.6),
    caster.Sphere(name="b", center=(0.5, -0.2, -0.6), radius=0.9),
    caster.Sphere(name="c", center=(-0.2, 0.1, -1.2), radius=0.8),
)
OPEN = BALLS[1:]


def cast(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t.copy(), hits.normal.copy()


@pytest.fixture(scope="module")
def brought_candidate(send):
    """A right candidate before the judge, once a scene."""
    known: dict[tuple, Judge] = {}

    def bring(shapes=MIXED, precision="float64") -> Judge:
        if (shapes, precision) not in known:
            scene = Scene(film=caster.Film(width=WIDTH, height=HEIGHT), camera=CAMERA, shapes=shapes)
            subject = FunctionSubject("right", cast, precision)
            known[shapes, precision] = scene_judge(scene, subject, send=send)
        return known[shapes, precision]

    return bring


def answering(judge: Judge, t=None, n=None) -> Judge:
    """The same, of another answer."""
    given = judge.answer
    answer = replace(given, t=given.t if t is None else t, n=given.n if n is None else n)
    return Judge(judge.scene, judge.model, pair_images(judge.scene, judge.pair.rays, answer, judge.result), judge.view)


def pixels(judge: Judge, rows: np.ndarray) -> WrongPixels:
    prim = judge.reference_prim[rows].astype(np.int64)
    at = judge.near(rows, prim, judge.result.t[rows])
    return WrongPixels(judge, rows, prim >= 0, np.where(prim >= 0, at.t, np.inf), prim, at)


def explained(judge: Judge, hypotheses=HYPOTHESES) -> tuple[int, dict[str, tuple[int, str]]]:
    """(wrong pixels, sentence -> (how many of them become right, remedy))."""
    every = pixels(judge, np.arange(WIDTH * HEIGHT))
    wrong, right = every.take(every.off), every.take(~every.off)
    found = {}
    for hypothesis in hypotheses:
        for each in hypothesis(wrong, right):
            if each.fits.any():
                assert len(each.fits) == len(wrong.rows)
                found[each.what] = (int(each.fits.sum()), each.remedy)
    return len(wrong.rows), found


def assert_named(judge: Judge, what: str, remedy: str = "", share: float = 1.0) -> None:
    """The sentence explains all that is wrong, and no other sentence half of it."""
    count, found = explained(judge)
    assert count > 30 and what in found, found
    assert found[what][0] >= share * count and remedy in found[what][1], (found, count)
    assert {each for each, (fits, _) in found.items() if fits > count / 2} == {what}, (found, count)


def view_cosines(judge: Judge) -> np.ndarray:
    view = -np.array([0.3, 0.2, 1.5]) / np.linalg.norm([0.3, 0.2, 1.5])
    return judge.d @ view / np.linalg.norm(judge.d, axis=1)


def image(t: np.ndarray) -> np.ndarray:
    return t.reshape(HEIGHT, WIDTH)


T_MISTAKES = {
    "depth along z, the view axis, in place of t along the ray": (
        lambda judge, t: t * view_cosines(judge),
        "divide by the cosine of the ray with the view axis",
    ),
    "t is 0.25 too large everywhere, a constant": (lambda judge, t: t + 0.25, "(an epsilon?) of 0.25"),
    "t is 0.001 too small everywhere, a constant": (lambda judge, t: t - 0.001, "(an epsilon?) of -0.001"),
    "t is 100 times what it should be": (lambda judge, t: 100.0 * t, "look for a wrong unit"),
    "t is 1.0005 times what it should be": (lambda judge, t: 1.0005 * t, "look for a wrong unit"),
    "t is -2 times what it should be": (lambda judge, t: -2.0 * t, "look for a wrong unit"),
    "the square of t in place of t": (lambda judge, t: t * t, "return t itself"),
    "1 / t in place of t": (lambda judge, t: 1.0 / t, "return t itself"),
    "the logarithm of t in place of t": (lambda judge, t: np.log(t), "return t itself"),
    "computed in float32: right by float32's bounds, and given as float64": (
        lambda judge, t: t.astype(np.float32).astype(np.float64),
        "compute in float64, or state --candidate-precision float32",
    ),
    "the image is mirrored, left for right": (lambda judge, t: image(t)[:, ::-1], "turn the sign of x"),
    "the image is upside down": (lambda judge, t: image(t)[::-1], "row 0 is the top one: turn the sign of y"),
    "the image is turned by half a turn": (lambda judge, t: image(t)[::-1, ::-1], "the signs of x and y"),
    "the image is transposed, x for y": (lambda judge, t: t.reshape(WIDTH, HEIGHT).T, "index y * width + x"),
    **{
        f"the image is moved by a whole pixel: {x:+d} to the right, {y:+d} down": (
            lambda judge, t, x=x, y=y: np.roll(image(t), (y, x), (0, 1)),
            "look for an index that counts from 1",
        )
        for x in (-1, 0, 1)
        for y in (-1, 0, 1)
        if x or y
    },
    "the candidate misses everything": (lambda judge, t: np.full_like(t, np.inf), "do rays reach t = 4.7"),
}  # fmt: skip


@pytest.mark.parametrize("what", T_MISTAKES)
def test_a_mistake_of_all_t_is_named_by_its_own_sentence(brought_candidate, what):
    judge = brought_candidate()
    change, remedy = T_MISTAKES[what]
    t = np.ascontiguousarray(change(judge, judge.answer.t)).ravel()
    wrong = answering(judge, t)
    if what == "the candidate misses everything":
        count, found = explained(wrong)
        assert next(iter(found)) == what and found[what][0] == count == WIDTH * HEIGHT
        assert remedy in found[what][1] and "determinants of 0.014 to 1.9 here" in found[what][1]
        return
    assert_named(wrong, what, remedy, 0.97)


CONTRADICTED = [each for each in T_MISTAKES if "everywhere" in each or "image is" in each or "1.0005" in each]


@pytest.mark.parametrize("what", CONTRADICTED)
def test_what_is_true_of_all_pixels_is_not_said_where_half_are_right(brought_candidate, what):
    judge = brought_candidate()
    change, _ = T_MISTAKES[what]
    wrong = np.ascontiguousarray(change(judge, judge.answer.t)).ravel()
    half = np.arange(len(wrong)) % 16 < 8
    _, found = explained(answering(judge, np.where(half, wrong, judge.answer.t)))
    assert what not in found, found


def test_a_distance_is_not_taken_for_t_where_d_is_no_unit_vector(brought_candidate):
    judge = answering(brought_candidate(), brought_candidate().answer.t)
    distance = judge.answer.t * np.linalg.norm(judge.d, axis=1)
    every = pixels(judge, np.arange(WIDTH * HEIGHT))
    judge.d = 0.25 * judge.d
    every = replace(every, t=4.0 * every.t, at=every.at._replace(t=4.0 * every.at.t, t_error=4.0 * every.at.t_error))
    judge.answer.t[:] = distance
    found = {each.what: each for hypothesis in HYPOTHESES[:4] for each in hypothesis(every, every.take(~every.off))}
    best = found["distance in place of t, which counts in lengths of d"]
    assert best.fits.all() and best.single and "divide the distance by |d|" in best.remedy
    assert found["t is 0.25 times what it should be"].fits.all()  # as true, and said after it
    assert list(found).index(best.what) == 0


# ---- other rays: o, d and t by hand

SIGNS = {"x": (-1, 1, 1), "y": (1, -1, 1), "z": (1, 1, -1)}
RAY_MISTAKES = {
    "the directions are reversed: -d in place of d": (lambda o, d: (o, -d), 1.0),
    **{
        f"the {axis} axis of directions is turned round": (lambda o, d, s=sign: (o, d * s), 1.0)
        for axis, sign in SIGNS.items()
    },
    **{
        f"the {axis} axis is turned round, of another handedness": (lambda o, d, s=sign: (o * s, d * s), 1.0)
        for axis, sign in SIGNS.items()
    },
    **{
        f"the axes of directions are exchanged: ({', '.join(order)}) in place of (x, y, z)": (
            lambda o, d, p=order: (o, d[:, ["xyz".index(axis) for axis in p]]), 1.0,
        )
        for order in ("xzy", "yxz", "yzx", "zxy", "zyx")
    },
    **{
        f"the axes of rays are exchanged: ({', '.join(order)}) in place of (x, y, z)": (
            lambda o, d, p=order: tuple(v[:, ["xyz".index(axis) for axis in p]] for v in (o, d)), 1.0,
        )
        for order in ("xzy", "yxz", "yzx", "zxy", "zyx")
    },
    "the rays' origin is taken for (0, 0, 0)": (lambda o, d: (0.0 * o, d), 1.0),
    "origin and direction are exchanged": (lambda o, d: (d, o), 1.0),
    **{
        f"the scene is {scale} times as large as it should be": (
            lambda o, d, s=float(scale): (o / s, d), float(scale),
        )
        for scale in ("0.001", "0.01", "0.0254", "0.1", "0.5", "2", "10", "100", "1000")
    },
}  # fmt: skip


def test_every_other_ray_has_a_mistake_here():
    assert [ray.what for ray in OTHER_RAYS if ray.what not in RAY_MISTAKES] == []
    assert len(OTHER_RAYS) == len(RAY_MISTAKES)


@pytest.mark.parametrize("ray", OTHER_RAYS, ids=lambda ray: ray.what)
def test_other_rays_are_what_their_sentence_states(ray):
    o, d = np.random.default_rng(3).normal(size=(2, 5, 3))
    change, factor = RAY_MISTAKES[ray.what]
    assert all(map(np.array_equal, ray.lines(o, d), change(o, d))) and ray.t_factor == factor


TOO_SMALL = ("0.001", "0.01", "0.0254")  # scenes that are not hit at all


@pytest.mark.parametrize("what", [each for each in RAY_MISTAKES if not any(f" {s} " in each for s in TOO_SMALL)])
def test_t_along_other_rays_is_named_by_what_they_are(brought_candidate, what):
    judge = brought_candidate()
    change, factor = RAY_MISTAKES[what]
    o, d = change(judge.o, judge.d)
    t = factor * caster.cast(judge.scene, o, d).t
    count, found = explained(answering(judge, t))
    assert count > 60 and found.get(what, (0,))[0] >= 0.95 * count, (found, count)
    assert max(found, key=lambda each: found[each][0]) == what or found[what][0] == count
    half = np.arange(len(t)) % 16 < 8
    _, found = explained(answering(judge, np.where(half, t, judge.answer.t)))
    assert what not in found


@pytest.mark.parametrize("shift", [(0.5, 0.5), (-0.25, 0.1), (0.25, 0.75)])
def test_a_shift_by_parts_of_a_pixel_is_computed_from_t(brought_candidate, shift):
    judge = brought_candidate()
    x, y = pixel_centers(judge.scene)
    rays = reference_of_camera(CAMERA).rays(CAMERA, judge.scene.film, x + shift[0], y + shift[1])
    t = caster.cast(judge.scene, rays.o, rays.d).t
    where = f"({shift[0]:+.2f}, {shift[1]:+.2f}) of a pixel to the right and down"
    found = explained(answering(judge, t))[1]
    assert_named(answering(judge, t), f"rays beside the pixel centres, by {where}", "(x + 0.5, y + 0.5)", 0.97)
    assert found
    half = np.arange(len(t)) % 16 < 8
    _, found = explained(answering(judge, np.where(half, t, judge.answer.t)))
    assert not any("beside the pixel centres" in each for each in found)


# ---- another of the hits that there are, by the roots of spheres


def roots(judge: Judge) -> np.ndarray:
    """(shapes, 2, n) both t of each sphere, NaN where it is not met."""
    found = []
    for ball in judge.scene.shapes:
        away = judge.o - np.float32(ball.center).astype(float)
        a, b = (judge.d**2).sum(1), (away * judge.d).sum(1)
        c = (away**2).sum(1) - float(np.float32(ball.radius)) ** 2
        with np.errstate(invalid="ignore"):
            half = np.sqrt(b * b - a * c)
        found.append([(-b - half) / a, (-b + half) / a])
    return np.array(found)


def nearest(t: np.ndarray) -> np.ndarray:
    """The smallest t ahead of each ray, inf where there is none."""
    t = t.reshape(-1, t.shape[-1])
    return np.where(t > 0.0, t, np.inf).min(axis=0)


def first_ahead(both: np.ndarray) -> np.ndarray:
    """(shapes, n)"""
    return np.where(both > 0.0, both, np.inf).min(axis=1)


def last_in_order(both: np.ndarray) -> np.ndarray:
    ahead = first_ahead(both)
    t = np.full(ahead.shape[1], np.inf)
    for each in ahead:
        t = np.where(np.isfinite(each), each, t)
    return t


def last_along(both: np.ndarray) -> np.ndarray:
    ahead = first_ahead(both)
    t = np.where(np.isfinite(ahead), ahead, -np.inf).max(axis=0)
    return np.where(np.isfinite(t), t, np.inf)


SELECTIONS = {
    "another root of the surface that is hit first, such as the far one": (lambda both: nearest(both[:, 1]), OPEN),
    "missed: the surface's first root is behind the ray's origin, and the second one was not tried": (
        lambda both: nearest(both[:, 0]), BALLS,
    ),
    "back faces are culled: surfaces seen from behind are missed": (lambda both: nearest(both[:, 0]), BALLS),
    "front faces are culled: surfaces seen from the front are missed": (lambda both: nearest(both[:, 1]), OPEN),
    "the last surface in the order of the scene in place of the nearest": (last_in_order, BALLS),
    "the last surface along the ray in place of the first": (last_along, BALLS),
}  # fmt: skip
REMEDIES = (
    "the smaller root that is ahead", "try the second", "no test of the sign", "no test of the sign",
    "only where its t is smaller", "the smallest t",
)  # fmt: skip
# Of spheres, these are the same mistake; the first of a pair is said.
SAME = ({0, 3}, {1, 2})


@pytest.mark.parametrize("number", range(len(SELECTIONS)))
def test_the_wrong_one_of_several_hits_is_named(brought_candidate, number):
    what = list(SELECTIONS)[number]
    choose, shapes = SELECTIONS[what]
    judge = brought_candidate(shapes)
    t = choose(roots(judge))
    assert nearest(roots(judge)) == pytest.approx(judge.answer.t, rel=1e-9)
    count, found = explained(answering(judge, t))
    alike = {list(SELECTIONS)[i] for pair in SAME if number in pair for i in pair} or {what}
    assert count > 20 and found[what][0] >= 0.95 * count, (found, count)
    assert alike <= set(found) and REMEDIES[number] in found[what][1]
    others = set(SELECTIONS) - alike
    assert not {each for each in others if found.get(each, (0,))[0] > 0.5 * count}, found
    # where as many pixels with the same surfaces are right, it is none
    half = np.arange(len(t)) % 2 == 0
    _, found = explained(answering(judge, np.where(half, t, judge.answer.t)))
    assert what not in found


def test_what_lies_behind_the_first_surface_is_described(brought_candidate):
    judge = brought_candidate(BALLS)
    ahead = np.sort(first_ahead(roots(judge)), axis=0)
    some = np.isfinite(ahead[1]) & (np.arange(ahead.shape[1]) % 3 == 0)
    missed = (np.arange(ahead.shape[1]) % 7 == 1) & np.isfinite(ahead[0])
    t = np.where(some, ahead[1], judge.answer.t)
    _, found = explained(answering(judge, t), DESCRIPTIONS)
    assert found == {"a surface that lies behind the first one": (some.sum(), "")}
    t[missed] = np.inf
    _, found = explained(answering(judge, t), DESCRIPTIONS)
    both = "the first surface is missed, and what lies behind it is hit, if anything"
    assert found[both] == ((some | missed).sum(), "") and len(found) == 2
    assert found["a surface that lies behind the first one"] == ((some & ~missed).sum(), "")


def test_answers_of_a_list_may_be_in_reverse_order_or_moved():
    found = {what: (remedy, order.ravel().tolist()) for what, remedy, order in _image_orders((2, 3), True)}
    remedy = "return them in the order of the rays"
    assert found == {
        "the answers are in reverse order": (remedy, [5, 4, 3, 2, 1, 0]),
        "the answers are moved by 1 ray": (remedy, [5, 0, 1, 2, 3, 4]),
        "the answers are moved by -1 ray": (remedy, [1, 2, 3, 4, 5, 0]),
    }
    square = {what: order.ravel().tolist() for what, _, order in _image_orders((2, 2), False)}
    assert square["the image is turned by a quarter to the left"] == [1, 3, 0, 2]
    assert square["the image is turned by a quarter to the right"] == [2, 0, 3, 1]
    assert square["the image is transposed, x for y"] == [0, 2, 1, 3]


def test_hits_outside_of_a_ray_are_named_where_rays_have_ends():
    t = np.array([0.4, 0.5, 2.0, 3.0, 3.1, np.inf])
    rays = SimpleNamespace(is_list=True)
    judge = SimpleNamespace(
        answer=SimpleNamespace(hits_only=False),
        pair=SimpleNamespace(rays=rays),
        t_min=np.full(6, 0.5),
        t_max=np.full(6, 3.0),
    )
    f = SimpleNamespace(judge=judge, rows=np.arange(6), given_t=t)
    before, beyond = out_of_range(f, f)
    assert before.what == "a hit before t_min, where the ray begins" and before.single
    assert before.remedy == "leave out hits with t <= t_min" and before.fits.tolist() == [True] + [False] * 5
    assert beyond.what == "a hit beyond t_max, where the ray ends" and beyond.single
    assert beyond.remedy == "leave out hits with t > t_max" and np.flatnonzero(beyond.fits).tolist() == [4]
    rays.is_list = False
    assert not list(out_of_range(f, f))
    rays.is_list, judge.answer.hits_only = True, True
    assert not list(out_of_range(f, f))


# ---- normals


def view_axes() -> np.ndarray:
    forward = -np.array([0.3, 0.2, 1.5]) / np.linalg.norm([0.3, 0.2, 1.5])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, forward), forward])


def rotation(axis, degrees) -> np.ndarray:
    axis = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


NORMAL_MISTAKES = {
    "the normal is turned round": lambda judge, n: -n,
    "the normal is turned towards the ray; geometric normals point outside, whoever looks": (
        lambda judge, n: np.where(((n * judge.d).sum(1) > 0.0)[:, None], -n, n)
    ),
    "the interpolated normal in place of the geometric one": (
        lambda judge, n: np.where(
            (judge.result.shape_id == 2)[:, None], caster.cast(judge.scene, judge.o, judge.d).surface.sh_n, n
        )
    ),
    "the normal is in the camera's axes in place of the world's": lambda judge, n: n @ view_axes().T * [1, 1, -1],
    "the normal's axes are permuted or signed: (x, z, y) in place of (x, y, z)": lambda judge, n: n[:, [0, 2, 1]],
    "the normal's axes are permuted or signed: (-x, y, z) in place of (x, y, z)": lambda judge, n: n * [-1, 1, 1],
    "the normal's axes are permuted or signed: (y, -z, x) in place of (x, y, z)": (
        lambda judge, n: n[:, [1, 2, 0]] * [1, -1, 1]
    ),
    "the normal is stored as a colour, (n + 1) / 2": lambda judge, n: unit(n + 1.0),
    "the position in place of the normal": lambda judge, n: unit(judge.o + judge.answer.t[:, None] * judge.d),
    "the ray's direction in place of the normal": lambda judge, n: unit(judge.d),
    "the ray's direction in place of the normal, reversed": lambda judge, n: -unit(judge.d),
    "one normal everywhere": lambda judge, n: np.tile([0.36, 0.48, 0.8], (len(n), 1)),
    "all normals are turned by one rotation": lambda judge, n: n @ rotation([3, 1, 2], 50).T,
    "computed in float32: right by float32's bounds, and given as float64": (
        lambda judge, n: n.astype(np.float32).astype(np.float64)
    ),
}  # fmt: skip


def normals_explained(judge: Judge, n: np.ndarray, rows=None) -> tuple[int, dict[str, tuple[int, str]]]:
    rows = np.arange(WIDTH * HEIGHT) if rows is None else rows
    f = pixels(answering(judge, n=n), rows)
    off = ~(np.linalg.norm(n[rows] - f.at.n, axis=1) <= f.at.n_error)
    found = {each.what: (int(each.fits.sum()), each.remedy) for each in explain_normals(f, n[rows])}
    assert sum(fits for fits, _ in found.values()) == off.sum()  # each wrong one once, no right one
    return int(off.sum()), found


@pytest.mark.parametrize("what", NORMAL_MISTAKES)
def test_a_mistake_of_all_normals_is_named_by_its_own_sentence(brought_candidate, what):
    judge = brought_candidate()
    assert normals_explained(judge, judge.answer.n) == (0, {})
    count, found = normals_explained(judge, NORMAL_MISTAKES[what](judge, judge.answer.n))
    assert count > 8 and next(iter(found)) == what and found[what][0] >= 0.97 * count, (found, count)
    assert found[what][1]


@pytest.mark.parametrize("what", [each for each in NORMAL_MISTAKES if "float32" not in each])
def test_a_mistake_of_few_normals_among_others_is_not_named_by_chance(brought_candidate, what):
    """Of other wrong normals, it is true of a third."""
    judge = brought_candidate()
    n = NORMAL_MISTAKES[what](judge, judge.answer.n)
    other = unit(np.random.default_rng(9).normal(size=n.shape))
    third = np.arange(len(n)) % 3 == 0
    _, found = normals_explained(judge, np.where(third[:, None], n, other))
    assert what not in found or "turned round" in what or "interpolated" in what or "towards" in what
    assert any(each.startswith("the normal is off by ") for each in found)


def test_normals_of_float32_are_no_mistake_of_a_candidate_of_float32(brought_candidate):
    judge = brought_candidate(precision="float32")
    n = judge.answer.n.astype(np.float32).astype(np.float64)
    assert normals_explained(judge, n) == (0, {})
    tilted = unit(n + 1e-3 * np.roll(n, 1, axis=1))
    _, found = normals_explained(judge, tilted)
    (what,) = found
    assert what.startswith("the normal is off by 0.00") and what.endswith(" of its length")


def test_normals_of_corners_minus_the_origin_lose_digits(send):
    """Seen from 40 sizes away; of a candidate of float32, whose bounds hold for the edges of the face."""
    camera = caster.Pinhole(eye=(30.3, 20.2, 40.1), look_at=(0, 0, 0), fov=1.6)
    ring = caster.Torus(to_world=[{"scale": 0.6}, TURN], segments=29, sides=17)
    scene = Scene(film=caster.Film(width=WIDTH, height=HEIGHT), camera=camera, shapes=(ring,))
    judge = scene_judge(scene, FunctionSubject("right", cast, "float32"), send=send)
    mesh, prim = packed_float32(scene).parts[0], judge.reference_prim
    rows = np.flatnonzero(prim >= 0)
    seen = mesh.vertices[mesh.faces[prim[rows]]].astype(np.float32) - judge.o[rows].astype(np.float32)[:, None]
    n = judge.answer.n.copy()
    n[rows] = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    n[rows] /= np.linalg.norm(n[rows], axis=1, keepdims=True)
    count, found = normals_explained(judge, n, rows)
    what = "the normal is computed from corners minus the ray's origin, and lost digits there"
    assert count > 30 and found[what][0] > 0.9 * count and "the edges of the face" in found[what][1], (found, count)
    third = rows[::3]
    other = judge.answer.n.copy()
    other[rows] += 1e-3 * np.roll(other[rows], 1, axis=1)
    other[third] = n[third]
    _, found = normals_explained(judge, other, rows)
    assert what not in found


def test_t_that_was_stored_in_float32_may_be_off_by_that_as_well(brought_candidate):
    judge = brought_candidate()
    own = judge.bounds.own
    single = own.t_error * (KU / KU_OURS)
    for share, fits in ((0.9, True), (1.1, False)):
        wrong = answering(judge, judge.answer.t + share * (single + 1e-3))
        wrong = Judge(
            wrong.scene, wrong.model, replace(wrong.pair, answer=replace(wrong.answer, t_rounding=1e-3)), wrong.view
        )
        f = pixels(wrong, np.arange(WIDTH * HEIGHT))
        (found,) = float32_inside(f, f)
        assert found.fits.all() if fits else not found.fits.any()


def test_one_direction_or_none_determines_no_rotation():
    a = unit(np.random.default_rng(14).normal(size=(30, 3)))
    turn = rotation([1, 2, 3], 40)
    assert _rotation(a, a @ turn.T) == pytest.approx(turn, abs=1e-12)
    mirrored = _rotation(a, -a)
    assert np.linalg.det(mirrored) == pytest.approx(1.0)  # a rotation, not what mirrors
    same = np.tile(a[:1], (30, 1))
    assert _rotation(same, same @ turn.T) is None and _rotation(a, np.nan * a) is None


def test_a_range_is_one_number_where_its_ends_look_alike():
    assert range_text(np.array([0.5, 0.5001, 0.4999])) == "0.5"
    assert range_text(np.array([0.5, 0.25, 3.0])) == "0.25 to 3"
