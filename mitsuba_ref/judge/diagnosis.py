"""Diagnosis of failing pixels: causes, each with its pixels and a property that separates them from right ones.

It describes pixels that fail; it never decides whether a pixel passes.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from mitsuba_ref.error_model.intersections import dot, norm, unit
from mitsuba_ref.error_model.tolerances import (
    DISTINCT_RTOL,
    FIT_FACTOR,
    KU,
    MAJORITY,
    MIN_FITTED_PIXELS,
    NEARLY_ALL,
    SEPARATES,
    SEPARATOR_CHANCE,
)
from mitsuba_ref.judge.adjudication import sample_rows
from mitsuba_ref.judge.checks.shapes import unrounded_arrays
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.explanations import open_reason, subject_name
from mitsuba_ref.judge.hypotheses import (
    RIGHT_PIXELS,
    Explanation,
    Mistake,
    WrongPixels,
    area_vectors,
    explain_normals,
    explanations,
    range_text,
    triangle_corners,
)
from mitsuba_ref.judge.verdict import FAILING, REFERENCE_WRONG, UNDECIDED, WRONG
from mitsuba_ref.shapes import kind_of

NOT_ADJUDICATED = "not adjudicated: like others, of which exact arithmetic found nearly all to be wrong"
MAX_DIAGNOSED_PIXELS = 4096  # wrong pixels at which the table of mistakes is tried


@dataclass(frozen=True)
class Cause:
    """The cause of some failing rows of the image."""

    what: str
    rows: np.ndarray  # ascending
    of: int = 0  # wrong pixels among which it was looked for; 0: a description
    remedy: str = ""  # of a mistake that explains the rows
    where: str = ""  # a property that separates these pixels from right ones
    second: bool = False  # independent of another cause of the same rows


@dataclass(frozen=True)
class Diagnosis:
    """All causes; each failing row has exactly one that is not `second`."""

    causes: tuple[Cause, ...]

    @cached_property
    def rows_of(self) -> Mapping[str, np.ndarray]:
        """The rows of each first cause."""
        return {cause.what: cause.rows for cause in self.causes if not cause.second}

    def by_row(self) -> dict[int, str]:
        """The sentence about each row."""
        found: dict[int, str] = {}
        for cause in sorted(self.causes, key=lambda cause: cause.second):
            for row in map(int, cause.rows):
                found[row] = f"{found[row]}; and {cause.what}" if cause.second else cause.what
        return found


def failing_rows(judgement: Judgement) -> np.ndarray:
    """Rows of the image that fail by their class, or because the reference is wrong in an unknown way; ascending."""
    unlisted = np.array([row for row, case in judgement.cases.items() if case is None], np.int64)
    return np.union1d(np.flatnonzero(judgement.is_class(*FAILING)), unlisted)


class _Causes:
    """Collects causes; a row belongs to the first cause that takes it."""

    def __init__(self, judge: Judge, judgement: Judgement):
        self.judge, self.judgement = judge, judgement
        self.found: dict[str, Cause] = {}
        self.seconds: list[Cause] = []
        self.left = np.zeros(len(judge.t_max), bool)
        self.left[failing_rows(judgement)] = True

    def take(self, what: str, rows: np.ndarray, of: int = 0, remedy: str = "", *, where: bool = False) -> None:
        """Assign a cause to the rows that have none yet. where: look for a separator."""
        mine = rows[self.left[rows]]
        if not len(mine):
            return
        before = self.found.get(what, Cause(what, np.zeros(0, np.int64)))
        separator = separator_text(self.judge, self.judgement, mine) if where else ""
        self.found[what] = Cause(what, np.union1d(before.rows, mine), of, remedy, separator or before.where)
        self.left[mine] = False

    def diagnosis(self) -> Diagnosis:
        return Diagnosis((*self.found.values(), *self.seconds))


def diagnose(judge: Judge, judgement: Judgement) -> Diagnosis:
    """The causes of all failing pixels: invalid answers, then the table of mistakes, then descriptions."""
    causes = _Causes(judge, judgement)
    if not causes.left.any():
        return causes.diagnosis()
    for what, rows in _marked_misses(judge):
        causes.take(what, rows, len(rows), "a miss is t = inf; of an image: --miss VALUE")
    for why, broken in judge.answer.broken.items():
        causes.take(f"no answer: {why}", np.flatnonzero(broken))
    causes.take("a hit where the camera has no ray", np.flatnonzero((judge.t_max < 0.0) & judge.hit))
    of_mitsuba = np.flatnonzero(judgement.classes == CLASS_CODE[REFERENCE_WRONG])
    causes.take(_of_two_right_answers(judge) if len(of_mitsuba) else "", of_mitsuba)
    wrong = np.flatnonzero(causes.left & (judgement.classes == CLASS_CODE[WRONG]))
    exact = judgement.exact
    inexact = np.intersect1d(wrong, exact.rows[exact.wrong])
    if len(inexact):
        _explain(causes, _pixels(judge, judgement, sample_rows(inexact, MAX_DIAGNOSED_PIXELS)))
        if len(inexact) > MAX_DIAGNOSED_PIXELS:
            causes.take("wrong, as the others are; the cause was looked for at some of them", inexact)
    causes.take(NOT_ADJUDICATED, judgement.not_adjudicated)
    for row in np.flatnonzero(causes.left & (judgement.classes == CLASS_CODE[UNDECIDED])):
        causes.take(open_reason(judge, judgement, int(row)), np.array([row]))
    wrong = wrong[causes.left[wrong]]
    for what, remedy, rows in _wrong_surface(judge, judgement, wrong):
        causes.take(what, rows, len(wrong) if remedy else 0, remedy)
    causes.take("not what is there, in no way that is recognised", np.flatnonzero(causes.left))
    return causes.diagnosis()


def _of_two_right_answers(judge: Judge) -> str:
    """Why Mitsuba's answer lies beyond its bounds although the subject is exactly right."""
    if any(unrounded_arrays(part, "float32") for part in judge.model.packed.parts):
        return "each is right for its own numbers: the subject's were not rounded to float32, as Mitsuba's are"
    return f"{subject_name(judge)} is right, and Mitsuba wrong in no known way"


