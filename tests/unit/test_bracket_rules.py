"""The rules of the bracket, ray by ray in plain Python, on made intersections whose numbers often meet their limits.

docs/method.md, "Visibility", states the rules. t, errors and limits are whole multiples of 1/2, and often equal: what
lies exactly on a bound is within it.
"""

import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from mitsuba_ref.error_model.bracket import (
    ANY_SHAPE,
    CLAIMED_MISS,
    NOT_CLAIMED,
    Bracket,
    Claims,
    latest_hits,
    near_ray_start,
)
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.error_model.scene_model import PairIntersections, no_intersections, with_edges

INF, NAN = math.inf, math.nan
FIRST = [0, 3, 4, 7]  # of three shapes
SHAPE_OF = [0, 0, 0, 1, 2, 2, 2]
IDENTICAL = [0, 0, 2, 3, 4, 5, 4]  # 1 has the bits of 0, 6 those of 4
EDGES = ((0.0, 0, 0, 1, 0, 0), (0.0, 0, 0, 0, 1, 0), (-0.0, 0, 0, 1, -0.0, 0))
RAYS = 600


class Met(NamedTuple):
    """One intersection of one ray, as the error model gives it."""

    prim: int
    t: float
    t_error: float
    n: tuple[float, float, float]
    n_error: float
    sh_n: tuple[float, float, float]
    sh_error: float
    possible: bool
    certain: bool
    p_error: float
    uv: tuple[float, float, float]
    uv_error: float
    edge: tuple[float, ...]
    side: float


class Made:
    """A scene model with these intersections of each ray; the number of a ray is the x of its origin."""

    def __init__(self, met: list[list[Met]], identical: list[int] | None, beside: tuple[int, ...] = ()) -> None:
        """beside: primitives whose boxes no ray passes."""
        self.met, self.identical = met, None if identical is None else np.array(identical)
        self.beside = beside
        shape_of, first = np.array(SHAPE_OF), np.array(FIRST)
        self.packed = SimpleNamespace(
            first=first,
            shape_of=lambda prim: np.where(prim < 0, -1, shape_of[prim]),
            index_in_shape=lambda prim: prim - first[shape_of[prim]],
        )
        self.distinct = self.nearby = self

    def pairs(self, o: np.ndarray, d: np.ndarray) -> Any:
        """In pieces of seven rays."""
        for start in range(0, len(o), 7):
            rows = [(i, prim) for i in range(start, min(start + 7, len(o)))
                    for prim in sorted({each.prim for each in self.met[int(o[i, 0])]} - {*self.beside})]  # fmt: skip
            yield np.array(rows, int).reshape(-1, 2).T

    def intersect(self, prim: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float, *, ours: bool) -> Any:
        assert (ku, ours) == (0.25, True)
        found = [(i, each) for i, number in enumerate(prim) for each in self.met[int(o[i, 0])] if each.prim == number]
        pair = np.array([i for i, _ in found], int)
        columns = zip(*(each[1:] for _, each in found), strict=True) if found else [()] * 13
        arrays = [np.array(column) for column in columns]
        for place, width in ((2, 3), (4, 3), (9, 3), (11, 6)):
            arrays[place] = arrays[place].reshape(-1, width).astype(float)
        for place in (6, 7):
            arrays[place] = arrays[place].astype(bool)
        return PairIntersections(pair, Intersections(*arrays))

    def has_twins(self, prim: np.ndarray) -> np.ndarray:
        if self.identical is None:
            return np.zeros(len(prim), bool)
        return np.array([(self.identical == self.identical[each]).sum() > 1 for each in prim], bool)

    def uv_points(self, prim: np.ndarray, uv: np.ndarray, *, ours: bool) -> np.ndarray:
        assert ours
        return np.column_stack([uv, prim])


