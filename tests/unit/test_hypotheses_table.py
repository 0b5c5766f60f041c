"""Hypotheses about wrong pixels by tables of a few pixels each: every number they predict, beside its bound.

Intersections are written down here, so that no scene, reference or caster takes part.
"""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from pixel_tables import INF, NAN, Z, explained, intersections, pixels, roots_of

import caster
from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.tolerances import DISTINCT_RTOL, MATCH_RTOL
from mitsuba_ref.judge import hypotheses, scene_checks
from mitsuba_ref.judge.hypotheses import SELECTIONS, WrongPixels, range_text

# ---- off, and right under another prediction

OFF = [
    (2.0, 2.25, 0.25, 0.0, False), (2.0, 2.2500001, 0.25, 0.0, True), (2.0, 1.75, 0.25, 0.0, False),
    (2.0, 1.7499999, 0.25, 0.0, True), (2.0, 2.375, 0.25, 0.125, False), (2.0, 2.376, 0.25, 0.125, True),
    (2.0, INF, INF, 0.0, True), (INF, 2.0, INF, 0.0, True), (INF, INF, 0.0, 0.0, False), (2.0, NAN, 0.5, 0.0, True),
]  # fmt: skip


@pytest.mark.parametrize(("exact", "given", "bound", "rounding", "off"), OFF)
def test_a_pixel_is_off_beyond_its_bound_and_what_it_was_stored_as(exact, given, bound, rounding, off):
    assert pixels([exact], [given], bound, t_rounding=rounding).off.tolist() == [off]
    only = pixels([exact], [given], bound, t_rounding=rounding, hits_only=True)
    assert only.off.tolist() == [np.isinf(exact) != np.isinf(given)]


TINY = np.finfo(float).tiny
UNDER = [
    # exact, given, predicted, bound, rounding, is right under it
    (2.0, 3.0, 3.0, 0.0, 0.0, True),
    (2.0, 3.0, 3.2500001, 0.125, 0.0, False),  # twice the bound
    (2.0, 3.0, 2.75, 0.125, 0.0, True),
    (2.0, 3.0, 2.7499999, 0.125, 0.0, False),
    (2.0, 3.0, 3.25, 0.0, 0.125, True),
    (2.0, 3.0, 3.2500001, 0.0, 0.125, False),
    (2.0, 3.0, 3.25, 0.125, 0.0, True),
    (2.0, 3.0, 3.0002, INF, 0.0, True),  # a ten-thousandth of t, where nothing is bounded
    (2.0, 3.0, 3.0004, INF, 0.0, False),
    (2.0, 3.0, 3.0002, 0.0, 0.0, True),
    (2.0, 3.0, 3.0004, 0.0, 0.0, False),
    (-2.0, -3.0, -3.0002, 0.0, 0.0, True),
    (2.0, 2.001, 2.0010099, 0.0, 0.0, True),  # a hundredth of the error
    (2.0, 2.001, 2.0010101, 0.0, 0.0, False),
    (0.0, TINY, 2 * TINY, 0.0, 0.0, False),  # all of the error is left
    (0.0, 4 * TINY, 5 * TINY, 0.0, 0.0, True),
    (0.0, 4 * TINY, 6.5 * TINY, 0.0, 0.0, False),
    (2.0, 3.0, 3.5, 1.0, 0.0, None),  # a half of the error is left, and the pixel is not off: allowed
    (2.0, 3.0, 3.5, 0.25, 0.0, True),
    (2.0, 3.0, 3.5000001, 0.75, 0.0, None),
    (2.0, 3.0, 2.5, 0.25, 0.0, True),
    (2.0, 3.0, 2.4999, 0.3, 0.0, False),
    (INF, 3.0, 3.0, 0.0, 0.0, True),
    (2.0, NAN, 3.0, 0.5, 0.0, False),
]  # fmt: skip


@pytest.mark.parametrize(("exact", "given", "predicted", "bound", "rounding", "right"), UNDER)
def test_a_pixel_is_right_under_what_is_within_twice_its_bound(exact, given, predicted, bound, rounding, right):
    own = 0.0 if right is not None else 5.0  # not off
    f = pixels([exact], [given], own, t_rounding=rounding)
    t, bounds = np.array([predicted]), np.array([bound])
    assert f.right_under(np.array([True]), t, bounds).tolist() == [right is not False]
    assert f.right_under(np.array([False]), t, bounds).tolist() == [False]
    missed = pixels([exact], [INF], 0.0)
    assert missed.right_under(np.array([False]), t, bounds).tolist() == [True]
    assert missed.right_under(np.array([True]), t, bounds).tolist() == [False]
    only = pixels([exact], [given], own, hits_only=True)
    assert only.right_under(np.array([True]), t + 100.0, bounds).tolist() == [True]


# ---- t is another quantity


def test_float32s_bounds_are_float64s_times_their_roundings():
    wide = 2.0**28  # 4 roundings of 2^-24, over 8 of 2^-53
    given = [2.0 + 0.99 * wide, 2.0 + 1.01 * wide, 2.0 - 0.99 * wide, INF, 2.0 + wide, NAN]
    f = pixels([2.0, 2.0, 2.0, 2.0, INF, 2.0], given, 1.0)
    (found,) = explained(hypotheses.float32_inside, f).values()
    assert found[0] == [True, False, True, False, False, False] and found[1:] == (hypotheses.FLOAT32_REMEDY, False)
    rounded = pixels([2.0] * 2, [2.0 + 1.01 * wide, 2.0 + 1.2 * wide], 1.0, t_rounding=0.1 * wide)
    assert next(hypotheses.float32_inside(rounded, rounded)).fits.tolist() == [True, False]
    far = pixels([2.0, 2.0**30, INF], [INF, 2.0**30 + 1.0, 2.0], [INF, 1.0, INF])
    assert next(hypotheses.float32_inside(far, far)).fits.tolist() == [False, True, False]
    for change in ({"precision": "float32"}, {"exact_visibility": True}):
        assert not explained(hypotheses.float32_inside, pixels([2.0], [3.0], 1.0, **change))


DISTANCE = "distance in place of t, which counts in lengths of d"
DEPTH = "depth along z, the view axis, in place of t along the ray"