def _marked_misses(judge: Judge) -> Iterator[tuple[str, np.ndarray]]:
    """The rows where Mitsuba misses, if the subject gives the same finite t at all of them."""
    rows = np.flatnonzero(~judge.result.hit & (judge.t_max >= 0.0) & (not judge.answer.hits_only))
    t = judge.answer.t[rows]
    if len(rows) > 1 and np.isfinite(t[0]) and np.allclose(t, t[0], rtol=KU, atol=0.0):
        yield marked_miss(float(t[0])), rows


def marked_miss(t: float) -> str:
    """The sentence about a number in place of inf."""
    return f"t is {t:.7g} where nothing is hit; a miss has t inf"


def _pixels(judge: Judge, judgement: Judgement, rows: np.ndarray) -> WrongPixels:
    """These adjudicated rows of the image with the exact answers there."""
    answers = [judgement.exact.of(row) for row in rows]
    t = np.array([np.inf if a is None or a.t is None else float(a.t) for a in answers])
    prim = np.array([-1 if a is None else a.prim for a in answers], np.int64)
    return WrongPixels(judge, rows, prim >= 0, t, prim, judge.near(rows, prim, t))


def _explain(causes: _Causes, wrong: WrongPixels) -> None:
    """Explain hits and t first, then ids and normals at the right surfaces."""
    judge, judgement = causes.judge, causes.judgement
    exact = judgement.exact
    right = exact.rows[exact.right]
    right = _pixels(judge, judgement, sample_rows(right[judge.hit[right]], RIGHT_PIXELS))
    f = wrong.take(wrong.off)
    kept = ~wrong.off  # rows whose surface is right, and t as well or mistaken for another quantity
    if len(f.rows):
        left, on_surface = np.ones(len(f.rows), bool), np.zeros(len(f.rows), bool)
        winner, tried = _decisive(explanations(f, right), len(f.rows))
        for mistake, fits in tried:
            fits = fits & left
            enough = mistake.single or fits.sum() >= max(MAJORITY * left.sum(), MIN_FITTED_PIXELS)
            if fits.any() and (enough or not mistake.remedy):
                causes.take(mistake.what, f.rows[fits], len(f.rows), mistake.remedy, where=not mistake.remedy)
                left &= ~fits
                on_surface |= fits & mistake.same_surface
            if mistake is winner and not mistake.same_surface and len(f.rows) > MAJORITY * len(wrong.rows):
                causes.take(mistake.what, wrong.rows[kept], len(wrong.rows), mistake.remedy)  # another ray's normals
            if not left.any():
                break
        for what, fits in _plain_descriptions(f):
            causes.take(what, f.rows[fits & left], where=True)
        kept[np.flatnonzero(wrong.off)[on_surface]] = True
    there = wrong.take(kept & wrong.hit & wrong.given_hit)
    named = np.ones(len(there.rows), bool)
    for what, remedy, fits in _wrong_ids(there):
        _take_or_add(causes, what, remedy, there, fits)
        named &= ~fits | bool(remedy)  # an id that is off by one means the right primitive
    there = there.take(named)
    if judge.n is not None and len(there.rows):
        for what, remedy, fits in explain_normals(there, judge.n[there.rows]):
            _take_or_add(causes, what, remedy, there, fits)


