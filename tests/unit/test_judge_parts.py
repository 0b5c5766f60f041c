"""Parts of the judge by themselves, as tables: exact answers, aimed rays, outlines, thresholds, sums."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import verdict_factory

import caster
from caster.geometry.packing import packed
from caster.scene.model import Scene
from caster.system.process import OK
from mitsuba_ref.cli.validate import exit_code
from mitsuba_ref.error_model.bracket import ANY_SHAPE, CLAIMED_MISS, NOT_CLAIMED, Claims
from mitsuba_ref.judge import adjudication, diagnosis
from mitsuba_ref.judge.adjudication import (
    claims_of,
    claims_other_tie,
    exact_error_ratio,
    has_hit_neighbor,
    needs_adjudication,
    oracle_answers,
    ratios_of_any_tie,
    ratios_of_named,
    sample_rows,
)
from mitsuba_ref.judge.aggregate import merge_windows
from mitsuba_ref.judge.checks import adversarial_rays as aimed
from mitsuba_ref.judge.checks.adversarial_rays import Setting, Targets
from mitsuba_ref.judge.checks.knife_edges import (
    LARGEST_FLOAT64,
    NearestHits,
    RayBatch,
    cast_by_culling,
    discrepancy,
    error_over_bound,
    lossless_exponents,
    with_limits,
)
from mitsuba_ref.judge.diagnosis import Cause, Diagnosis
from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, Finding, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.oracle.oracle import OutsideDomain
from mitsuba_ref.subjects.subject import Answer

INF = np.inf

# ---- who is adjudicated


def test_a_neighbour_is_one_of_eight_and_the_pixel_itself():
    rng = np.random.default_rng(1)
    for shape in ((1, 1), (1, 5), (4, 1), (5, 7)):
        hit = rng.random(shape) < 0.15
        expected = np.zeros(shape, bool)
        for (y, x), (j, i) in itertools.product(np.ndindex(shape), np.ndindex(shape)):
            expected[y, x] |= hit[j, i] and abs(y - j) <= 1 and abs(x - i) <= 1
        assert np.array_equal(has_hit_neighbor(hit), expected)


def test_all_that_may_be_disputed_is_adjudicated_and_a_thousand_of_the_rest():
    rng = np.random.default_rng(2)
    shape, count = (60, 50), 3000
    y, x = np.divmod(np.arange(count), 50)
    hit = (x > 10) & (y > 7)
    plain, certain = rng.random(count) > 0.05, rng.random(count) > 0.1
    rows = needs_adjudication(plain, hit, certain, shape)
    border = ~hit & has_hit_neighbor(hit.reshape(shape)).ravel()
    must = ~plain | (hit & ~certain) | border
    chosen = np.isin(np.arange(count), rows)
    assert chosen[must].all() and (np.diff(rows) > 0).all() and (chosen & ~must).sum() == 1024
    assert must[~hit & ~border & plain].sum() == 0  # certain or not, a miss away from hits is none of them
    assert len(needs_adjudication(plain[:6], hit[:6], certain[:6], (2, 3))) == 6


def test_a_sample_is_a_subset_in_order():
    rows = np.arange(100, 400, 3)
    found = sample_rows(rows, 20)
    assert len(np.unique(found)) == 20 and set(found) <= set(rows) and (np.diff(found) > 0).all()
    assert np.array_equal(sample_rows(rows, 1000), rows) and np.array_equal(found, sample_rows(rows, 20))


def test_rays_that_the_oracle_refuses_cost_the_others_nothing():
    bad = {3, 4, 11}

    class Refusing:
        def first_hits(self, o, d, t_min, t_max):
            numbers = o[:, 0].astype(int).tolist()
            if bad & set(numbers):
                raise OutsideDomain("planted")
            return [(n, *rest) for n, *rest in zip(numbers, d[:, 1], t_max, t_min, strict=True)]

    o, d = np.zeros((2, 13, 3))
    o[:, 0], d[:, 1] = np.arange(13), np.arange(13) + 0.5
    found = oracle_answers(Refusing(), o, d, np.arange(13) + 0.25, np.arange(13) + 0.75)
    assert found == [None if n in bad else (n, n + 0.5, n + 0.25, n + 0.75) for n in range(13)]


# ---- the error from the exact answer


class Exact(float):
    """An exact t."""

    def off(self, x):
        return abs(x - float(self))


def answer_at(*ties, miss=False) -> SimpleNamespace:
    """An exact answer with (prim, t) as its tie set."""
    members = [SimpleNamespace(prim=prim, t=Exact(t), where="inside") for prim, t in ties]
    t, prim = (None, -1) if miss else (members[0].t, members[0].prim)
    return SimpleNamespace(t=t, prim=prim, ties=members)


HIT, MISS = answer_at((7, 2.0)), answer_at(miss=True)


@pytest.mark.parametrize(
    ("answer", "prim", "t", "bound", "ratio"),
    [
        (MISS, -1, INF, 1.0, 0.0),
        (MISS, 7, 2.0, 1.0, INF),
        (HIT, -1, INF, 1.0, INF),
        (HIT, 8, 2.0, 1.0, INF),
        (HIT, 7, 2.0, 1.0, 0.0),
        (HIT, 7, 2.0, 0.0, 0.0),
        (HIT, 7, 2.25, 0.5, 0.5),
        (HIT, 7, 1.0, 0.5, 2.0),
        (HIT, 7, 1.0, 0.0, INF),
        (HIT, 7, 1.0, np.nan, INF),
        (HIT, 7, INF, 0.5, INF),
        (HIT, 7, np.nan, 0.5, INF),
        (HIT, 7, 9.0, INF, 0.0),  # edge-on: which primitive it is is all there is
    ],
)
def test_the_error_of_a_subject_that_names_what_it_hits(answer, prim, t, bound, ratio):
    assert exact_error_ratio(answer, prim, t, bound) == ratio
    found = ratios_of_named([answer, None], np.array([prim, prim]), np.array([t, t]), np.array([bound, bound]))
    assert found.best.tolist() == [ratio, INF] and found.of_first.tolist() == [ratio <= 1.0, False]


def candidate(t, n=None, **more) -> Answer:
    return Answer(np.array(t, float), None if n is None else np.array(n, float), "float64", {}, **more)


PACKED = SimpleNamespace(shape_of=lambda prim: prim // 10, index_in_shape=lambda prim: prim % 10, parts=[0] * 3)
UP, SIDE = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def tilted(n, by):
    return n + np.array([0.0, by, 0.0])


def near(t_error=0.5, n_error=0.01):
    """Bounds of every primitive; the normal of primitive 1x is UP and of 2x is SIDE."""

    def at(owner, prim, t):
        count = len(owner)
        return SimpleNamespace(
            t_error=np.full(count, t_error),
            n_error=np.full(count, n_error),
            n=np.where((prim // 10 == 1)[:, None], UP, SIDE),
        )

    return at


TIE = answer_at((12, 2.0), (25, 2.0))


@pytest.mark.parametrize(
    ("exact", "given", "best", "of_first"),
    [
        (MISS, candidate([INF]), 0.0, True),
        (MISS, candidate([3.0]), INF, False),
        (None, candidate([INF]), INF, False),
        (TIE, candidate([INF]), INF, False),
        (TIE, candidate([2.0]), 0.0, True),
        (TIE, candidate([2.25]), 0.5, True),
        (TIE, candidate([1.5]), 1.0, True),
        (TIE, candidate([1.0]), 2.0, False),
        (TIE, candidate([1.0], t_rounding=0.5), 1.0, True),
        (TIE, candidate([1.0], t_rounding=np.array([1.5])), 0.5, True),
        (TIE, candidate([np.nan]), INF, False),
        (TIE, candidate([0.0], hits_only=True), 0.0, True),
        (TIE, candidate([2.0], [UP]), 0.0, True),
        (TIE, candidate([2.0], [SIDE]), 0.0, False),  # of the second member
        (TIE, candidate([2.25], [tilted(UP, 0.008)]), 0.8, True),
        (TIE, candidate([2.0], [tilted(UP, 0.02)]), 2.0, False),
        (TIE, candidate([2.0], [[0.6, 0.0, 0.8]]), np.hypot(0.6, 0.2) / 0.01, False),
        (TIE, candidate([2.25], shape_id=np.array([1])), 0.5, True),
        (TIE, candidate([2.25], shape_id=np.array([2])), 0.5, False),
        (TIE, candidate([2.25], shape_id=np.array([0])), INF, False),
        (TIE, candidate([2.25], prim_id=np.array([2])), 0.5, True),
        (TIE, candidate([2.25], prim_id=np.array([5])), 0.5, False),
        (TIE, candidate([2.25], shape_id=np.array([2]), prim_id=np.array([2])), INF, False),
    ],
)
def test_the_error_of_a_subject_is_that_at_the_member_that_fits_best(exact, given, best, of_first):
    """Beside a ray that misses, and one more of the same, so that rows are told apart."""
    twice = replace(
        given,
        **{
            name: np.concatenate([np.asarray(value), np.asarray(value)])
            for name in ("t", "n", "shape_id", "prim_id", "t_rounding")
            if isinstance(value := getattr(given, name), np.ndarray)
        },
    )
    found = ratios_of_any_tie([exact, exact], twice, near(), PACKED)
    expected = pytest.approx([best, best])
    assert found.best.tolist() == expected and found.of_first.tolist() == [of_first, of_first]


def test_a_normal_is_held_to_a_bound_that_means_something_and_t_to_one_that_there_is():
    found = ratios_of_any_tie([TIE], candidate([9.0], [tilted(UP, 0.125)]), near(INF, INF), PACKED)
    assert found.best.tolist() == [2.0]  # a sixteenth, at most
    assert ratios_of_any_tie([TIE], candidate([9.0]), near(INF), PACKED).best.tolist() == [0.0]


def test_what_a_subject_claims():
    prims = np.array([4, 5, 6, 7])
    given = candidate([1.0, INF, 2.0, 3.0], np.tile(UP, (4, 1)), prim_id=prims, t_rounding=0.25)
    claims = claims_of(given, PACKED)
    assert claims.shape.tolist() == [ANY_SHAPE, CLAIMED_MISS, ANY_SHAPE, ANY_SHAPE]
    assert claims.t.tolist() == [1.0, INF, 2.0, 3.0] and claims.prim is prims and claims.t_rounding == 0.25
    named = claims_of(replace(given, shape_id=np.array([0, 0, -1, 3]), n=None, hits_only=True), PACKED)
    assert named.shape.tolist() == [0, CLAIMED_MISS, 3, 3] and named.n is NOT_CLAIMED
    assert np.isnan(named.t).tolist() == [True, False, True, True] and named.t[1] == INF
    assert claims_of(replace(given, shape_id=np.array([2, 0, 1, 0])), PACKED).shape.tolist() == [2, -1, 1, 0] or (
        CLAIMED_MISS != -1
    )


OTHER_TIE = {
    "as it is": ({}, True),
    "another shape": ({"shape": 1}, False),
    "t within": ({"t": 2.0 + 0.24}, True),
    "t at its bound": ({"t": 2.0 + 0.25}, True),
    "t beyond": ({"t": 2.0 + 0.26}, False),
    "t before": ({"t": 2.0 - 0.26}, False),
    "n within": ({"n": tilted(SIDE, 0.009)}, True),
    "n beyond": ({"n": tilted(SIDE, 0.011)}, False),
    "sh_n within": ({"sh_n": tilted(UP, 0.019)}, True),
    "sh_n beyond": ({"sh_n": tilted(UP, 0.021)}, False),
    "p within": ({"p": np.array([2.0, 0.07, 0.0])}, True),
    "p at its bound": ({"p": np.array([2.0, 0.08, 0.0])}, True),
    "p beyond": ({"p": np.array([2.0, 0.09, 0.0])}, False),
    "no number": ({"n": SIDE * np.nan}, False),
}


@pytest.mark.parametrize("what", OTHER_TIE)
def test_a_claim_is_that_of_another_tie_within_its_bounds_there(monkeypatch, what):
    change, fits = OTHER_TIE[what]
    bounds = {"t_error": 0.25, "n_error": 0.01, "sh_error": 0.02, "p_error": 0.08}

    def claimed(closest=1.0, t=2.0, exact=2.0, answers=None, **errors) -> list[bool]:
        def nearest_root(met, at_t):
            assert at_t.tolist() == [exact] and met == "met"
            found = {name: np.array([value]) for name, value in (bounds | errors).items()}
            return SimpleNamespace(n=SIDE[None], sh_n=UP[None], **found)

        monkeypatch.setattr(adjudication, "nearest_root", nearest_root)
        asked = []
        model = SimpleNamespace(
            packed=PACKED, identical=None, intersect=lambda prim, *rest, **more: asked.append(prim.tolist()) or "met"
        )
        plain = {"t": t, "shape": 2, "n": SIDE, "sh_n": UP, "p": np.array([exact, 0.0, 0.0])} | change
        rows = {name: np.array([value, value]) for name, value in plain.items()}
        claims = Claims(rows["t"], rows["shape"], rows["n"], rows["sh_n"], rows["p"])
        o, d = np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0], (2, 1))
        given = [None, answer_at((12, exact), (25, exact))] if answers is None else answers
        found = claims_other_tie(model, o, d, claims, given, closest)
        assert asked in ([[25]], [])
        return found.tolist()

    assert claimed() == [False, fits]
    assert claimed(answers=[None, answer_at((25, 2.0))]) == [False, False]  # the first member is no other
    assert claimed(t_error=INF) == [False, False]
    if what == "n within" or what == "sh_n within":
        assert claimed(closest=0.005) == [False, False]
    if what == "as it is":
        assert claimed(closest=1e-9) == [False, True]
        assert claimed(t=0.0, exact=0.0) == [False, False] and claimed(t=-2.0, exact=-2.0) == [False, False]


# ---- aimed rays


@pytest.mark.parametrize(
    ("answer", "t", "prim", "bound", "kind", "ratio"),
    [
        (MISS, INF, -1, 0.5, "", 0.0),
        (MISS, 2.0, 7, 0.5, "phantom", 0.0),
        (HIT, INF, -1, 0.5, "missed", 0.0),
        (HIT, 2.0, 8, 0.5, "prim", 0.0),
        (HIT, 2.0, 7, 0.5, "", 0.0),
        (HIT, 2.5, 7, 0.5, "", 1.0),
        (HIT, 2.75, 7, 0.5, "t", 1.5),
        (HIT, 1.25, 7, 0.5, "t", 1.5),
        (HIT, 2.75, 7, INF, "", 0.0),
        (HIT, 2.75, 7, 0.0, "t", 0.0),
        (answer_at((7, INF)), LARGEST_FLOAT64, 7, 0.5, "", 0.0),
        (HIT, LARGEST_FLOAT64, 7, 0.5, "t", 0.0),
        (answer_at((7, LARGEST_FLOAT64)), LARGEST_FLOAT64, 7, 0.5, "", 0.0),
    ],
)
def test_an_aimed_ray_is_off_by_its_kind_of_error(answer, t, prim, bound, kind, ratio):
    found, words = discrepancy(answer, t, prim, bound)
    assert found == kind and bool(words) is bool(kind) and error_over_bound(answer, t, prim, bound) == ratio
    if kind == "phantom":
        assert words == "ours hits primitive 7 at t 2.0 (0x1.0000000000000p+1), exactly it is a miss"
    if kind == "missed":
        assert words == "ours misses, exactly primitive 7 (inside) is hit at t 2.0 (0x1.0000000000000p+1)"
    if kind == "t" and ratio == 1.5:
        assert words.endswith(": 0.75 off, bound 0.5")


def test_the_first_primitive_is_one_that_is_hit():
    """Its number is 0: no miss."""
    assert discrepancy(MISS, 2.0, 0, 0.5)[0] == "phantom" and discrepancy(HIT, 2.0, 0, 0.5)[0] == "prim"
    first = answer_at((0, 2.0))
    assert discrepancy(first, 2.0, 0, 0.5) == ("", "") and discrepancy(first, 2.75, 0, 0.5)[0] == "t"
    assert discrepancy(first, INF, -1, 0.5)[0] == "missed"


def batch(d, t_min=0.0, t_max=INF) -> RayBatch:
    d = np.atleast_2d(np.array(d, float))
    count = len(d)
    return RayBatch(np.zeros((count, 3)), d, np.full(count, float(t_min)), np.full(count, float(t_max)))


@pytest.mark.parametrize(
    ("d", "t_min", "t_max", "exponent"),
    [
        ([1.0, 0, 0], 0.0, INF, 1),
        ([0, -3.0, 2], 0.0, INF, 2),
        ([0.3, 0, -0.2], 1.0, 2.0, -1),
        ([1e-30, 0, 0], 1.0, 2.0, -99),
        ([1e30, 0, 1e-300], 0.0, INF, 0),  # bits of a small component would be lost
        ([1e30, 0, 0], 0.0, 1e300, 0),  # t_max would overflow
        ([1e30, 0, 0], 1e300, INF, 0),
        ([1e-30, 0, 0], 3e-310, 1.0, 0),  # t_min would lose bits
        ([1e-30, 0, 0], 0.0, 3e-310, 0),
        ([0, 0, 0], 0.0, INF, 0),
    ],
)  # fmt: skip
def test_directions_are_scaled_where_no_bit_is_lost(d, t_min, t_max, exponent):
    assert lossless_exponents(batch(d, t_min, t_max)).tolist() == [exponent]


def balls(*centers) -> Scene:
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    shapes = [caster.Sphere(center=center, radius=0.5) for center in centers]
    return Scene(film=caster.Film(width=4, height=4), camera=camera, shapes=shapes)


def test_t_counts_in_lengths_of_any_direction():
    numbers = packed(balls((2, 0, 0)))
    for power in (-1060, -500, -40, 0, 40, 500, 1000):
        rays = batch(np.ldexp([[1.0, 0.0, 0.0]], power))
        found = cast_by_culling(numbers, rays, "bvh")
        t = float(np.ldexp(1.5, -power)) if power > -1023 else INF
        assert found.prim.tolist() == [0] and (found.t[0] == t or t == INF)
    limits = batch([[3.0, 0, 0]] * 4)._replace(
        t_min=np.array([0.5, 0.4, 0.0, 0.9]), t_max=np.array([INF, INF, 0.4, INF])
    )
    found = cast_by_culling(numbers, limits, "brute-force")
    assert found.t.tolist() == pytest.approx([2.5 / 3.0, 0.5, INF, INF])


def test_limits_are_just_before_at_and_beyond_the_hit():
    rng = np.random.default_rng(4)
    count = 4000
    t = rng.uniform(0.5, 2.0, count)
    prim = np.where(np.arange(count) % 5 == 0, -1, 3)
    t[::10], t[1::10] = 0.0, INF
    rays = RayBatch(np.arange(3.0 * count).reshape(-1, 3), np.ones((count, 3)), np.zeros(count), np.zeros(count))
    found = with_limits(rng, rays, NearestHits(t, prim), count)
    row = (found.o[:, 0] / 3).astype(int)
    at = t[row]
    assert len(row) == len(set(row)) == ((prim >= 0) & (t > 0.0) & np.isfinite(t)).sum()
    before, after = np.nextafter(at, 0.0), np.nextafter(at, INF)
    starts = {"t": at, "before": before, "after": after, "half": 0.5 * at, "0": 0.0 * at}
    counts = {name: int((found.t_min == value).sum()) for name, value in starts.items()}
    assert sum(counts.values()) == len(row) and all(len(row) / 8 < n < len(row) / 2.5 for n in counts.values())
    ends = {"t": at, "before": before, "2t": 2.0 * at, "inf": INF + at}
    shares = {name: (found.t_max == value).mean() for name, value in ends.items()}
    assert sum(shares.values()) == 1.0 and min(shares.values()) > 0.1 and (found.t_max >= found.t_min).all()
    assert (found.t_max[found.t_min == 0.0] <= at[found.t_min == 0.0]).all()
    assert (found.t_max[found.t_min > 0.0] > at[found.t_min > 0.0]).any()
    late = (found.t_min == after) & np.isfinite(found.t_max)
    assert (found.t_max[late] == 2.0 * at[late]).all()
    assert len(with_limits(rng, rays, NearestHits(t, prim), 7).o) == 7


def test_numbers_are_moved_by_a_few_units_in_the_last_place():
    given = np.tile([1.0, -3.0, 1e300], (4000, 1))
    for ulps in (1, 2):
        moved = aimed.perturbed_by_ulps(np.random.default_rng(5), given, ulps)
        steps = (moved - given) / np.spacing(np.abs(given))
        found = set(np.unique(steps[:, 1:]))
        assert found == set(range(-ulps, ulps + 1)) and set(np.unique(steps[:, 0])) >= {0.0, 1.0, float(ulps)}


def test_a_lattice_is_of_eighths():
    points = np.array([[0.3, -0.31, 5.0], [0.1, 0.2, 0.27]])
    on = Setting(size=2.0, lattice=True).on_lattice(points)
    assert on.tolist() == [[0.25, -0.25, 5.0], [0.0, 0.25, 0.25]] and Setting().on_lattice(points) is points


CENTERS = ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 6.0, 2.0))
SETTING = Setting(size=2.0, center=(1.0, 1.0, 1.0))


def aim(name: str, count: int = 600):
    targets = Targets(packed(balls(*CENTERS)))
    return getattr(aimed, name)(np.random.default_rng(6), targets, SETTING, count)


def ball_of(p: np.ndarray) -> np.ndarray:
    """Which of the spheres each point lies on, up to the hundredth part of it that it may be beside; -1: none."""
    away = np.abs(np.linalg.norm(p[:, None] - np.array(CENTERS), axis=2) - 0.5)
    return np.where(away.min(axis=1) <= 0.0051, away.argmin(axis=1), -1)


def test_primitives_are_picked_of_every_shape_that_has_some():
    targets = Targets(packed(balls(*CENTERS)))
    targets.counts = np.array([5, 0, 2])
    picks = targets.pick(np.random.default_rng(7), 500)
    assert set(picks.shape) == {0, 2}
    assert set(picks.k[picks.shape == 0]) == set(range(5)) and set(picks.k[picks.shape == 2]) == {0, 1}


@pytest.mark.parametrize("name", ["at_features", "from_afar"])
def test_rays_are_aimed_at_points_of_surfaces_from_every_distance(name):
    o, d = aim(name)
    hit = ball_of(o + d)
    far = np.linalg.norm(d, axis=1) / SETTING.size
    if name == "from_afar":
        near_enough = np.linalg.norm(d, axis=1) < 1e6
        assert (hit[near_enough] >= 0).all() and 90.0 < far.min() < 300.0 and 1e7 < far.max() < 4e8
    else:  # directions of whole components are up to 5 long
        assert (hit >= 0).all() and 0.009 < far.min() < 0.03 and 10.0 < far.max() < 170.0
    assert set(hit) >= {0, 1, 2}


def test_tangents_touch_the_surface_and_come_from_either_side():
    o, d = aim("tangents")
    steps = (np.arange(-64, 65)[:, None] * [1.0, 0.25, 16.0]).reshape(-1, 1, 1)
    away = np.linalg.norm((o + steps * d)[:, :, None] - np.array(CENTERS), axis=3)
    close = np.abs(away.min(axis=(0, 2)) - 0.5) <= 0.03
    assert close.mean() > 0.95 and len(np.unique(np.round(o, 9), axis=0)) > 300


def test_chords_join_two_points_of_one_primitive_and_others_two_primitives():
    o, d = aim("through_two_points")
    on = [ball_of(o + step * d) for step in range(5)]
    chords = np.any([(a >= 0) & (a == b) for a, b in itertools.pairwise(on)], axis=0)
    assert chords.all()
    starts = [(a >= 0) & (a == b) for a, b in itertools.pairwise(on)]
    assert all(start.any() for start in starts)  # 0 to 3 lengths before the first point
    p, along = aim("between_two_points")
    first, second = ball_of(p), ball_of(p + along)
    assert (first >= 0).all() and (second >= 0).all() and (first != second).mean() > 0.5


def test_rays_from_a_surface_leave_it_every_way():
    o, d = aim("from_surface", 2000)
    on = ball_of(o)
    assert (on >= 0).all()
    n = o - np.array(CENTERS)[on]
    cosine = (n * d).sum(1) / np.linalg.norm(n, axis=1) / np.linalg.norm(d, axis=1)
    for low, high in ((0.999, 1.1), (-1.1, -0.999), (-1e-9, 1e-9)):
        assert 0.2 < ((cosine > low) & (cosine < high)).mean() < 0.35


def test_rays_along_axes_have_zeros_of_either_sign():
    o, d = aim("along_axes", 2000)
    zero = d == 0.0
    assert set(np.unique(np.abs(d))) == {0.0, 1.0, 2.0} and (~zero).any(axis=1).all()
    assert 0.3 < np.signbit(d)[zero].mean() < 0.7 and 0.5 < (zero.sum(axis=1) == 2).mean() < 0.9
    on = np.array([ball_of(o + steps * SETTING.size * d) for steps in range(5)])
    assert (on >= 0).any(axis=0).all() and ((on[0] < 0) & (on[4] >= 0)).any() and (on[0] >= 0).any()


def test_rays_from_anywhere_pass_insides_or_stray():
    o, d = aim("anywhere", 3000)
    assert np.allclose(o.mean(axis=0), SETTING.center, atol=0.4) and np.allclose(o.std(axis=0), 4.0, rtol=0.1)
    inside = (np.linalg.norm((o + d)[:, None] - np.array(CENTERS), axis=2) <= 0.51).any(axis=1)
    assert 0.45 < inside.mean() < 0.65


def test_directions_of_any_length_are_the_same_directions():
    plain = aim("at_features")
    targets = Targets(packed(balls(*CENTERS)))
    longer = aimed.of_any_length(aimed.at_features, 5)
    o, d = longer(np.random.default_rng(6), targets, SETTING, 600)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nanmax(d / plain[1], axis=1)
    assert np.array_equal(o, plain[0]) and set(np.log2(factor)) == set(range(-5, 6))


def test_aimed_rays_are_rays_and_some_of_them_unusual():
    targets = Targets(packed(balls(*CENTERS)))
    rays = aimed.aimed_rays(np.random.default_rng(8), targets, SETTING, 4000)
    assert np.isfinite(rays.o).all() and np.isfinite(rays.d).all() and rays.d.any(axis=1).all()
    assert (rays.t_min == 0.0).all() and (rays.t_max == INF).all() and len(rays.o) == 4000
    size = np.abs(rays.d).max(axis=1)
    assert 0.04 < ((size < 1e-6) | (size > 1e12)).mean() < 0.15
    denormal = (np.abs(rays.d) < 1e-29) & (rays.d != 0.0) & (size > 1e-6)[:, None]
    assert 0.03 < denormal.any(axis=1).mean() < 0.12
    one = aimed.aimed_rays(np.random.default_rng(8), targets, SETTING, 50, [aimed.at_features])
    assert (ball_of(one.o + one.d) >= 0).sum() > 25


def test_what_is_no_ray_is_replaced_by_one():
    bad = RayBatch(np.zeros((4, 3)), np.ones((4, 3)), np.zeros(4), np.zeros(4))
    bad.o[0, 1], bad.d[1, 2], bad.d[2] = np.nan, INF, 0.0
    found = aimed.finite_rays(bad)
    assert found.o[:3].tolist() == [[0.0, 0.0, -3.0]] * 3 and found.d[:3].tolist() == [[0.0, 0.0, 1.0]] * 3
    assert found.o[3].tolist() == [0.0] * 3 and found.d[3].tolist() == [1.0] * 3 and np.isnan(bad.o[0, 1])


# ---- outlines and thresholds of the diagnosis


def test_the_distance_from_an_outline_is_that_from_the_nearest_point_of_it():
    rng = np.random.default_rng(9)
    corners = rng.normal(size=(40, 3, 3))
    p = rng.normal(size=3)
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    expected = [
        min(
            np.linalg.norm(a + along * (b - a) - p, axis=1).min()
            for a, b in zip(each, np.roll(each, -1, 0), strict=True)
        )
        for each in corners
    ]
    assert diagnosis._outline_distances(p, corners) == pytest.approx(expected, rel=1e-4)
    assert diagnosis._outline_distances(np.tile(p, (40, 1)), corners) == pytest.approx(expected, rel=1e-4)
    point = np.ones((1, 3, 3))
    assert diagnosis._outline_distances(np.array([1.0, 1.0, 3.0]), point).tolist() == [2.0]


def test_a_point_is_inside_of_a_triangle_where_its_weights_are_not_negative():
    rng = np.random.default_rng(10)
    corners = rng.normal(size=(300, 3, 3))
    n = diagnosis._face_normals(corners)
    assert np.linalg.norm(n, axis=1) == pytest.approx(np.ones(300))
    p = np.array([0.1, -0.2, 0.05])
    expected = []
    for a, b, c in corners:
        weights = np.linalg.solve(np.column_stack([b - a, c - a, np.cross(b - a, c - a)]), p - a)[:2]
        expected.append(bool((weights >= 0.0).all() and weights.sum() <= 1.0))
    assert diagnosis._is_inside(p, corners).tolist() == expected and 10 < sum(expected) < 290
    assert np.abs((n * (corners[:, 2] - corners[:, 0])).sum(1)).max() < 1e-12


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(-1.0, 2.0, 0.0), (0.9, 1.2, 1.0), (9e-7, 1.2e-6, 1e-6), (3.14, 3.15, 3.145), (0.0, 1e-3, 5e-4),
     (1.0, np.nextafter(1.0, 2.0), np.nextafter(1.0, 2.0)), (-2.0, -1.4, -1.7), (15.0, 26.0, 20.0)],
)  # fmt: skip
def test_a_threshold_has_few_digits(low, high, expected):
    assert diagnosis._simplest_between(low, high) == expected


def test_more_than_chance_is_by_hoeffdings_bound():
    """k of j on one side, of m wrong among n: exp(-j KL(k / j || m / n)) times the tries, below 1e-6."""
    assert diagnosis._log_ratio(0.0, 0.5) == 0.0
    assert diagnosis._log_ratio(0.5, 0.25) == pytest.approx(0.5 * np.log(2.0))
    for k, j, m, n, tried in ((20, 20, 20, 200, 1), (6, 6, 20, 200, 1), (10, 20, 20, 200, 3), (0, 0, 5, 50, 1)):
        p, q = k / max(j, 1), m / n
        kl = sum(a * np.log(a / b) for a, b in ((p, q), (1 - p, 1 - q)) if a > 0.0)
        assert diagnosis._is_significant(k, j, m, n, tried) is bool(tried * np.exp(-j * kl) < 1e-6)


def test_a_row_has_its_first_cause_and_every_second_one():
    rows = np.array([3, 5])
    found = Diagnosis((Cause("b", rows[:1], second=True), Cause("a", rows), Cause("c", rows, second=True)))
    assert found.by_row() == {3: "a; and b; and c", 5: "a; and c"}
    assert {what: each.tolist() for what, each in found.rows_of.items()} == {"a": [3, 5]}


# ---- verdicts


def scene_with(counts=None, **more) -> SceneVerdict:
    return SceneVerdict("name", "path", counts=dict.fromkeys(CLASSES, 0) | (counts or {"agree": 9}), **more)


GOOD, BAD = SceneCheck("good", 1.0, ""), SceneCheck("bad", 1.0000001, "")


@pytest.mark.parametrize(
    ("verdict", "ok", "failing", "evidence", "excused"),
    [
        (scene_with(), True, 0, 9, 0),
        (scene_with({"agree": 0}), False, 0, 0, 0),
        (scene_with(problem="a crash"), False, 0, 9, 0),
        (scene_with({"agree": 99, "wrong": 1}), False, 1, 99, 0),
        (scene_with({"agree": 99, "undecided": 2}), False, 2, 99, 0),
        (scene_with({"agree": 99, "reference_wrong": 2}, cases={"unlisted": 2, "8": 5}), False, 2, 99, 2),
        (scene_with({"agree": 99, "reference_wrong": 2}, cases={"8": 2}), True, 0, 99, 2),
        (scene_with({"tie": 3, "explained": 1, "out_of_domain": 1}), True, 0, 3, 2),
        (scene_with({"agree": 1, "tie": 1, "explained": 1, "reference_wrong": 1}), False, 0, 2, 2),
        (scene_with({"agree": 1, "out_of_domain": 2}), False, 0, 1, 2),
        (scene_with(checks=(GOOD,)), True, 0, 9, 0),
        (scene_with(checks=(GOOD, BAD)), False, 0, 9, 0),
        (scene_with(checks=(SceneCheck("nan", np.nan, ""),)), False, 0, 9, 0),
    ],
)
def test_a_scene_passes_by_evidence_alone(verdict, ok, failing, evidence, excused):
    assert (verdict.ok, verdict.failing, verdict.evidence, verdict.excused) == (ok, failing, evidence, excused)
    assert verdict.to_dict()["ok"] is ok


PASSED, FAILED = verdict_factory.scene("a"), verdict_factory.scene("b", ok=False)
DECLINED = replace(verdict_factory.scene("c", problem="declined"), waived="unsupported")
EXPECTED = replace(FAILED, waived="expected")


@pytest.mark.parametrize(
    ("verdict", "ok"),
    [
        (Verdict((PASSED,)), True),
        (Verdict((), 0), False),
        (Verdict((), 0, shard="1/2", selected=("a",)), True),
        (Verdict((), 0, shard="1/2"), False),
        (Verdict((PASSED,), 2), False),
        (Verdict((PASSED, FAILED), 2), False),
        (Verdict((PASSED, EXPECTED), 2), True),
        (Verdict((PASSED, DECLINED), 2), True),
        (Verdict((DECLINED,), 1), False),
        (Verdict((DECLINED,), 1, shard="1/2", selected=("c",)), True),
        (Verdict((PASSED, DECLINED), 2, min_scenes=1), True),
        (Verdict((PASSED, DECLINED), 2, min_scenes=2), False),
        (Verdict((PASSED, PASSED), 2, min_scenes=2), True),
        (Verdict((EXPECTED,), 1, min_scenes=1), True),
    ],
)
def test_a_run_passes_where_every_scene_does_or_is_waived(verdict, ok):
    assert verdict.ok is ok
    assert (exit_code(verdict, ()) == OK) is ok


def test_a_run_adds_up_its_scenes():
    run = Verdict(
        (replace(PASSED, adjudicated=3, cases={"8": 2}), replace(EXPECTED, adjudicated=4, cases={"8": 1, "9": 5})), 2
    )
    assert run.counts["agree"] == 199 and run.counts["wrong"] == 1 and run.adjudicated == 7
    assert run.cases == {"8": 3, "9": 5} and run.waived == {"expected": 1}
    assert replace(run, names=("a", "b", "z")).not_judged == ("z",) and run.candidate == ""
    assert replace(run, requested_candidate="mine").candidate == "mine"
    stored = replace(PASSED, reference_stored=True)
    kept = Verdict((stored, PASSED, stored), 3)
    said = "2 of 3 scenes: answered in earlier runs, taken from the store"
    assert kept.references_stored == 2 and any(said in each for each in kept.versions)
    assert not any("earlier runs" in each for each in Verdict((PASSED,)).versions)


def test_a_place_is_a_pixel_or_a_ray_of_its_list():
    rays = scene_with(rays=(100, 140), size=(8, 5))
    assert rays.ray_at(3, 2) == 119 and rays.place(3, 2) == "ray 119"
    assert scene_with(size=(8, 5)).ray_at(3, 2) is None and scene_with().place(3, 2) == "(3, 2)"
    for ratios in ({"a": 0.5, "b": 0.75}, {"b": 0.75, "a": 0.5}, {"b": 0.5, "a": 0.75}):
        assert scene_with(ratios=ratios).worst == max(ratios.items(), key=lambda each: each[1])
    assert scene_with().worst == ("", 0.0)


def test_a_verdict_of_which_nothing_is_known_claims_nothing():
    record = SceneVerdict("name", "path").to_dict()
    named = {"name": "name", "path": "path", "command": "validate"}
    counts = dict.fromkeys(CLASSES, 0)
    nothing = (0, 0.0, "", [], {}, False, None, [0, 0], {"camera": "", "shapes": {}, "primitives": 0})
    for field, value in record.items():
        assert value == named[field] if field in named else value in nothing or value == counts, field
    assert record["ok"] is False and record["counts"] == counts


def test_a_finding_states_its_cause_with_remedy_or_place():
    plain = Finding(3, "what", 1, 2)
    assert (plain.text, replace(plain, where="where x").text) == ("what", "what; where x")
    said = replace(plain, remedy="mend it", of=5, where="where x").text
    assert said == "what: 3 of 5 wrong pixels become right under it; mend it"


def test_windows_are_added_up_and_the_worst_of_each_is_kept():
    one, two = FAILED, verdict_factory.scene("b", ok=False)
    worse = replace(two.failures[0], ratio=50.0, x=9, reason="another")
    two = replace(
        two,
        failures=(worse, replace(worse, ratio=np.nan)),
        worst_by={"depth": worse},
        checks=(SceneCheck("camera", np.nan, "nan"), SceneCheck("more", 0.5, "")),
        ratios={"depth": 0.5, "normal": 0.125},
        findings=(Finding(4, "x", 1, 1, 6), Finding(1, "y", 2, 2)),
        adjudicated=5, not_adjudicated=2, not_stored=1, exact_seconds=0.5, seconds=2.0, reference_seconds=4.0,
        cases={"8": 2}, failing_by={"depth": 3}, reproducers=("f",), notes=("n", "m"), reference_stored=True,
    )  # fmt: skip
    one = replace(
        one,
        worst_by={"depth": one.failures[0], "uv": one.failures[0]},
        findings=(Finding(2, "x", 0, 3, 6),),
        adjudicated=1, not_adjudicated=1, not_stored=1, exact_seconds=0.25, reference_seconds=1.0,
        cases={"8": 1, "9": 1}, failing_by={"depth": 1, "uv": 1}, reproducers=("e",), notes=("n",),
    )  # fmt: skip
    found = merge_windows([one, two])
    assert (found.pixels, found.hit_pixels, found.counts["agree"], found.counts["wrong"]) == (240, 200, 198, 2)
    assert found.ratios == {"depth": 0.5, "normal": 0.125} and not found.reference_stored
    assert [(check.name, check.what) for check in found.checks] == [("camera", "nan"), ("more", "")]
    assert [(each.reason, each.x) for each in found.failures[:2]] == [
        ("ours is not the exact answer", 3),
        ("another", 9),
    ]
    assert len(found.failures) == 3 and found.worst_by["depth"] == worse and found.worst_by["uv"].x == 3
    assert (found.adjudicated, found.not_adjudicated, found.not_stored) == (6, 3, 2)
    assert (found.seconds, found.reference_seconds, found.exact_seconds) == (3.25, 5.0, 0.75)
    assert found.cases == {"8": 3, "9": 1} and found.failing_by == {"depth": 4, "uv": 1}
    assert found.reproducers == ("e", "f") and found.notes == ("n", "m")
    assert [(each.what, each.pixels, each.of, each.x) for each in found.findings] == [("x", 6, 12, 0), ("y", 1, 0, 2)]
    assert merge_windows([one, replace(two, problem="p")]).problem == "p" and found.problem == ""


WINDOW_FAULTS = {
    "a check": lambda checks: {"checks": (checks[0], replace(checks[1], ratio=2.0))},
    "a check without a number": lambda checks: {"checks": (checks[0], replace(checks[1], ratio=np.nan))},
    "a check that others lack": lambda checks: {"checks": (*checks, SceneCheck("placement", np.inf, ""))},
    "a pixel": lambda checks: {"counts": PASSED.counts | {"undecided": 1}},
    "an unknown error of Mitsuba": lambda checks: {"cases": {UNLISTED: 1}},
    "no comparison": lambda checks: {"problem": "killed"},
}


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("fault", WINDOW_FAULTS)
def test_a_film_passes_only_where_each_of_its_windows_does(fault, place):
    checks = SceneCheck("camera", 0.5, ""), SceneCheck("culling", 0.0, "")
    windows = [replace(PASSED, checks=checks)] * 3
    assert merge_windows(windows).ok
    windows[place] = replace(windows[place], **WINDOW_FAULTS[fault](checks))
    assert not windows[place].ok and not merge_windows(windows).ok