def test_distance_and_depth_are_distinguished_from_t(monkeypatch):
    d = [[0, 0, 2.0], [0, 3.0, 0], [0, 0, 1.0], [3.0, 0, 4.0], [0, 0, 2.0], [0, 0, 2.0]]
    exact = [1.0, 2.0, 3.0, 4.0, INF, 1.0]
    f = pixels(exact, [2.0, 6.0, 3.0, 20.0, INF, 3.0], 0.125, d=d)
    found = explained(hypotheses.other_quantity, f)
    assert found[DISTANCE] == (
        [True, True, False, True, False, False], "divide the distance by |d|, or leave d as it is given", True,
    )  # fmt: skip
    assert DEPTH not in found
    monkeypatch.setattr(hypotheses, "camera_axes", lambda camera: np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]))
    f = pixels(exact, [1.0, 0.0, 3.0, 3.2, INF, 0.5], 0.125, d=d, camera="pinhole")
    found = explained(hypotheses.other_quantity, f)
    assert found[DEPTH] == (
        [False, True, False, True, False, False], "divide by the cosine of the ray with the view axis", True,
    )  # fmt: skip
    # twice 2 bounds of a distance: 0.125 |d|, twice
    close = pixels([4.0] * 3, [20.0 + 1.25, 20.0 + 1.26, 20.0 - 1.25], 0.125, d=[[3.0, 0, 4.0]] * 3)
    assert explained(hypotheses.other_quantity, close)[DISTANCE][0] == [True, False, True]
    alike = pixels([4.0] * 2, [4.5, 4.5], 0.125, d=[[0, 0, 1.03125], [0, 0, 1.0625]])
    assert explained(hypotheses.other_quantity, alike)[DISTANCE][0] == [False, True]  # by 0.125: t itself


def quantities(exact, given, bound=0.0, right=None) -> dict[str, tuple[list[bool], str, bool]]:
    found = explained(hypotheses.other_quantity, pixels(exact, given, bound), right)
    return {what: each for what, each in found.items() if any(each[0])}


def test_a_constant_and_a_factor_are_medians_of_all_hits():
    exact = [1.0, 2.0, 4.0, 8.0, INF, 3.0]
    larger = quantities(exact, [1.5, 2.5, 4.5, 8.5, INF, INF])
    assert larger == {
        "t is 0.5 too large everywhere, a constant": (
            [True] * 4 + [False] * 2, "leave out the offset (an epsilon?) of 0.5", False,
        )
    }  # fmt: skip
    smaller = quantities(exact, [0.5, 1.5, 3.5, 7.5, 5.0, INF])
    assert smaller == {
        "t is 0.5 too small everywhere, a constant": (
            [True] * 4 + [False] * 2, "leave out the offset (an epsilon?) of -0.5", False,
        )
    }  # fmt: skip
    scaled = quantities(exact, [1.25, 2.5, 5.0, 10.0, INF, INF])
    assert scaled == {
        "t is 1.25 times what it should be": (
            [True] * 4 + [False] * 2, "look for a wrong unit, a scale or a length that is not 1", False,
        )
    }  # fmt: skip
    assert not quantities(exact[:2], [1.25, 2.5])  # of fewer than three, nothing is fitted
    assert "t is 1.25 times what it should be" in quantities(exact[:3], [1.25, 2.5, 5.0])
    assert not quantities(exact[:3], [1.25, 2.5, NAN])


def test_a_constant_has_to_be_true_of_right_pixels_and_a_factor_near_1():
    exact, count = np.array([1.0, 2.0, 4.0, 8.0]), 4
    right = pixels(exact, exact)
    assert not quantities(exact, exact + 0.5, 0.0, right)
    near = 1.0 + 2.0**-11  # nearer to 1 than a thousandth
    assert not quantities(exact, near * exact, 0.0, right) and quantities(exact, near * exact, 0.0)
    assert len(quantities(exact, 1.25 * exact, 0.0, right)) == 1
    assert len(quantities(exact, 0.75 * exact, 0.0, right)) == 1
    moved = pixels(exact, exact + 0.5, 0.5)
    assert len(quantities(exact, exact + 0.5, 0.0, moved)) == 1 == count - 3
    # a bound of a scaled t is scaled: 0.25 * 8, twice
    f = pixels([1.0, 2.0, 2.0, 2.0, 2.0], [8.0, 16.0, 16.0, 16.0 + 4.0, 16.0 + 4.01], 0.25)
    found = explained(hypotheses.other_quantity, f)
    assert found["t is 8 times what it should be"][0] == [True] * 4 + [False]


def test_powers_of_t_are_recognised():
    exact = np.array([1.5, 2.0, 4.0, 8.0, INF])
    for words, given in (
        ("the square of t", exact**2), ("1 / t", [2 / 3, 0.5, 0.25, 0.125, 0.0]), ("the logarithm of t", np.log(exact)),
    ):  # fmt: skip
        found = quantities(exact, given)
        assert found[f"{words} in place of t"] == ([True] * 4 + [False], "return t itself", False)


# ---- places in the image


@pytest.mark.parametrize("shape", [(2, 3), (3, 2), (3, 3)])
def test_orders_of_an_image_are_what_their_sentences_state(shape):
    h, w = shape
    place = {(y, x): y * w + x for y in range(h) for x in range(w)}
    turned = {
        "the image is mirrored, left for right": (lambda y, x: (y, w - 1 - x), "turn the sign of x"),
        "the image is upside down": (lambda y, x: (h - 1 - y, x), "row 0 is the top one: turn the sign of y"),
        "the image is turned by half a turn": (lambda y, x: (h - 1 - y, w - 1 - x), "turn the signs of x and y"),
    }
    expected = [(what, remedy, [place[of(y, x)] for y, x in place]) for what, (of, remedy) in turned.items()]
    transposed, rows_first = "the image is transposed, x for y", "rows come first: index y * width + x"
    columns = [place[y, x] for x in range(w) for y in range(h)]
    expected.append((transposed, rows_first, columns))
    if h != w:
        expected.append((transposed, rows_first, [columns.index(row) for row in range(h * w)]))
    else:
        for word, of in (("left", lambda y, x: (x, w - 1 - y)), ("right", lambda y, x: (h - 1 - x, y))):
            rows = [place[of(y, x)] for y, x in place]
            expected.append((f"the image is turned by a quarter to the {word}", "exchange x and y", rows))
    for down, across in itertools.product((0, 1, -1), repeat=2):
        if (down, across) != (0, 0):
            what = f"the image is moved by a whole pixel: {across:+d} to the right, {down:+d} down"
            rows = [place[(y - down) % h, (x - across) % w] for y, x in place]
            expected.append((what, "look for an index that counts from 1", rows))
    found = [
        (what, remedy, rows.ravel().tolist()) for what, remedy, rows in hypotheses._image_orders(shape, is_list=False)
    ]
    assert found == expected