def _decisive(stream: Iterator[Explanation], count: int) -> tuple[Mistake | None, Iterator[Explanation]]:
    """(the first mistake that explains nearly all of `count` pixels, all explanations with that one first)."""
    tried: list[Explanation] = []
    for mistake, fits in stream:
        if mistake.remedy and fits.sum() >= max(NEARLY_ALL * count, 1 if mistake.single else MIN_FITTED_PIXELS):
            return mistake, chain([(mistake, fits)], tried, stream)
        tried.append((mistake, fits))
    return None, iter(tried)


def _take_or_add(causes: _Causes, what: str, remedy: str, f: WrongPixels, fits: np.ndarray) -> None:
    """Assign a cause to rows that have none, and add it as a second cause to the others."""
    rows = f.rows[fits]
    same = causes.found.get(what)
    second = np.setdiff1d(rows[~causes.left[rows]], same.rows if same else [])
    causes.take(what, rows, len(f.rows), remedy, where=not remedy)
    if len(second):
        causes.seconds.append(Cause(what, second, len(f.rows), remedy, second=True))


def _plain_descriptions(f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Descriptions of wrong pixels that no mistake explains."""
    yield "missed; exact arithmetic hits", ~f.given_hit & f.hit
    beside = f.given_hit & ~f.hit
    if beside.any():
        yield f"a hit; exact arithmetic misses{_outline_text(f.take(beside))}", beside
    both = f.given_hit & f.hit
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(both, f.given_t / f.t - 1.0, 0.0)
    for some, word in ((both & (share < 0.0), "before"), (both & (share > 0.0), "behind")):
        if some.any():
            where = _outline_text(f.take(some)) if word == "before" else ""
            yield f"t is off: {word} what is hit, by {range_text(np.abs(share[some]))} of itself{where}", some
    yield "t is off", both


ANOTHER_PRIMITIVE = "another primitive than the first one, at the same t"


def _wrong_ids(f: WrongPixels) -> Iterator[tuple[str, str, np.ndarray]]:
    """(what, remedy, (m,) bool) of rows whose t is right but whose shape or primitive is another."""
    answer, packed = f.judge.answer, f.judge.model.packed
    if answer.prim is not None:
        yield ANOTHER_PRIMITIVE, "", answer.prim[f.rows] != f.prim
    given = (("shape", answer.shape_id, packed.shape_of), ("primitive", answer.prim_id, packed.index_in_shape))
    columns = [(name, ids, right(f.prim)) for name, ids, right in given if ids is not None and len(f.rows)]
    hit = f.judge.hit
    named = {tuple(numbers) for numbers in zip(*(ids[hit] for _, ids, _ in columns), strict=True)}
    if columns and len(named) * MIN_FITTED_PIXELS <= len(np.unique(f.prim)):
        who = "the same primitive is" if len(named) == 1 else f"no more than {len(named)} primitives are"
        remedy = "return the number of the primitive in the order of the scene, or leave the column out"
        wrong = np.any([ids[f.rows] != right for _, ids, right in columns], axis=0)
        yield f"{who} named at all {hit.sum()} hits", remedy, wrong
        return
    for name, ids, right in columns:
        off = ids[f.rows].astype(np.int64) - right
        wrong = off != 0
        for step in (1, -1):
            if (off == step).sum() >= max(NEARLY_ALL * wrong.sum(), MIN_FITTED_PIXELS):
                remedy = f"numbers count from 0: {'subtract' if step > 0 else 'add'} 1"
                yield f"the {name}'s number is off by one ({step:+d})", remedy, off == step
                wrong &= off != step
        behind = wrong & _names_another_hit(f)
        if behind.sum() >= max(MAJORITY * wrong.sum(), MIN_FITTED_PIXELS):
            what = f"the {name}'s number is that of another surface along the ray, t that of the first"
            yield what, "keep the number together with the smallest t", behind
            wrong &= ~behind
        yield ANOTHER_PRIMITIVE, "", wrong


def _names_another_hit(f: WrongPixels) -> np.ndarray:
    """(m,) bool: the same ray hits the named primitive at another t."""
    answer, packed, roots = f.judge.answer, f.judge.model.packed, f.roots
    found = np.zeros(len(f.rows), bool)
    same = np.abs(roots.at.t - f.t[roots.ray]) > f.at.t_error[roots.ray] + roots.at.t_error
    for ids, number in ((answer.shape_id, packed.shape_of), (answer.prim_id, packed.index_in_shape)):
        if ids is not None:
            same &= ids[f.rows][roots.ray] == number(roots.prim)
    found[roots.ray[same]] = True
    return found


def _wrong_surface(judge: Judge, judgement: Judgement, rows: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """(what, remedy, rows) where the primitive and t are right: other quantities beyond float64's bounds."""
    if not judge.names_prims or not len(rows):
        return
    at = judge.bounds.own.take(rows)
    f = WrongPixels(judge, rows, at.possible, judge.answer.t[rows], judge.prim[rows].astype(np.int64), at)
    if judge.n is not None:
        for what, remedy, fits in explain_normals(f, judge.n[rows]):
            yield what, remedy, rows[fits]
    failing = {check.name: check.fails[rows] for check in judge.self_checks}
    if "diffuse" in judgement.ratios:
        failing["diffuse"] = ~(judgement.ratios["diffuse"][rows] <= 1.0)
    for name, where in failing.items():
        yield f"beyond what float64 rounding allows at the primitive that is hit, in {name}", "", rows[where]


# ---- hits beyond the outline of a triangle

OUTLINE_PIXELS = 64  # at which the nearest triangle is looked for
NEAR_BOXES = 16  # triangles whose boxes are nearest to the point


def _outline_text(f: WrongPixels) -> str:
    """How far hits lie beyond the outlines of triangles, on their planes; "" if they lie on no such plane."""
    judge = f.judge
    if judge.answer.hits_only:
        return ""
    low, high = judge.model.boxes
    found = []
    few = f.take(sample_rows(np.arange(len(f.rows)), OUTLINE_PIXELS))
    bound = np.where(few.hit, FIT_FACTOR * few.at.t_error, np.inf)
    for o, d, t, t_bound in zip(few.o, few.d, few.given_t, bound, strict=True):
        p = o + t * d
        with np.errstate(invalid="ignore"):
            away = norm(np.maximum(np.maximum(low - p, p - high), 0.0))
        prims = np.argsort(away, kind="stable")[:NEAR_BOXES]
        corners = triangle_corners(judge, prims)
        n = unit(area_vectors(corners))
        height = np.abs(dot(p - corners[:, 0], n))
        on_plane = height <= DISTINCT_RTOL * norm(corners[:, 1] - corners[:, 0])
        with np.errstate(invalid="ignore"):  # of a miss, beside a triangle along the ray
            on_plane &= height <= t_bound * np.abs(n @ d)
        if not on_plane.any() or (on_plane & _is_inside(p, corners)).any():
            continue
        beyond = np.where(on_plane, _outline_distances(p, corners), np.inf)
        found.append((float(beyond.min()), int(prims[beyond.argmin()])))
    if len(found) < NEARLY_ALL * len(few.rows):
        return ""
    distances = np.array([distance for distance, _ in found])
    prim = np.array([found[0][1]])
    number = int(judge.model.packed.index_in_shape(prim)[0])
    name = judge.scene.shape_names()[int(judge.model.packed.shape_of(prim)[0])]
    where = f"by {range_text(distances)} (first: {name}, prim {number})"
    return f", beyond the outline of a triangle, on its plane, {where}"


def _is_inside(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(m,) bool: p (3,), projected along the normals of triangles (m, 3, 3), lies inside their outlines."""
    n = unit(area_vectors(corners))
    edges = [(corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)]
    sides = [dot(np.cross(b - a, p - a), n) >= 0.0 for a, b in edges]
    inside: np.ndarray = np.all(sides, axis=0)
    return inside


def _outline_distances(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(m,) distance of p (3,) or (m, 3) from the nearest edge of each triangle (m, 3, 3)."""
    found = []
    for i in range(3):
        a, ab = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.clip(np.nan_to_num(dot(p - a, ab) / dot(ab, ab)), 0.0, 1.0)
        found.append(norm(p - a - along[:, None] * ab))
    nearest: np.ndarray = np.min(found, axis=0)
    return nearest


# ---- separators: the simplest quantity that differs between wrong and right pixels

MIN_SEPARATED_PIXELS = 8  # wrong pixels; of fewer, too many quantities are extreme by chance


def separator_text(judge: Judge, judgement: Judgement, wrong: np.ndarray) -> str:
    """The quantity and threshold that separate these wrong rows from right ones; "" if none separates nearly all."""
    if len(wrong) < MIN_SEPARATED_PIXELS:
        return ""
    exact = judgement.exact
    prim = np.where(judge.result.hit, judge.reference_prim, -1).astype(np.int64)
    for row, answer in zip(exact.rows, exact.answers, strict=True):
        prim[row] = -1 if answer is None else answer.prim
    failing = judgement.is_class(*FAILING)
    wrong = sample_rows(wrong[prim[wrong] >= 0], MAX_DIAGNOSED_PIXELS)
    right = sample_rows(np.flatnonzero(~failing & (prim >= 0)), MAX_DIAGNOSED_PIXELS)
    if len(wrong) < MIN_SEPARATED_PIXELS or len(right) < MIN_SEPARATED_PIXELS:
        return ""
    rows = np.concatenate([wrong, right])
    is_wrong = np.arange(len(rows)) < len(wrong)
    features = tuple(_features(judge, rows, prim[rows]))
    opposite = ""  # a property of right pixels, used if no property of wrong ones is found
    for name, values in features:
        found = best_split(values, is_wrong, tried=len(features))
        if found is None:
            continue
        m, is_property = int(is_wrong.sum()), "{" not in name
        shares = f"{found.wrong} of {m} wrong pixels, {found.right} of {len(right)} right ones"
        if is_property and found.words.startswith("below"):
            opposite = opposite or f"where {_negation(name)}: {shares}"
        elif is_property or not opposite:
            return f"where {name.format(found.words)}: {shares}"
    if opposite:
        return opposite
    for name, values in features:
        if "{" not in name and (share := necessary_share(values == 1.0, is_wrong, len(features))) is not None:
            return f"only where {name}: all {len(wrong)} wrong pixels, {100.0 * share:.2g} % of the right ones"
    return ""


@dataclass(frozen=True)
class Split:
    """A threshold, and the numbers of pixels on one side of it."""

    words: str  # such as "below 1e-06"
    wrong: int
    right: int


def best_split(values: np.ndarray, wrong: np.ndarray, tried: int) -> Split | None:
    """The threshold of values (n,) that has nearly all of the wrong (n,) bool on one side, and few others.

    None if SEPARATES is not reached on both sides, or chance would do as well. tried: features, as a union bound.
    """
    some = np.isfinite(values)
    m, n = int(wrong.sum()), len(values)
    if (some & wrong).sum() < SEPARATES * m:
        return None
    order = np.argsort(values[some], kind="stable")
    v, w = values[some][order], wrong[some][order]
    last = np.flatnonzero(np.r_[v[1:] > v[:-1], False])  # thresholds lie between different values
    if not len(last):
        return None
    below_wrong, below = np.cumsum(w)[last], last + 1
    found: list[tuple[float, Split]] = []
    for k, j, side in ((below_wrong, below, "below"), (w.sum() - below_wrong, len(v) - below, "above")):
        share = np.minimum(k / m, 1.0 - (j - k) / (n - m))
        i = int(share.argmax())
        words = f"{side} {_simplest_between(float(v[last[i]]), float(v[last[i] + 1])):.7g}"
        found.append((float(share[i]), Split(words, int(k[i]), int(j[i] - k[i]))))
    share_best, split = max(found, key=lambda each: each[0])
    significant = _is_significant(split.wrong, split.wrong + split.right, m, n, 2.0 * tried * len(last))
    return split if share_best >= SEPARATES and significant else None


def necessary_share(flags: np.ndarray, wrong: np.ndarray, tried: int) -> float | None:
    """The share of right pixels that have a property of all wrong ones; flags, wrong: (n,) bool.

    None if a wrong one lacks it, nearly all right ones have it, or chance would do as well.
    """
    m, n, right = int(wrong.sum()), len(wrong), int((flags & ~wrong).sum())
    share = right / (n - m)
    if not flags[wrong].all() or share > NEARLY_ALL:
        return None
    return share if _is_significant(m, m + right, m, n, tried) else None


def _is_significant(k: int, j: int, m: int, n: int, tried: float) -> bool:
    """Whether chance does not find k of the m wrong pixels among j of all n in so many tries."""
    p, q = k / max(j, 1), m / n
    unlikely = j * (_log_ratio(p, q) + _log_ratio(1.0 - p, 1.0 - q))
    return bool(np.log(tried) - unlikely < np.log(SEPARATOR_CHANCE))


def _log_ratio(p: float, q: float) -> float:
    return float(p * np.log(p / q)) if p > 0.0 else 0.0


def _simplest_between(low: float, high: float) -> float:
    """The number with the fewest digits between low and high."""
    if low < 0.0 < high:
        return 0.0
    for digits in range(1, 18):
        for number in (high, low, 0.5 * (low + high)):
            text = float(f"{number:.{digits - 1}e}")
            if low < text < high:
                return text
    return high


def _features(judge: Judge, rows: np.ndarray, prim: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(sentence, with {} for "below x", (n,) values) of rays and the primitives they hit, the simplest first."""
    packed, o, d = judge.model.packed, judge.o[rows], judge.d[rows]
    shape = packed.shape_of(prim)
    names = judge.scene.shape_names()
    kinds = np.array([kind_of(kind.prims).name for kind in packed.kinds])[packed.kind_of[shape]]
    for kind in np.unique(kinds) if len(packed.kinds) > 1 else ():
        yield f"one of the {kind.lower()} is hit", _flag(kinds == kind)
    for number in np.unique(shape) if len(names) > 1 else ():
        yield f"{names[number]} is hit", _flag(shape == number)
    at = judge.near(rows, prim, judge.result.t[rows].astype(np.float64))
    corners = triangle_corners(judge, prim)
    low, high = (corner[prim] for corner in judge.model.boxes)
    cosine = dot(at.n, unit(d))
    with np.errstate(all="ignore"):
        edges = area_vectors(corners)
        extent = high - low
        size = np.where(np.isfinite(extent).all(axis=1), norm(extent), np.nan)
        yield "the box of the primitive has no thickness", _flag(extent.min(axis=1) == 0.0)
        yield "a component of d is 0", _flag((d == 0.0).any(axis=1))
        yield "the surface is seen from behind", _flag(cosine > 0.0)
        yield "the determinant |d . (e1 x e2)| is {}", np.abs(dot(d, edges))
        yield "t is {}", at.t
        yield "the cosine of ray and normal is {}", np.abs(cosine)
        yield "twice the area of the triangle is {}", norm(edges)
        yield "the size of the primitive is {}", size
        yield "the smallest extent of the primitive's box is {}", extent.min(axis=1)
        yield "the distance to the triangle's outline is {}", _outline_distances(o + at.t[:, None] * d, corners)
    yield "the number of the primitive in its shape is {}", packed.index_in_shape(prim).astype(np.float64)
    yield "|d| is {}", norm(d)
    yield "|o| is {}", norm(o)
    width = judge.pair.shape[1]
    if not judge.pair.rays.is_list:
        yield "the pixel's x is {}", (rows % width).astype(np.float64)
        yield "the pixel's y is {}", (rows // width).astype(np.float64)


def _negation(name: str) -> str:
    """The sentence that a property does not hold."""
    if name.startswith("a component "):
        return name.replace("a ", "no ", 1)
    return name.replace(" has no ", " has some ") if " has no " in name else name.replace(" is ", " is not ")


def _flag(values: np.ndarray) -> np.ndarray:
    """1 where true, 0 elsewhere."""
    return np.where(values, 1.0, 0.0)