def some(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
ERRORS = (0.0, 0.5, 1.0, 1.0, INF)


def made_ray(rng: np.random.Generator) -> list[Met]:
    """Up to four intersections; half of them hang on one of two edges, from either side."""
    found = []
    for _ in range(int(rng.integers(0, 5))):
        side = float(some(rng, (0, 0, -1, 1)))
        prim = int(some(rng, (0, 2, 3, 4, 5)))
        uv = (*(float(x) for x in rng.integers(0, 2, 2)), float(prim))
        found.append(
            Met(
                prim, some(rng, (0.5, 1.0, 1.5, 2.0, 3.0, NAN)),
                some(rng, (0.0, 0.5, 0.5, 1.0, INF) if side else (0.0, 0.5, 0.5, 1.0, NAN)),
                some(rng, AXES), some(rng, ERRORS), some(rng, AXES), some(rng, ERRORS),
                bool(rng.random() < 0.8), bool(rng.random() < 0.4), some(rng, (0.0, 1.0, 1.0, INF)),
                uv, some(rng, ERRORS), some(rng, EDGES) if side else (NAN,) * 6, side,
            )
        )  # fmt: skip
    return found


def in_range(met: list[Met], t_min: float, t_max: float) -> list[Met]:
    """Possible, and not certainly before the least or beyond the largest t; without an error all along the ray."""
    kept = []
    for each in met:
        error = each.t_error if math.isfinite(each.t_error) else INF
        if each.possible and not math.isnan(each.t) and each.t + error >= t_min and each.t - error <= t_max:
            kept.append(each)
    return kept


def latest_of(met: list[Met], t_min: float, t_max: float) -> list[float]:
    """By when each is hit for certain: by itself, or together with one on the other side of the edge it hangs on."""
    found = []
    for each in met:
        together = [other for other in met if other.side and other.edge == each.edge]
        if not (each.t - each.t_error > t_min and each.t + each.t_error <= t_max):
            found.append(INF)
        elif each.certain:
            found.append(each.t + each.t_error)
        elif each.side and {other.side for other in together} == {-1.0, 1.0}:
            ends = [other.t + other.t_error for other in together]
            found.append(NAN if any(map(math.isnan, ends)) else max(ends))
        else:
            found.append(INF)
    return found


def is_near(a: Any, b: Any, error: float) -> bool:
    return math.dist(a, b) <= error


class Claim(NamedTuple):
    """What is claimed of one ray."""

    t: float
    shape: int
    n: tuple[float, float, float]
    sh_n: tuple[float, float, float]
    p: tuple[float, float, float]
    rounding: float
    prim: int
    uv: tuple[float, float]


def verdict(met: list[Met], claim: Claim, line: Any, said: set[str], identical: list[int] | None) -> tuple[bool, bool]:
    """(allowed, open) of one ray by the rules. line: o, d, t_min, t_max; said: which parts are claimed at all."""
    o, d, t_min, t_max = line
    met = in_range(met, t_min, t_max)
    if not met:
        return claim.shape == CLAIMED_MISS, False
    latest = min(latest_of(met, t_min, t_max))
    allowed = is_open = False
    for each in met:
        shape = SHAPE_OF[each.prim]
        named = claim.shape in (ANY_SHAPE, shape)
        if "prim" in said:
            number = FIRST[shape] + claim.prim
            within = claim.prim >= 0 and number < FIRST[shape + 1]
            same = (
                number == each.prim if identical is None else identical[number] == identical[each.prim] if within else 0
            )
            named = named and within and bool(same)
        named = named and (math.isnan(claim.t) or claim.t <= latest + claim.rounding)
        named = named and ("n" not in said or is_near(claim.n, each.n, each.n_error))
        is_open = is_open or (named and not math.isfinite(each.t_error))
        at_t = math.isnan(claim.t) or (
            math.isfinite(each.t_error) and abs(claim.t - each.t) <= each.t_error + claim.rounding
        )
        p = [a + each.t * b for a, b in zip(o, d, strict=True)]
        fits = "sh_n" not in said or is_near(claim.sh_n, each.sh_n, each.sh_error)
        fits = fits and ("p" not in said or is_near(claim.p, p, each.p_error))
        fits = fits and ("uv" not in said or is_near((*claim.uv, each.prim), each.uv, each.uv_error))
        allowed = allowed or (named and at_t and fits)
    return (latest == INF if claim.shape == CLAIMED_MISS else allowed), is_open


def made_lines(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Along z, at the z of 1; t_min and t_max on the lattice."""
    o = np.column_stack([np.arange(RAYS), np.zeros(RAYS), np.ones(RAYS)])
    d = np.tile([0.0, 0.0, 2.0], (RAYS, 1))
    t_min, t_max = rng.choice([0.0, 0.0, 0.5, 1.0], RAYS), rng.choice([INF, 1.5, 2.0, 3.0], RAYS)
    return o, d, t_min, t_max


PARTS = [set(), {"n"}, {"p", "sh_n"}, {"prim"}, {"uv"}, {"n", "sh_n", "p", "prim", "uv"}]


@pytest.mark.parametrize("identical", [None, IDENTICAL], ids=["all differ", "some are identical"])
@pytest.mark.parametrize("said", PARTS, ids=lambda said: "+".join(sorted(said)) or "t")
def test_a_claim_is_allowed_or_open_by_the_rules(said, identical):
    rng = np.random.default_rng([7, PARTS.index(said)])
    met = [made_ray(rng) for _ in range(RAYS)]
    o, d, t_min, t_max = made_lines(rng)
    claims = []
    for i, row in enumerate(met):
        like = some(rng, row) if row and rng.random() < 0.8 else None
        t, shape = (like.t, SHAPE_OF[like.prim]) if like else (some(rng, (INF, 1.0)), some(rng, (-1, -1, 0)))
        t = t if math.isfinite(t) or not like else 1.0
        t = NAN if rng.random() < 0.1 else t + some(rng, (0.0, 0.0, 0.0, 0.5, -0.5, 1.0))
        shape = some(rng, (shape, shape, shape, ANY_SHAPE, 1)) if like else shape
        t = INF if shape == CLAIMED_MISS else t
        number = like.prim - FIRST[SHAPE_OF[like.prim]] if like else 0
        z = 1.0 + 2.0 * (like.t if like and math.isfinite(like.t) else 0.0)
        claims.append(
            Claim(
                t, shape, like.n if like and rng.random() < 0.7 else some(rng, AXES),
                like.sh_n if like and rng.random() < 0.7 else some(rng, AXES),
                (float(i), some(rng, (0.0, 0.0, 1.0)), z), some(rng, (0.0, 0.0, 0.5)),
                some(rng, (number, number, number, -1, 1, 3)),
                like.uv[:2] if like and rng.random() < 0.7 else (1.0, 0.0),
            )
        )  # fmt: skip
    columns = {name: np.array([getattr(claim, name) for claim in claims]) for name in Claim._fields}
    given = Claims(
        columns["t"], columns["shape"],
        *(columns[name] if name in said else NOT_CLAIMED for name in ("n", "sh_n", "p")),
        columns["rounding"], columns["prim"] if "prim" in said else None,
        columns["uv"] if "uv" in said else NOT_CLAIMED,
    )  # fmt: skip
    found = Bracket(Made(met, identical), 0.25, ours=True).judge(o, d, t_max, given, t_min=t_min)
    expected = [
        verdict(row, claim, (o[i], d[i], t_min[i], t_max[i]), said, identical)
        for i, (row, claim) in enumerate(zip(met, claims, strict=True))
    ]
    wrong = [i for i in range(RAYS) if (bool(found.allowed[i]), bool(found.open[i])) != expected[i]]
    assert not wrong, (met[wrong[0]], claims[wrong[0]], t_min[wrong[0]], t_max[wrong[0]], expected[wrong[0]])
    assert 0.05 < np.mean([allowed for allowed, _ in expected]) < 0.95 and any(is_open for _, is_open in expected)


def test_a_primitive_beside_the_ray_counts_where_it_is_named():
    rng = np.random.default_rng(12)
    met = [made_ray(rng) for _ in range(RAYS)]
    o, d, t_min, t_max = made_lines(rng)
    also = rng.choice([-1, 0, 4, 5], RAYS)
    claims = Claims(rng.choice([1.0, 2.0, INF], RAYS), rng.choice([ANY_SHAPE, 2, CLAIMED_MISS], RAYS), NOT_CLAIMED)
    claims.t[claims.shape == CLAIMED_MISS] = INF
    for named in (also, np.full(RAYS, -1)):
        model = Made(met, None, beside=(0, 4, 5))
        found = Bracket(model, 0.25, ours=True).judge(o, d, t_max, claims, t_min=t_min, also=named)
        for i, row in enumerate(met):
            looked_at = [each for each in row if each.prim not in model.beside or each.prim == named[i]]
            claim = Claim(claims.t[i], claims.shape[i], *[AXES[0]] * 3, 0.0, 0, (0.0, 0.0))
            expected = verdict(looked_at, claim, (o[i], d[i], t_min[i], t_max[i]), set(), None)
            assert (bool(found.allowed[i]), bool(found.open[i])) == expected, (row, claim, named[i])


def arrays_of(met: list[list[Met]]) -> Any:
    """All intersections of all rays, as the bracket holds them."""
    model = Made(met, None)
    o = np.column_stack([np.arange(len(met)), np.zeros((len(met), 2))]).astype(float)
    return Bracket(model, 0.25, ours=True).possible_hits(o, o + 1.0, np.full(len(met), INF))


def test_possible_hits_are_those_that_are_possible_and_in_range():
    rng = np.random.default_rng(8)
    met = [made_ray(rng) for _ in range(300)]
    o, d, t_min, t_max = (a[:300] for a in made_lines(rng))
    found = Bracket(Made(met, None), 0.25, ours=True).possible_hits(o, d, t_max, t_min)
    for i, row in enumerate(met):
        kept = sorted((each.prim, each.t, each.p_error) for each in in_range(row, t_min[i], t_max[i]))
        rows = np.flatnonzero(found.ray == i)
        assert sorted(zip(found.prim[rows], found.at.t[rows], found.at.p_error[rows], strict=True)) == kept
    empty = Bracket(Made([], None), 0.25, ours=True).possible_hits(o[:0], d[:0], t_max[:0])
    assert len(empty.ray) == len(empty.prim) == len(empty.at.t) == 0


@pytest.mark.parametrize("begins", [False, True])
def test_the_latest_t_of_a_hit_is_that_of_the_one_or_of_both_faces_of_an_edge(begins):
    rng = np.random.default_rng(9)
    met = [made_ray(rng) for _ in range(RAYS)]
    _, _, t_min, t_max = made_lines(rng)
    found = arrays_of(met)
    latest = latest_hits(found, t_max, t_min if begins else None)
    for i, row in enumerate(met):
        kept = [each for each in row if each.possible and not math.isnan(each.t)]
        rows = np.flatnonzero(found.ray == i)
        order = [kept[j].prim for j in np.argsort([each.prim for each in kept], kind="stable")]
        assert found.prim[rows].tolist() == order
        kept.sort(key=lambda each: each.prim)
        expected = latest_of(kept, t_min[i] if begins else 0.0, t_max[i])
        assert np.array_equal(latest[rows], expected, equal_nan=True), (kept, t_min[i], t_max[i])
    assert 0.1 < np.isfinite(latest).mean() < 0.9


def starts_near(each: Met, d: Any, off: float) -> bool:
    """Whether a surface is no farther from a ray's start than that may be off; near an exact start is nothing."""
    height = (abs(each.t) - each.t_error) * abs(math.fsum(a * b for a, b in zip(each.n, d, strict=True)))
    return off > 0.0 and not height > off


@pytest.mark.parametrize("identical", [None, IDENTICAL], ids=["all differ", "some are identical"])
@pytest.mark.parametrize("leaves", [False, True])
def test_a_shadow_ray_is_blocked_possibly_or_certainly_by_the_rules(leaves, identical):
    """The surface that it leaves does not count at its start, and what is as near as that is not certain."""
    rng = np.random.default_rng(10)
    met = [made_ray(rng) for _ in range(RAYS)]
    o, d, _, t_max = made_lines(rng)
    prim, off = rng.choice([0, 2, 3, 4, 5, -1], RAYS), rng.choice([0.0, 1.0, 2.0, 3.0], RAYS)
    leaving = (prim, off) if leaves else None
    possible, certain = Bracket(Made(met, identical), 0.25, ours=True).blocked(o, d, t_max, leaving)
    for i, row in enumerate(met):
        kept = []
        for each in in_range(row, 0.0, t_max[i]):
            near = leaves and starts_near(each, d[i], off[i])
            alone = identical is None or identical.count(identical[each.prim]) == 1
            if not (near and each.prim == prim[i] and alone):
                kept.append((each, near))
        latest = latest_of([each for each, _ in kept], 0.0, t_max[i])
        sure = any(math.isfinite(t) and not near for t, (_, near) in zip(latest, kept, strict=True))
        assert (bool(possible[i]), bool(certain[i])) == (bool(kept), sure), (row, prim[i], off[i], t_max[i])
    assert 0.1 < possible.mean() < 0.9 and 0.05 < certain.mean() < 0.9


def test_a_surface_at_the_height_that_a_start_may_be_off_is_near_it():
    rng = np.random.default_rng(11)
    met = [made_ray(rng) for _ in range(400)]
    found, d, off = arrays_of(met), np.tile([0.0, 1.0, 2.0], (400, 1)), rng.choice([0.0, 0.5, 1.0, 2.0], 400)
    near = near_ray_start(found, d, off)
    rows = zip(*(a.tolist() for a in (found.ray, found.at.t, found.at.t_error, found.at.n)), strict=True)
    blank = Met(0, 0, 0, (0, 0, 0), 0, (0, 0, 0), 0, True, True, 0, (0, 0, 0), 0, (), 0)
    expected = [starts_near(blank._replace(t=t, t_error=e, n=n), d[i].tolist(), off[i]) for i, t, e, n in rows]
    assert near.tolist() == expected and 0.1 < np.mean(expected) < 0.9


def test_no_intersections_are_the_arrays_of_some_without_their_rows():
    one, three = np.ones(1), np.ones((1, 3))
    flag = np.ones(1, bool)
    some = with_edges(
        Intersections(one, one, three, one, three, one, flag, flag, one, three, one, edge=None, side=None)
    )
    for mine, theirs in zip(no_intersections(), some, strict=True):
        assert len(mine) == 0 and mine.shape[1:] == theirs.shape[1:] and mine.dtype == theirs.dtype