def test_orders_of_a_list():
    found = [
        (what, remedy, rows.ravel().tolist()) for what, remedy, rows in hypotheses._image_orders((1, 4), is_list=True)
    ]
    remedy = "return them in the order of the rays"
    assert found == [
        ("the answers are in reverse order", remedy, [3, 2, 1, 0]),
        ("the answers are moved by 1 ray", remedy, [3, 0, 1, 2]),
        ("the answers are moved by -1 ray", remedy, [1, 2, 3, 0]),
    ]


def test_an_order_explains_nearly_all_hits_and_leaves_right_ones_alone():
    t = np.array([1.0, 2.0, 3.0, 4.0, 5.0, INF])
    f = pixels(t, t[::-1])
    f.judge.result = SimpleNamespace(hit=np.isfinite(t), t=t)
    reverse = {"the answers are in reverse order": ([True] * 6, "return them in the order of the rays", False)}
    assert explained(hypotheses.other_order, f) == reverse
    kept = pixels(t, t)
    assert not explained(hypotheses.other_order, f, kept)
    for share, named in ((1.9e-4, True), (-1.9e-4, True), (2.1e-4, False)):
        near = pixels(1000.0 * t, 1000.0 * t[::-1] * (1.0 + share))
        near.judge.result = SimpleNamespace(hit=np.isfinite(t), t=1000.0 * t)
        assert bool(explained(hypotheses.other_order, near)) is named


def off_pixels(hits: int, misses: int = 0, not_off: int = 0) -> WrongPixels:
    exact = [1.0] * hits + [2.0] * misses + [1.0] * not_off
    return pixels(exact, [3.0] * hits + [INF] * misses + [1.0] * not_off)


@pytest.mark.parametrize(
    ("f", "fitting", "expected"),
    [
        (off_pixels(40), range(5), False),
        (off_pixels(2), [0, 1], False), (off_pixels(3), [0, 1, 2], True), (off_pixels(10), range(9), True),
        (off_pixels(10), range(8), False), (off_pixels(20), range(17), False), (off_pixels(3, 1), range(3), False),
        (off_pixels(9, 1), range(9), True), (off_pixels(3, 0, 9), range(3), True),
        (off_pixels(2, 9, 9), range(20), False),
    ],
)  # fmt: skip
def test_hits_that_fit_count_and_not_misses_alone(f, fitting, expected):
    assert hypotheses._explains_hits(f, np.isin(np.arange(len(f.rows)), list(fitting))) is expected


@pytest.mark.parametrize(
    ("wrong", "right", "staying", "kept"),
    [
        (1, 0, 0, True), (1, 10, 9, True), (1, 10, 8, False), (0, 10, 10, False), (2, 20, 20, True), (1, 20, 20, False),
        (1, 1, 1, True), (1, 1, 0, False),
    ],
)  # fmt: skip
def test_right_pixels_stay_right_and_are_not_nearly_all(wrong, right, staying, kept):
    assert hypotheses._is_kept(off_pixels(wrong), np.arange(right) < staying) is kept


# ---- other rays


def test_all_roots_of_a_line_are_considered():
    asked = []
    f = pixels([1.0, 2.0], [3.0, 4.0], t_max=[5.0, 6.0], o=np.ones((2, 3)))
    f.judge.bracket.possible_hits = lambda *given: asked.extend(each.tolist() for each in given)
    assert f.roots is None and asked == [f.o.tolist(), f.d.tolist(), [5.0, 6.0], [-INF, -INF]]


def test_other_rays_are_these():
    o, d = np.array([[1.0, 2.0, 4.0]]), np.array([[8.0, 16.0, 32.0]])
    expected = {"the directions are reversed: -d in place of d": ([1, 2, 4], [-8, -16, -32], 1.0)}
    signs = {"x": [-1, 1, 1], "y": [1, -1, 1], "z": [1, 1, -1]}
    for name, sign in signs.items():
        turned = [s * c for s, c in zip(sign, [8, 16, 32], strict=True)]
        expected[f"the {name} axis of directions is turned round"] = ([1, 2, 4], turned, 1.0)
        of_o = [s * c for s, c in zip(sign, [1, 2, 4], strict=True)]
        expected[f"the {name} axis is turned round, of another handedness"] = (of_o, turned, 1.0)
    for names in ("xzy", "yxz", "yzx", "zxy", "zyx"):
        of_o, of_d = ([{"x": v[0], "y": v[1], "z": v[2]}[c] for c in names] for v in ([1, 2, 4], [8, 16, 32]))
        what = f"are exchanged: ({', '.join(names)}) in place of (x, y, z)"
        expected[f"the axes of directions {what}"] = ([1, 2, 4], of_d, 1.0)
        expected[f"the axes of rays {what}"] = (of_o, of_d, 1.0)
    expected["the rays' origin is taken for (0, 0, 0)"] = ([0, 0, 0], [8, 16, 32], 1.0)
    expected["origin and direction are exchanged"] = ([8, 16, 32], [1, 2, 4], 1.0)
    for s in ("0.001", "0.01", "0.0254", "0.1", "0.5", "2", "10", "100", "1000"):
        f = float(s)
        expected[f"the scene is {s} times as large as it should be"] = ([1 / f, 2 / f, 4 / f], [8, 16, 32], f)
    found = {}
    for ray in hypotheses.OTHER_RAYS:
        lines = ray.lines(o, d)
        found[ray.what] = (*(line[0].tolist() for line in lines), ray.t_factor)
    assert found == expected
    remedies = {ray.what.split()[1]: ray.remedy for ray in hypotheses.OTHER_RAYS}
    assert remedies["z"] == "use the same axes for rays and scene: turn the sign of z"


# roots of one ray, what is kept of them; the exact t, the subject's; whether that is right among them
AMONG = [
    ([(1.0, 0.0, True)], 9.0, 1.0, {}, True),
    ([(1.0, 0.0, True), (2.0, 0.0, True)], 9.0, 2.0, {}, False),  # a certain one is before it
    ([(1.0, 0.0, False), (2.0, 0.0, True)], 9.0, 2.0, {}, True),
    ([(1.0, 0.0, True), (2.0, 0.0, True)], 9.0, 2.0, {"last": True}, True),
    ([(1.0, 0.0, True), (2.0, 0.0, True)], 9.0, 1.0, {"last": True}, False),
    ([(1.0, 0.0, True), (2.0, 0.0, False)], 9.0, 1.0, {"last": True}, True),
    ([(1.0, 0.0, True), (1.5, 0.5, False)], 9.0, 1.5, {}, True),  # within the bound of the one that is certain
    ([(1.0, 0.0, True), (1.5625, 0.5, False)], 9.0, 1.5625, {}, False),
    ([(1.0, 0.5, False), (1.5, 0.0, True)], 9.0, 1.0, {"last": True}, True),
    ([(0.9375, 0.5, False), (1.5, 0.0, True)], 9.0, 0.9375, {"last": True}, False),
    ([(1.0, 0.0, True)], 1.0, 1.0, {}, False),  # that is the exact answer
    ([(1.0, 0.0, True)], 1.0, 1.0, {"or_exact": True}, True),
    ([(1.25, 0.25, True)], 1.0, 1.25, {}, False),
    ([(1.5, 0.25, True)], 1.0, 1.5, {}, True),
    ([(0.5, 0.25, True)], 1.0, 0.5, {}, True),
    ([(1.0, 0.0, True)], INF, 1.0, {}, True),
    ([(1.0, 0.0, True)], 9.0, INF, {}, False),
    ([(-1.0, 0.0, True)], 9.0, INF, {}, True),
    ([(0.0, 0.0, True)], 9.0, INF, {}, True),  # not ahead
    ([(6.0, 0.0, True)], 9.0, 6.0, {}, True),  # t_max itself
    ([(6.5, 0.0, True)], 9.0, 6.5, {}, False),
    ([], 9.0, INF, {}, True),
    ([], 9.0, 1.0, {}, False),
    ([(1.0, 0.125, True)], 9.0, 2.0, {"t_factor": 2.0}, True),
    ([(1.0, 0.125, True)], 9.0, 2.5, {"t_factor": 2.0}, True),
    ([(1.0, 0.125, True)], 9.0, 2.51, {"t_factor": 2.0}, False),
    ([(4.0, 0.0, True)], 9.0, 8.0, {"t_factor": 2.0}, False),
]  # fmt: skip


@pytest.mark.parametrize(("roots", "exact", "given", "options", "expected"), AMONG)
def test_the_answer_is_the_first_or_last_of_the_roots_that_are_kept(roots, exact, given, options, expected):
    """The second of two rays; a root that would be right is left out, and another ray has one."""
    rows = [(1, 0, t) for t, _, _ in roots]
    errors, certain = [each[1] for each in roots], [each[2] for each in roots]
    every = roots_of((0, 0, given), *rows, (1, 0, given), t_error=[0.0, *errors, 0.0], certain=[True, *certain, True])
    f = pixels([9.0, exact], [0.5, given], [0.0, 0.25 if exact == 1.0 else 0.0], t_max=[INF, 6.0])
    kept = np.arange(len(every.ray)) <= len(rows)
    assert hypotheses._right_among(f, every, kept, **options)[1] == expected


def test_first_hits_along_others_are_counted_times_their_factor():
    asked = []

    def possible_hits(o, d, t_max):
        asked.append((o.tolist(), d.tolist(), t_max.tolist()))
        return roots_of((0, 0, 2.0), (1, 0, 3.0))

    f = pixels([9.0, 9.0], [4.0, 5.0], t_max=[8.0, 16.0])
    f.judge.bracket.possible_hits = possible_hits
    o, d = np.eye(3)[:2], np.eye(3)[1:]
    assert hypotheses._first_hits(f, o, d, 2.0).tolist() == [True, False]
    assert asked == [(o.tolist(), d.tolist(), [4.0, 8.0])]
    ray = hypotheses.OtherRay("", "", lambda o, d: (o + 1.0, -d), 4.0)
    hypotheses._first_hit_along(f, ray)
    assert asked[1] == ((f.o + 1.0).tolist(), (-f.d).tolist(), [2.0, 4.0])


# ---- a shift


def test_a_step_of_newtons_method_is_a_fit_without_the_fifth_that_fits_least(monkeypatch):
    rng = np.random.default_rng(1)
    slopes, base = rng.normal(size=(40, 2)), rng.uniform(2, 3, 40)
    at = np.array([0.5, -0.25])
    monkeypatch.setattr(hypotheses, "_t_at", lambda f, shift: f.base + f.slopes @ shift)
    step = np.array([0.125, 0.0625])

    def found(count=40, spoilt=0, **change):
        given = base + slopes @ (at + step)
        given[:spoilt] += 100.0
        arrays = {"given_t": given, "base": base.copy(), "slopes": slopes.copy()}
        for name, rows in change.items():
            arrays[name][rows] = NAN
        f = SimpleNamespace(**{name: array[:count] for name, array in arrays.items()})
        return hypotheses._newton_step(f, at)

    for change in ({}, {"spoilt": 8}, {"base": slice(5), "slopes": slice(3, 9)}):
        assert found(**change) == pytest.approx(step)
    assert np.abs(found(spoilt=12) - step).max() > 0.1
    assert found(count=20) == pytest.approx(step) and found(count=19) is None  # 16 of 20 are left
    assert found(base=slice(None)) is None
    partly = slopes.copy()
    partly[:6, 0] = NAN  # one slope of two is none
    f = SimpleNamespace(given_t=base + slopes @ (at + step), base=base, slopes=partly)
    monkeypatch.setattr(
        hypotheses, "_t_at", lambda f, shift: f.base + np.where(shift - at == 0.0, 0.0, f.slopes * shift).sum(1)
    )  # fmt: skip
    assert hypotheses._newton_step(f, at) is not None


def test_t_at_another_place_is_the_root_nearest_to_t(monkeypatch):
    met = SimpleNamespace(at=SimpleNamespace(t=np.array([1.0, 2.25, 3.5, 9.0])), pair=np.array([0, 0, 0, 2]))
    asked = []
    f = pixels([2.0, 2.0, 8.0], [0.0] * 3, prim=[4, 5, 6])
    f.judge.model = SimpleNamespace(intersect=lambda *given, **more: asked.append((*given, more)) or met)
    monkeypatch.setattr(hypotheses, "_rays_at", lambda f, shift: ("o", "d"))
    found = hypotheses._t_at(f, np.zeros(2))
    assert np.array_equal(found, [2.25, NAN, 9.0], equal_nan=True)
    prim, *rest = asked[0]
    assert prim.tolist() == [4, 5, 6] and rest == ["o", "d", 0.5, {"ours": True}]


SHIFTS = [
    ((0.25, -0.5), 40, {}, "(+0.25, -0.50)"), ((0.03125, 0.0), 40, {}, None), ((0.032, 0.0), 40, {}, "(+0.03, +0.00)"),
    ((0.0, -0.04), 40, {}, "(+0.00, -0.04)"), ((4.0, 0.0), 40, {}, None), ((0.0, -3.75), 40, {}, "(+0.00, -3.75)"),
    ((0.25, 0.25), 15, {}, None), ((0.25, 0.25), 16, {}, "(+0.25, +0.25)"), ((0.25, 0.25), 40, {"is_list": True}, None),
    ((0.25, 0.25), 40, {"hits_only": True}, None),
]  # fmt: skip


@pytest.mark.parametrize(("shift", "count", "options", "where"), SHIFTS)
def test_a_shift_of_the_image_is_said_in_pixels(monkeypatch, shift, count, options, where):
    given = {"is_list": False} | options
    f = pixels([2.0] * (count + 2) + [INF], [3.0] * count + [INF, 3.0, 3.0], **given)
    f.judge.answer.t[count + 1] = INF
    f.judge.hit[count + 1] = False
    steps = []

    def newton(seen, at):
        steps.append((len(seen.rows), at.tolist()))
        return (np.array(shift) - at) / 2 if len(steps) < 3 else np.array(shift) - at

    monkeypatch.setattr(hypotheses, "_newton_step", newton)
    monkeypatch.setattr(hypotheses, "_rays_at", lambda f, at: (at, f))
    monkeypatch.setattr(hypotheses, "_first_hits", lambda f, at, same, **more: np.ones(len(f.rows), bool))
    found = explained(hypotheses.shifted_image, f)
    if where is None:
        assert not found and len(steps) == (0 if options or count < 16 else 3)
        return
    what = f"rays beside the pixel centres, by {where} of a pixel to the right and down"
    assert found == {what: ([True] * (count + 3), "the centre of pixel (x, y) is at (x + 0.5, y + 0.5)", False)}
    assert [each for each, _ in steps] == [count] * 3 and steps[0][1] == [0.0, 0.0]
    kept = pixels([2.0] * 9, [2.0] * 9)
    monkeypatch.setattr(hypotheses, "_first_hits", lambda f, at, same, **more: np.full(len(f.rows), not more))
    assert not explained(hypotheses.shifted_image, f, kept)
    monkeypatch.setattr(hypotheses, "_first_hits", lambda f, at, same, **more: np.arange(len(f.rows)) < 9)
    assert not explained(hypotheses.shifted_image, f)
    monkeypatch.setattr(hypotheses, "_newton_step", lambda seen, at: None)
    assert not explained(hypotheses.shifted_image, f)


def test_rays_at_another_place_of_their_pixels_are_those_of_other_pixels():
    camera = caster.Pinhole(eye=(1, 2, 6), look_at=(0, 0.5, 0), fov=40, near=2.5)
    scene = Scene(film=caster.Film(width=5, height=4), camera=camera, shapes=[caster.Sphere()])
    rays = scene_checks.camera_rays(scene)
    f = pixels([1.0] * 20, [1.0] * 20)
    f.judge.scene = scene
    o, d = hypotheses._rays_at(f, np.zeros(2))
    assert d == pytest.approx(rays.d) and o == pytest.approx(rays.o + rays.t_min[:, None] * rays.d)
    for shift, step in (((1.0, 0.0), 1), ((0.0, 1.0), 5), ((1.0, 1.0), 6)):
        moved = hypotheses._rays_at(f, np.array(shift))
        for row in (0, 6, 7, 13):
            assert moved[0][row] == pytest.approx(o[row + step]) and moved[1][row] == pytest.approx(d[row + step])


def test_other_rays_are_tried_on_a_few_pixels_first(monkeypatch):
    rays = [hypotheses.OtherRay(f"what {i}", f"remedy {i}", lambda o, d: (o, d)) for i in range(4)]
    monkeypatch.setattr(hypotheses, "OTHER_RAYS", rays)
    tried = []

    def along(f, ray, *, or_exact=False):
        number = int(ray.what[-1])
        tried.append((number, len(f.rows), or_exact))
        wrong = {0: True, 1: len(f.rows) > 96, 2: len(f.rows) <= 96, 3: True}[number]
        return np.full(len(f.rows), number != 3 if or_exact else wrong)

    monkeypatch.setattr(hypotheses, "_first_hit_along", along)
    f, right = off_pixels(120, 0, 30), pixels([1.0] * 50, [1.0] * 50)
    assert explained(hypotheses.other_rays, f, right) == {"what 0": ([True] * 150, "remedy 0", False)}
    few = [each for each in tried if each[1] == 96]
    assert few == [(number, 96, False) for number in range(4)] and (0, 50, True) in tried
    assert (1, 150, False) not in tried and (2, 50, True) not in tried


def test_corners_of_primitives_are_those_of_their_faces(tmp_path):
    faces = [[0, 1, 2], [2, 1, 3]]
    first, second = np.arange(12.0).reshape(4, 3) ** 1.5, np.arange(12.0).reshape(4, 3) ** 1.2 - 30.0
    paths = [tmp_path / f"{i}.obj" for i in range(2)]
    for path, vertices in zip(paths, (first, second), strict=True):
        lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
        path.write_text("\n".join([*lines, "f 1 2 3", "f 3 2 4"]))
    shapes = [caster.MeshFile(file=str(paths[0])), caster.Sphere(), caster.MeshFile(file=str(paths[1]))]
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=shapes)
    judge = SimpleNamespace(model=SimpleNamespace(packed=packed(scene)))
    found = hypotheses.triangle_corners(judge, np.array([4, 0, 1, 2, -1, 3]))
    expected = [second[faces[1]], first[faces[0]], first[faces[1]], [[NAN] * 3] * 3, [[NAN] * 3] * 3, second[faces[0]]]
    assert np.array_equal(found, np.array(expected), equal_nan=True)


# ---- which of several roots


def random_roots(seed: int):
    """Pixels with up to six roots of three primitives each, some behind, normals of either side."""
    rng = np.random.default_rng(seed)
    rows = [
        (ray, int(rng.integers(3)), float(rng.integers(-3, 6))) for ray in range(6) for _ in range(rng.integers(0, 7))
    ]
    n = np.where(rng.random((len(rows), 1)) < 0.5, 1.0, -1.0) * np.array(Z)
    n[rng.random(len(rows)) < 0.1] = 0.0
    roots = roots_of(*rows, n=n)
    t_min = rng.integers(0, 2, 6).astype(float)
    return pixels([9.0] * 6, [INF] * 6, roots=roots, t_min=t_min), rows, n[:, 2], t_min


def selected(rows, n, t_min) -> list[list[bool]]:
    """The same six selections, root by root."""
    found = [[] for _ in range(6)]
    for i, (ray, prim, t) in enumerate(rows):
        same = [each for r, p, each in rows if (r, p) == (ray, prim)]
        ahead = [each for each in same if each > t_min[ray]]
        is_first_ahead = t > t_min[ray] and t == min(ahead)
        others = [p for r, p, each in rows if r == ray and each > t_min[r]]
        found[0].append(t != min(same) or len({*same}) == 1)
        found[1].append(t == min(same) or min(same) >= 0.0)
        found[2].append(n[i] < 0.0)
        found[3].append(n[i] > 0.0)
        found[4].append(is_first_ahead and prim == max(others))
        found[5].append(is_first_ahead)
    return found


@pytest.mark.parametrize("seed", range(12))
def test_selections_keep_the_roots_that_their_sentences_state(seed):
    f, rows, n, t_min = random_roots(seed)
    if rows:
        assert [each.kept(f).tolist() for each in SELECTIONS] == selected(rows, n, t_min)
    assert [(each.last, each.single) for each in SELECTIONS] == [
        (False, True), (False, True), (False, False), (False, False), (False, False), (True, False),
    ]  # fmt: skip


def test_another_selection_leaves_right_pixels_right():
    """The far root of a sphere, of two pixels; the same of right ones would make them wrong."""
    roots = roots_of((0, 0, 1.0), (0, 0, 2.0), (1, 0, 3.0), (1, 0, 5.0))
    f = pixels([1.0, 3.0], [2.0, 5.0], roots=roots)
    what = "another root of the surface that is hit first, such as the far one"
    none = pixels([], [], roots=roots_of())
    found = explained(hypotheses.other_selection, f, none)
    assert found[what] == ([True, True], "take the smaller root that is ahead of the origin", True)
    right = pixels([1.0, 3.0], [1.0, 3.0], roots=roots)
    assert what not in explained(hypotheses.other_selection, f, right)
    alone = pixels([1.0, 3.0], [1.0, 3.0], roots=roots_of((0, 0, 1.0), (1, 0, 3.0)))
    assert what in explained(hypotheses.other_selection, f, alone)
    invented = pixels([INF], [2.0], roots=roots_of((0, 0, 1.0), (0, 0, 2.0)))
    assert not explained(hypotheses.other_selection, invented, none)


BEHIND = "a surface that lies behind the first one"
EITHER = "the first surface is missed, and what lies behind it is hit, if anything"


def test_what_lies_behind_is_on_another_root_by_more_than_a_thousandth():
    t = [2.0, 2.0019, 2.0021, 5.0, 5.0004, 5.0006, 1.0, INF, 5.0, 4.75, 4.7]
    exact = [2.0] * 7 + [2.0, INF, 2.0, 2.0]
    rows = [(ray, 0, root) for ray in range(11) for root in (1.0, 2.0019, 2.0021, 5.0)]
    bound = [0.25 if ray in (9, 10) else 0.0 for ray, _, _ in rows]
    f = pixels(exact, t, roots=roots_of(*rows, t_error=bound))
    behind = [False, False, True, True, True, False, False, False, False, True, False]
    missed = [each == 7 for each in range(11)]
    found = explained(hypotheses.first_one_missed, f)
    both = [a or b for a, b in zip(behind, missed, strict=True)]
    assert found == {EITHER: (both, "", False), BEHIND: (behind, "", False)}
    seen = pixels(exact[:7], t[:7], roots=f.roots.take(f.roots.ray < 7))
    assert list(explained(hypotheses.first_one_missed, seen)) == [BEHIND]
    f.judge.answer.hits_only = True
    assert explained(hypotheses.first_one_missed, f) == {BEHIND: ([False] * 11, "", False)}


# ---- hits and misses


def test_hits_outside_of_a_ray_are_before_its_start_or_beyond_its_end():
    f = pixels([3.0] * 5, [1.0, 2.0, 4.0, 4.5, INF], t_min=[2.0] * 5, t_max=[4.0] * 5)
    before, beyond = ("a hit before t_min, where the ray begins", "a hit beyond t_max, where the ray ends")
    expected = {
        before: ([True, False, False, False, False], "leave out hits with t <= t_min", True),
        beyond: ([False, False, False, True, False], "leave out hits with t > t_max", True),
    }
    assert explained(hypotheses.out_of_range, f) == expected
    for change in ({"is_list": False}, {"hits_only": True}):
        assert not explained(hypotheses.out_of_range, pixels([3.0], [1.0], t_min=[2.0], **change))


def corners_of(*triangles):
    return lambda judge, prim: np.array([triangles[p] if p >= 0 else np.full((3, 3), NAN) for p in prim], float)


FLAT = [[5, 7, 9], [7, 7, 9], [5, 10, 9]]
SMALL = [[3, 1, 4], [3.5, 1, 4], [3, 1.5, 4]]


def test_the_remedy_of_a_subject_that_hits_nothing_states_determinants(monkeypatch):
    monkeypatch.setattr(hypotheses, "triangle_corners", corners_of(FLAT, SMALL, np.full((3, 3), NAN)))
    d = [[0, 0, 2.0], [1.0, 0, 1.0], [0, 0, 1.0], [0, 0, 1.0]]
    missing = [INF] * 4
    f = pixels([3.0, 7.0, INF, 4.0], missing, prim=[0, 1, -1, 2], d=d)
    epsilon = ", is every epsilon below the determinants of 0.25 to 12 here"
    remedy = f"is the scene read, do rays reach t = 7{epsilon}?"
    fits = [True, True, False, True]
    assert explained(hypotheses.everything_missed, f) == {"the candidate misses everything": (fits, remedy, True)}
    ours = pixels([3.0, 4.0], missing[:2], prim=[2, 2], exact_visibility=True)
    remedy = "is the scene read, do rays reach t = 4?"
    assert explained(hypotheses.everything_missed, ours) == {"ours misses everything": ([True, True], remedy, True)}
    assert not explained(hypotheses.everything_missed, pixels([3.0], [INF]))
    assert not explained(hypotheses.everything_missed, pixels([3.0, 3.0], [INF, 3.0]))


@pytest.mark.parametrize(
    ("sizes", "text"), [([0.126, 0.125], "0.12 to 0.13"), ([2.0, 2.01], "2"), ([1e-9, 5.0], "1e-09 to 5")]
)
def test_a_range_has_two_digits(sizes, text):
    assert range_text(np.array(sizes)) == text


# ---- normals


def unit_rows(rng, count: int) -> np.ndarray:
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def turned_by(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def normals(change, count=8, n_error=1e-9, seed=2, flat=None, right=None, **more) -> dict[str, list[bool]]:
    """What is said of normals; change: (right normals, directions) -> the given ones."""
    rng = np.random.default_rng(seed)
    drawn, d, o = unit_rows(rng, count), unit_rows(rng, count), rng.normal(size=(count, 3))
    sh, right = unit_rows(rng, count), drawn if right is None else right
    right = right if flat is None else np.tile(flat, (count, 1))
    at = intersections([2.0] * count, n=right, n_error=n_error, sh_n=sh)
    f = pixels([2.0] * count, [2.0] * count, at=at, d=d, o=o, **more)
    given = np.array(change(SimpleNamespace(right=right, d=d, o=o, sh=sh, p=o + 2.0 * d)))
    return {each.what: (each.fits.tolist(), each.remedy) for each in hypotheses.explain_normals(f, given)}


ROUND = "the normal is turned round"
NORMALS = {
    ROUND: (lambda x: -x.right, "turn its sign: normals point outside"),
    "the interpolated normal in place of the geometric one": (
        lambda x: x.sh, "return the normal of the face, the cross product of its edges",
    ),
    "the normal's axes are permuted or signed: (y, x, z) in place of (x, y, z)": (
        lambda x: x.right[:, [1, 0, 2]], "use the same axes for normals and scene",
    ),
    "the normal's axes are permuted or signed: (-z, x, -y) in place of (x, y, z)": (
        lambda x: x.right[:, [2, 0, 1]] * [-1, 1, -1], "use the same axes for normals and scene",
    ),
    "the normal's axes are permuted or signed: (x, -y, z) in place of (x, y, z)": (
        lambda x: x.right * [1, -1, 1], "use the same axes for normals and scene",
    ),
    "the position in place of the normal": (
        lambda x: x.p / np.linalg.norm(x.p, axis=1)[:, None], "subtract the centre",
    ),
    "the ray's direction in place of the normal": (lambda x: x.d, "return the surface's normal"),
    "the ray's direction in place of the normal, reversed": (lambda x: -x.d, "return the surface's normal"),
    "one normal everywhere": (lambda x: np.tile([0.6, 0.0, 0.8], (8, 1)), "compute it for each hit"),
    "all normals are turned by one rotation": (
        lambda x: x.right @ turned_by(25).T, "look for a matrix that is missing, or there twice",
    ),
    "the normal is stored as a colour, (n + 1) / 2": (
        lambda x: (x.right + 1) / np.linalg.norm(x.right + 1, axis=1)[:, None], "return n itself, from -1 to 1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", NORMALS)
def test_a_mistake_of_normals_is_named_with_its_remedy(what):
    change, remedy = NORMALS[what]
    assert normals(change) == {what: ([True] * 8, remedy)}


def test_a_normal_at_the_tolerance_of_a_hypothesis_is_still_explained_by_it():
    def turned(off):
        return normals(lambda x: -x.right + [off, 0.0, 0.0], flat=[0.0, 0.0, 1.0])

    assert turned(MATCH_RTOL) == {ROUND: ([True] * 8, NORMALS[ROUND][1])}
    assert ROUND not in turned(MATCH_RTOL * (1.0 + 1e-9))


def test_normals_that_hardly_differ_say_nothing_of_axes():
    """Of permuted axes, right normals have to differ by more than what is no chance: DISTINCT_RTOL."""
    what = "the normal's axes are permuted or signed: (y, x, z) in place of (x, y, z)"

    def permuted(apart):
        right = np.tile([1.0, 0.0, 0.0], (8, 1))
        right[4:, 1] = apart
        return normals(lambda x: right[:, [1, 0, 2]], right=right)

    assert what not in permuted(DISTINCT_RTOL) and what in permuted(DISTINCT_RTOL * (1.0 + 1e-9))


def test_normals_in_the_axes_of_the_camera(monkeypatch):
    axes = turned_by(37).T
    monkeypatch.setattr(hypotheses, "camera_axes", lambda camera: axes)
    what = "the normal is in the camera's axes in place of the world's"
    for signs in ([1, 1, 1], [1, 1, -1], [-1, 1, 1]):
        found = normals(lambda x, s=signs: (x.right @ axes.T) * s, camera="pinhole")
        assert found == {what: ([True] * 8, "turn it by the camera's matrix")}
    assert what not in normals(lambda x: x.right @ axes.T)


def test_some_normals_among_right_ones():
    def half(x):
        return np.where(np.arange(8)[:, None] < 4, -x.right, x.right)

    assert normals(half) == {ROUND: ([True] * 4 + [False] * 4, NORMALS[ROUND][1])}
    assert not normals(lambda x: x.right) and not normals(lambda x: x.right + 0.9e-9 / 2)

    def two(x):  # of three kinds, none has nearly all
        return np.where(np.arange(8)[:, None] < 4, x.d, x.right[:, [1, 0, 2]])

    (found,) = normals(two).items()
    assert found[0].startswith("the normal is off by ") and found[1] == ([True] * 8, "")
    towards = normals(lambda x: x.right * -np.sign((x.right * x.d).sum(1))[:, None], n_error=1e-9)
    (found,) = towards.items()
    assert found[0] == "the normal is turned towards the ray; geometric normals point outside, whoever looks"
    assert found[1][1] == "do not turn normals by the sign of n . d" and 0 < sum(found[1][0]) < 8


def test_few_normals_of_another_kind_are_named_where_they_can_be_no_others():
    def one_round(x):
        return np.where(np.arange(8)[:, None] < 1, -x.right, x.right)

    assert normals(one_round) == {ROUND: ([True] + [False] * 7, NORMALS[ROUND][1])}

    def one_interpolated(x):
        return np.where(np.arange(8)[:, None] < 1, x.sh, x.right)

    assert list(normals(one_interpolated)) == ["the interpolated normal in place of the geometric one"]

    def two_exchanged(x):
        return np.where(np.arange(8)[:, None] < 2, x.right[:, [1, 0, 2]], x.right)

    (found,) = normals(two_exchanged)
    assert found.startswith("the normal is off by ")

    def mostly_towards(x):  # 9 of 10 towards the ray, one turned round besides
        facing = (x.right * x.d).sum(1) > 0.0
        chosen = np.r_[np.flatnonzero(facing)[:9], np.flatnonzero(~facing)[:1]]
        return np.where(np.isin(np.arange(len(x.d)), chosen)[:, None], -x.right, x.right)

    found = normals(mostly_towards, 40)
    turned = "the normal is turned towards the ray; geometric normals point outside, whoever looks"
    assert {what: sum(fits) for what, (fits, _) in found.items()} == {turned: 9, ROUND: 1}

    # of a wall, axes are not told apart
    (found,) = normals(lambda x: np.tile([0.6, 0.0, 0.8], (8, 1)), flat=[0.0, 0.6, 0.8])
    assert found == "the normal is off by 0.85 of its length"


def test_what_is_left_of_normals_may_have_lost_digits(monkeypatch):
    def some(count):
        monkeypatch.setattr(
            hypotheses, "_of_corners_seen_from_the_origin", lambda f, n, error: np.arange(len(n)) < count
        )
        found = normals(lambda x: x.right + 0.25 * np.eye(3)[np.arange(8) % 3], n_error=1e-12)
        return {what: sum(fits) for what, (fits, _) in found.items()}

    lost = "the normal is computed from corners minus the ray's origin, and lost digits there"
    off = "the normal is off by 0.25 of its length"
    assert some(3) == {off: 8} and some(4) == {lost: 4, off: 4} and some(8) == {lost: 8}


def test_hypotheses_of_normals_are_these():
    count = 3
    right = unit_rows(np.random.default_rng(4), count)
    f = pixels([2.0, INF, 1.0], [2.0] * count, at=intersections([2.0] * count, n=right))
    found = list(hypotheses._normal_hypotheses(f, right + 1.0, np.ones(count, bool)))
    names = [each.what for each in found]
    permuted = [name for name in names if "permuted or signed" in name]
    assert len(permuted) == len(set(permuted)) == 6 * 8 - 2 and len(names) == 46 + 8
    assert not any("(x, y, z) in place" in name or "(-x, -y, -z) in place" in name for name in names)
    (p,) = (each.n for each in found if each.what.startswith("the position"))
    assert p.tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, 1]]


def test_a_normal_is_off_by_its_distance_or_within_float32s_bounds(monkeypatch):
    monkeypatch.setattr(hypotheses, "triangle_corners", lambda judge, prim: np.full((len(prim), 3, 3), NAN))
    (found,) = normals(lambda x: x.right + 0.25 * np.eye(3)[np.arange(8) % 3], n_error=1e-12)
    assert found == "the normal is off by 0.25 of its length"
    (found,) = normals(lambda x: x.right + np.linspace(0.125, 0.5, 8)[:, None] * np.eye(3)[0])
    assert found == "the normal is off by 0.12 to 0.5 of its length"

    def near(share):
        return lambda x: x.right + share * np.eye(3)[np.arange(8) % 3] * 2.0**28 * 1e-12

    assert list(normals(near(0.9), n_error=1e-12)) == [hypotheses.IN_FLOAT32]
    assert list(normals(near(1.1), n_error=1e-12)) == ["the normal is off by 0.0003 of its length"]
    assert hypotheses.IN_FLOAT32 not in normals(near(0.9), n_error=1e-12, precision="float32")
    # no bound is wider than a sixteenth
    assert normals(near(0.0), n_error=1.0) == {}
    (found,) = normals(lambda x: x.right + 0.0626 * np.eye(3)[0], n_error=INF, precision="float32")
    assert found == "the normal is off by 0.063 of its length"
    assert not normals(lambda x: x.right + 0.0624 * np.eye(3)[0], n_error=INF)
    assert not normals(lambda x: x.right * NAN, count=0)


def test_normals_of_corners_in_float32_seen_from_the_origin(monkeypatch):
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(8, 3, 3)) * 2.0**-6 + 1.0
    monkeypatch.setattr(hypotheses, "triangle_corners", lambda judge, prim: corners)
    o = np.full((8, 3), 1000.0)
    seen = (corners.astype(np.float32) - o.astype(np.float32)[:, None]).astype(float)

    def unit_normals(c):
        n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
        return n / np.linalg.norm(n, axis=1)[:, None]

    predicted, right = unit_normals(seen), unit_normals(corners)
    error = np.linalg.norm(predicted - right, axis=1)
    assert error.min() > 1e-4

    def found(n, n_error=1e-9, precision="float32", error=error):
        at = intersections([2.0] * 8, n=right, n_error=n_error)
        f = pixels([2.0] * 8, [2.0] * 8, at=at, o=o, precision=precision)
        return hypotheses._of_corners_seen_from_the_origin(f, n, error)

    x = np.array([1.0, 0.0, 0.0])
    assert found(predicted).all() and not found(right).any() and not found(predicted, precision="float64").any()
    assert found(predicted + 1.99e-9 * x).all() and not found(predicted + 2.01e-9 * x).any()
    off = predicted + 1e-3 * x
    assert found(off, 1.0, error=np.full(8, 2.1e-3)).all() and not found(off, 1.0, error=np.full(8, 1.9e-3)).any()


@pytest.mark.parametrize("seed", range(4))
def test_a_rotation_is_that_nearest_to_all(seed):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    a = unit_rows(rng, 9)
    b = a @ turn.T
    a[0, 1], b[1, 2] = NAN, INF
    assert hypotheses._rotation(a, b) == pytest.approx(turn)
    flat = np.array([[1.0, 0, 0], [0, 1.0, 0]])
    assert hypotheses._rotation(flat, flat @ turn.T) == pytest.approx(turn)  # a plane of directions is enough
    assert np.linalg.det(hypotheses._rotation(a, -b)) == pytest.approx(1.0)
    small = np.array([[1.0, 0, 0], [0, 0.04, 0]])  # singular values 1 and 0.0016, 1 and 0.0009
    assert hypotheses._rotation(small, small) == pytest.approx(np.eye(3))
    assert hypotheses._rotation(small * [1, 0.75, 1], small * [1, 0.75, 1]) is None
    tiny = np.array([[0.01, 0, 0], [0, 0.01, 0]])
    assert hypotheses._rotation(tiny, tiny) == pytest.approx(np.eye(3))
