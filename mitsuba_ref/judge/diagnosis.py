"""Diagnosis of failing pixels: causes, each with its pixels and a property that separates them from right ones.

It describes pixels that fail; it never decides whether a pixel passes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from caster.description.transform import rotations
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.error_model.intersections import Array, dot, norm, unit
from mitsuba_ref.error_model.tolerances import (
    DISTINCT_RTOL,
    FIT_FACTOR,
    MAJORITY,
    MATCH_RTOL,
    NEARLY_ALL,
    SEPARATES,
    SEPARATOR_CHANCE,
)
from mitsuba_ref.judge.adjudication import named_prims, sample_rows
from mitsuba_ref.judge.checks.ray_conventions import CastRays, marked_misses
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.explanations import open_reason, subject_name
from mitsuba_ref.judge.hypotheses import (
    FEW_PIXELS,
    Mistake,
    WrongPixels,
    area_vectors,
    explanations,
    has_wrong_normal,
    id_mistakes,
    mistakes,
    normal_mistakes,
    range_text,
    triangle_corners,
)
from mitsuba_ref.judge.verdict import FAILING, REFERENCE_WRONG, UNDECIDED, WRONG
from mitsuba_ref.shapes import kind_of

SAME_SYMPTOM = "same symptom, not looked at"
MAX_DIAGNOSED_PIXELS = 4096  # wrong pixels at which the tables of mistakes are tried
RIGHT_PIXELS = 512  # hits, and as many misses, that have to stay right under a mistake
NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Cause:
    """The cause of some failing rows of the image."""

    what: str
    rows: Array  # ascending
    of: int = 0  # wrong pixels among which it was looked for; 0: a description
    remedy: str = ""  # of a mistake that explains the rows
    where: str = ""  # a property that separates these pixels from right ones
    alike: Array = field(default_factory=lambda: NONE)  # rows with the same symptom that were not adjudicated


def sentence_by_row(causes: Sequence[Cause]) -> dict[int, str]:
    """The sentence about each row that fails; each has at least one cause."""
    found: dict[int, str] = {}
    for cause in causes:
        for row in cause.rows.tolist():
            found[row] = f"{found[row]}; and {cause.what}" if row in found else cause.what
        found |= dict.fromkeys(cause.alike.tolist(), f"{cause.what} ({SAME_SYMPTOM})")
    return found


def failing_rows(judgement: Judgement) -> Array:
    """Rows of the image that fail by their class, or because the reference is wrong in an unknown way; ascending."""
    unlisted = np.array([row for row, case in judgement.cases.items() if case is None], np.int64)
    return np.union1d(np.flatnonzero(judgement.is_class(*FAILING)), unlisted)


Table = Callable[[WrongPixels], Iterator[Mistake]]
Describe = Callable[[WrongPixels], Iterator[tuple[str, Array]]]  # (description, (m,) bool: its pixels)


class _Causes:
    """Collects causes."""

    def __init__(self, judge: Judge, judgement: Judgement, cast: CastRays | None):
        self.judge, self.judgement, self.cast = judge, judgement, cast
        self.found: dict[str, Cause] = {}
        self.left = np.isin(np.arange(len(judge.t_max)), failing_rows(judgement))  # rows that have no cause yet

    def take(
        self, what: str, rows: Array, of: int = 0, remedy: str = "", *, where: bool = False, beside: bool = False
    ) -> None:
        """Assign a cause to those of the rows that have none yet, or beside others. where: look for a separator."""
        if not beside:
            rows = rows[self.left[rows]]
        if not len(rows):
            return
        self.left[rows] = False
        separator = next(separators(self.judge, self.judgement, rows, prims_only=bool(remedy)), "") if where else ""
        missed = rows[~self.judge.hit[rows]]
        if where and not (separator or remedy) and self.cast and len(missed) >= NEARLY_ALL * len(rows):
            question, separator = tried_text(self.judge, *self.judgement.exact.first_hits(missed), missed, self.cast)
            what = f"{what}; {question}" if question else what
        before = self.found.get(what)
        if before:
            rows, separator = np.union1d(before.rows, rows), separator or before.where
        self.found[what] = Cause(what, rows, of, remedy, separator)

    def take_alike(self, rows: Array) -> None:
        """Assign pixels that were not adjudicated to the cause of most adjudicated ones of their kind."""
        group = self.judge.kinds_of_pixels(np.arange(len(self.left)))
        for kind in np.unique(group[rows]) if self.found else ():
            members = rows[group[rows] == kind]
            cause = max(self.found.values(), key=lambda cause: int((group[cause.rows] == kind).sum()))
            self.found[cause.what] = replace(cause, alike=np.union1d(cause.alike, members))
            self.left[members] = False

    def explain(self, g: WrongPixels, off: Array, table: Table, describe: Describe) -> WrongPixels:
        """Assign mistakes and descriptions to the pixels of g that are off, (m,) bool.

        Returns the pixels where the subject hits the right surface: hits that are not off, or by such a mistake.
        """
        on_surface, places = ~off, np.flatnonzero(off)
        f = g.take(places)
        left = np.ones(len(places), bool)
        right = self.right if table is mistakes else self.right.take(self.right.hit)
        for mistake, fits in explanations(f, right, table(f)):
            self.take(mistake.what, f.rows[fits], len(places), mistake.remedy, where=mistake.single, beside=True)
            left &= ~fits
            on_surface[places[fits]] = not mistake.elsewhere
            if mistake.elsewhere and fits.sum() >= NEARLY_ALL * len(places) > NEARLY_ALL * MAJORITY * len(off):
                self.take(mistake.what, g.rows[~off], len(off), mistake.remedy)  # such as normals of another ray
        f = f.take(left)
        for what, fits in describe(f):
            self.take(what, f.rows[fits], where=True, beside=True)
        return g.take(on_surface & g.hit & g.given_hit)

    @cached_property
    def right(self) -> WrongPixels:
        """Right hits and misses, which may contradict a mistake."""
        exact = self.judgement.exact
        rows = exact.rows[exact.right]
        hit = self.judge.hit[rows]
        some = [sample_rows(each, RIGHT_PIXELS) for each in (rows[hit], rows[~hit])]
        return _pixels(self.judge, self.judgement, np.concatenate(some))


@np.errstate(all="ignore")  # predictions overflow where a caster gives a t of 1e300
def diagnose(judge: Judge, judgement: Judgement, cast: CastRays | None = None) -> tuple[Cause, ...]:
    """The causes of all failing pixels: invalid answers, then the tables of mistakes, then descriptions.

    cast: asks the subject for further rays, by which it finds what makes it miss; None: it takes none.
    """
    causes, exact = _Causes(judge, judgement, cast), judgement.exact
    if not causes.left.any():
        return ()
    misses = np.flatnonzero(~judge.result.hit & (judge.t_max >= 0.0) & (not judge.answer.hits_only))
    if marked := marked_misses(judge.answer.t[misses]):
        causes.take(marked, misses, len(misses), "a miss is t = inf; of an image: --miss VALUE")
    for why, broken in judge.answer.broken.items():
        causes.take(f"no answer: {why}", np.flatnonzero(broken))
    causes.take("a hit where the camera has no ray", np.flatnonzero((judge.t_max < 0.0) & judge.hit))
    of_mitsuba = f"{subject_name(judge)} is right, and Mitsuba wrong in no known way"
    causes.take(of_mitsuba, np.flatnonzero(judgement.is_class(REFERENCE_WRONG)))
    wrong = np.flatnonzero(causes.left & judgement.is_class(WRONG))
    inexact = np.intersect1d(wrong, exact.rows[exact.wrong])
    if len(judge.hit) > 1 and not judge.hit.any():  # of one pixel, that means nothing
        causes.take(f"{subject_name(judge)} misses everything", inexact, where=True)
        inexact = inexact[causes.left[inexact]]
    if len(inexact):
        looked_at = sample_rows(inexact, MAX_DIAGNOSED_PIXELS)
        g = _pixels(judge, judgement, looked_at)
        g = causes.explain(g, g.off, mistakes, _describe_hits)
        named_wrongly = (g.named != g.numbers_of(g.prim)).any(axis=0)  # a shape or primitive that is not hit
        g = causes.explain(
            g,
            named_wrongly,
            id_mistakes,
            lambda f: iter([("another primitive than the first one, at the same t", f.hit)]),
        )
        causes.explain(g, has_wrong_normal(g), normal_mistakes, _describe_normals)
        inexact = np.setdiff1d(inexact, looked_at)
    causes.take_alike(np.union1d(judgement.not_adjudicated, inexact))
    for row in np.flatnonzero(causes.left & judgement.is_class(UNDECIDED)):
        causes.take(open_reason(judge, judgement, int(row)), np.array([row]))
    causes.take("wrong in no way that is recognised", np.flatnonzero(causes.left))
    return tuple(causes.found.values())


def _pixels(judge: Judge, judgement: Judgement, rows: Array) -> WrongPixels:
    """These adjudicated rows of the image with the exact answers there."""
    prim, t = judgement.exact.first_hits(rows)
    return WrongPixels(judge, rows, prim, t, judge.near(rows, prim, t))


# ---- descriptions of wrong pixels that no mistake explains


def _describe_hits(f: WrongPixels) -> Iterator[tuple[str, Array]]:
    missed, beside, behind = ~f.given_hit & f.hit, f.given_hit & ~f.hit, _is_behind_first(f)
    if behind.any():
        hidden = "the first surface is missed, and what lies behind it is hit, if anything"
        yield hidden if missed.any() else "a surface that lies behind the first one", missed | behind
    else:
        yield "missed; exact arithmetic hits", missed
    if beside.any():
        yield f"a hit; exact arithmetic misses{_outline_text(f.take(beside))}", beside
    both = f.given_hit & f.hit & ~behind
    share = f.given_t[both] / f.t[both] - 1.0
    off = share[(share < 0.0) | (share > 0.0)]
    if len(off):
        words = "before" if off.max() < 0.0 else "behind" if off.min() > 0.0 else "before or behind"
        where = "" if words == "behind" else _outline_text(f.take(both))
        yield f"t is off: {words} what is hit, by {range_text(np.abs(off))} of itself{where}", both
    else:
        yield "t is off", both


def _is_behind_first(f: WrongPixels) -> Array:
    """(m,) bool: a surface behind the first one is answered."""
    behind = np.zeros(len(f.rows), bool)
    if f.judge.answer.hits_only:
        return behind
    t, at = f.given_t[f.roots.ray], f.roots.at
    behind[f.roots.ray[np.abs(t - at.t) <= np.maximum(at.t_error, MATCH_RTOL * np.abs(t))]] = True
    return behind & f.given_hit & f.hit & (f.given_t > f.t * (1.0 + DISTINCT_RTOL))


def _describe_normals(f: WrongPixels) -> Iterator[tuple[str, Array]]:
    error = row_distance(f.n, f.at.n)
    finite = np.isfinite(error)
    if finite.any():
        yield f"the normal is off by {range_text(error[finite])} of its length", f.hit


# ---- hits beyond the outline of a triangle

OUTLINE_PIXELS = 64  # at which the nearest triangle is looked for
NEAR_BOXES = 16  # triangles whose boxes are nearest to the point


def _outline_text(f: WrongPixels) -> str:
    """How far hits lie beyond the outlines of triangles, on their planes; "" if they lie on no such plane."""
    judge = f.judge
    if judge.answer.hits_only:
        return ""
    low, high = judge.model.boxes
    distances, nearest = [], []
    few = f.take(sample_rows(np.arange(len(f.rows)), OUTLINE_PIXELS))
    bound = np.where(few.hit, FIT_FACTOR * few.at.t_error, np.inf)
    for o, d, t, t_bound in zip(few.o, few.d, few.given_t, bound, strict=True):
        p = o + t * d
        away = norm(np.maximum(np.maximum(low - p, p - high), 0.0))
        prims = np.argsort(away, kind="stable")[:NEAR_BOXES]
        corners = triangle_corners(judge, prims)
        n = unit(area_vectors(corners))
        height = np.abs(dot(p - corners[:, 0], n))
        on_plane = height <= DISTINCT_RTOL * norm(corners[:, 1] - corners[:, 0])
        on_plane &= height <= t_bound * np.abs(n @ d)  # of a miss, beside a triangle along the ray
        beyond = np.where(on_plane, _outline(p, corners), np.inf)
        if 0.0 < beyond.min() < np.inf:
            distances.append(beyond.min())
            nearest.append(prims[beyond.argmin()])
    if len(distances) < NEARLY_ALL * len(few.rows):
        return ""
    name, number = named_prims(judge.scene, judge.model.packed, np.array(nearest))[0]
    where = f"by {range_text(np.array(distances))} (first: {name}, prim {number})"
    return f", beyond the outline of a triangle, on its plane, {where}"


def _outline(p: Array, corners: Array) -> Array:
    """The distance of p (3,) or (m, 3) from the outline of each triangle (m, 3, 3); negative if projected inside."""
    ab, n = np.roll(corners, -1, axis=1) - corners, area_vectors(corners)
    ap = np.broadcast_to(p, n.shape)[:, None] - corners
    inside = (np.cross(ab, ap) @ n[:, :, None] >= 0.0).all(axis=(1, 2))
    along = np.clip(np.nan_to_num((ap * ab).sum(axis=2) / (ab * ab).sum(axis=2)), 0.0, 1.0)
    distance = np.linalg.norm(ap - along[:, :, None] * ab, axis=2).min(axis=1)
    return np.where(inside, -distance, distance)


# ---- separators: the simplest quantity that differs between wrong and right pixels

MAX_NAMED_PRIMS = 3  # that are wrong at nearly all of their pixels

Property = tuple[str, Array]  # a sentence, and (n,) bool


def separators(judge: Judge, judgement: Judgement, wrong: Array, *, prims_only: bool = False) -> Iterator[str]:
    """Properties and thresholds that separate nearly all of these wrong rows from right ones, the simplest first."""
    prim = judge.reference_prim.astype(np.int64)  # (n,) what each ray hits
    prim[judgement.exact.rows], _ = judgement.exact.first_hits(judgement.exact.rows)
    wrong, right = wrong[prim[wrong] >= 0], np.flatnonzero(~judgement.is_class(*FAILING) & (prim >= 0))
    rows, is_wrong = np.concatenate([wrong, right]), np.repeat([True, False], [len(wrong), len(right)])
    yield from _by_remainder(
        "the primitive's number in its shape", judge.model.packed.index_in_shape(prim[rows]), is_wrong
    )
    named = list(_by_prims(judge, prim[rows], is_wrong))
    if not prims_only:
        numbers = (np.cumsum(judge.t_max >= 0.0) - 1)[rows]  # a pixel without a ray has no number
        named += _by_remainder("the ray's number", numbers, is_wrong)
    some = [sample_rows(each, MAX_DIAGNOSED_PIXELS) for each in (wrong, right)]
    if prims_only or min(map(len, some)) < FEW_PIXELS:
        yield from named
        return
    rows, is_wrong = np.concatenate(some), np.repeat([True, False], [*map(len, some)])
    properties, quantities = _features(judge, rows, prim[rows])
    tried = len(properties) + len(quantities)
    negated = ((" is not ".join(sentence.rsplit(" is ", 1)), ~flags) for sentence, flags in properties)
    for sentence, flags in (*properties, *negated):
        if _separates(flags, is_wrong, tried):
            yield _where_text(sentence, flags, is_wrong)
    yield from named
    for name, values in quantities:
        if (found := best_threshold(values, is_wrong, tried)) is not None:
            words, flags = found
            yield _where_text(f"{name} is {words}", flags, is_wrong)
    for sentence, flags in properties:
        if (share := necessary_share(flags, is_wrong, tried)) is not None:
            yield f"only where {sentence}: all {is_wrong.sum()} wrong pixels, {100.0 * share:.2g} % of the right ones"


def _where_text(sentence: str, flags: Array, wrong: Array) -> str:
    counts = (flags & wrong).sum(), wrong.sum(), (flags & ~wrong).sum(), (~wrong).sum()
    return "where {}: {} of {} wrong pixels, {} of {} right ones".format(sentence, *counts)


def _by_remainder(what: str, numbers: Array, wrong: Array) -> Iterator[str]:
    """The numbers (n,) of wrong pixels, if they are equal modulo another one, unless chance would do as well.

    k numbers that have nothing to do with each other leave one remainder with probability divisor^(1 - k).
    """
    of_wrong = np.unique(numbers[wrong])
    step = int(np.gcd.reduce(np.diff(of_wrong))) if len(of_wrong) > 1 else 0
    if step < 2 or (1 - len(of_wrong)) * np.log(step) > np.log(SEPARATOR_CHANCE):
        return
    rest = int(of_wrong[0]) % step
    flags = numbers % step == rest
    if (flags & ~wrong).sum() <= (1.0 - SEPARATES) * (~wrong).sum():
        yield _where_text(f"{what} is {rest} modulo {step}", flags, wrong)


def _by_prims(judge: Judge, prim: Array, wrong: Array) -> Iterator[str]:
    """The primitives (n,) of wrong pixels, if these are few and wrong at nearly all of their pixels."""
    named = np.unique(prim[wrong])
    flags = np.isin(prim, named)
    if 0 < len(named) <= MAX_NAMED_PRIMS and _separates(flags, wrong, len(np.unique(prim)) ** len(named)):
        surfaces = named_prims(judge.scene, judge.model.packed, named)
        words = " or ".join(f"{name}, prim {number}," for name, number in surfaces)
        yield _where_text(f"{words} is hit", flags, wrong)


def _separates(flags: Array, wrong: Array, tried: int) -> bool:
    """Whether nearly all wrong pixels have a property, few others, and chance would not do as well; (n,) bool each."""
    has, lacks = (flags & wrong).sum(), (~flags & ~wrong).sum()
    separates = has >= SEPARATES * wrong.sum() and lacks >= SEPARATES * (~wrong).sum()
    return bool(separates) and _is_significant(flags, wrong, tried)


def best_threshold(values: Array, wrong: Array, tried: int) -> tuple[str, Array] | None:
    """(such as "below 1e-06", (n,) bool) of the threshold that separates the wrong (n,) bool best; None if none does.

    tried: features, as a union bound.
    """
    rows = np.flatnonzero(np.isfinite(values))
    rows = rows[np.argsort(values[rows], kind="stable")]
    v, w = values[rows], wrong[rows]
    last = np.flatnonzero(np.diff(v) > 0.0)  # thresholds lie between different values
    if not len(last):
        return None
    below, right_below = np.cumsum(w)[last], np.cumsum(~w)[last]
    m, n = wrong.sum(), (~wrong).sum()
    above, right_above = w.sum() - below, (~w).sum() - right_below
    shares = np.minimum([below / m, above / m], 1.0 - np.array([right_below / n, right_above / n]))
    side, place = np.unravel_index(int(shares.argmax()), shares.shape)
    flags = np.zeros(len(wrong), bool)
    flags[rows[last[place] + 1 :] if side else rows[: last[place] + 1]] = True
    words = f"{'above' if side else 'below'} {_simplest_between(float(v[last[place]]), float(v[last[place] + 1])):.7g}"
    return (words, flags) if _separates(flags, wrong, 2 * tried * len(last)) else None


def necessary_share(flags: Array, wrong: Array, tried: int) -> float | None:
    """The share of right pixels that have a property of all wrong ones; flags, wrong: (n,) bool.

    None if a wrong one lacks it, nearly all right ones have it, or chance would do as well.
    """
    share = float(flags[~wrong].mean())
    necessary = flags[wrong].all() and share <= NEARLY_ALL and _is_significant(flags, wrong, tried)
    return share if necessary else None


def _is_significant(flags: Array, wrong: Array, tried: float) -> bool:
    """Whether chance does not find so many of the wrong pixels among those with a property in so many tries."""
    p, q = (flags & wrong).sum() / max(flags.sum(), 1), wrong.mean()
    divergence = sum(a * np.log(a / b) for a, b in ((p, q), (1.0 - p, 1.0 - q)) if a > 0.0)
    return bool(np.log(tried) - flags.sum() * divergence < np.log(SEPARATOR_CHANCE))


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


def _features(judge: Judge, rows: Array, prim: Array) -> tuple[list[Property], list[Property]]:
    """(sentence, (n,) bool) and (name, (n,) values) of rays and the primitives they hit, the simplest first."""
    packed, o, d = judge.model.packed, judge.o[rows], judge.d[rows]
    at = judge.near(rows, prim, judge.result.t[rows].astype(np.float64))
    low, high = (corner[prim] for corner in judge.model.boxes)
    corners = triangle_corners(judge, prim)
    shape, names = packed.shape_of(prim), judge.scene.shape_names()
    kinds = np.array([kind_of(kind.prims).name.lower() for kind in packed.kinds])[packed.kinds_of(prim)[0]]
    properties = [
        *((f"what is hit is one of the {kind}", kinds == kind) for kind in np.unique(kinds)),
        *((f"{names[k]} is hit", shape == k) for k in np.unique(shape)),
        ("the box of the primitive is flat", (high == low).any(axis=1)),
        ("a component of d is 0", (d == 0.0).any(axis=1)),
        ("the surface is seen from behind", dot(at.n, d) > 0.0),
        *(
            (f"d.{axis} is {word}", sign * values > 0.0)
            for axis, values in zip("xyz", d.T, strict=True)
            for word, sign in (("positive", 1.0), ("negative", -1.0))
        ),
    ]
    quantities = [
        ("the determinant |d . (e1 x e2)|", np.abs(dot(d, area_vectors(corners)))),
        ("t", at.t),
        ("the cosine of ray and normal", np.abs(dot(at.n, unit(d)))),
        ("the size of the primitive", norm(high - low)),
        ("the distance to the triangle's outline", np.abs(_outline(o + at.t[:, None] * d, corners))),
        ("the number of the primitive in its shape", packed.index_in_shape(prim)),
        ("|d|", norm(d)),
    ]
    if not judge.rays.is_list:
        y, x = np.divmod(rows, judge.shape[1])
        quantities += [("the pixel's x", x), ("the pixel's y", y)]
    return properties, quantities


# ---- further rays: what makes a caster miss that misses all of a kind

TRIED_RAYS, TRIED_RTOL = 64, 0.1  # a start that is moved by an epsilon counts as right
LONGER, FARTHER = 2.0**40, 1000.0  # a direction; a start, in distances from the hit
LARGEST_EPSILON = 1e6  # that a caster may compare determinants with
TURN = rotations(np.array([[1.0, 2.0, 3.0, 21.2]]))[0]  # by 20 degrees


def tried_text(judge: Judge, prim: Array, t: Array, rows: Array, cast: CastRays) -> tuple[str, str]:
    """A question, from the first change of missed rays under which nearly all hit, and the sizes that it is about.

    rows: that are hit at t, exactly. If no change helps, there is a question only if all rays of the film are missed.
    """
    chosen = np.flatnonzero(prim >= 0)
    chosen = chosen[sample_rows(np.arange(len(chosen)), TRIED_RAYS)]
    if not len(chosen):
        return "", ""
    o, d, t = judge.o[rows[chosen]], judge.d[rows[chosen]], t[chosen, None]
    p, turned = o + t * d, d @ TURN
    determinants = np.abs(dot(d, area_vectors(triangle_corners(judge, prim[chosen]))))
    determinants = determinants[np.isfinite(determinants)]
    epsilon = "with d scaled by 2^40", "is an epsilon larger than the determinants", o, LONGER * d
    sizes = f"distances of hits here: {range_text(t * norm(d)[:, None])}"
    sizes += f", determinants: {range_text(determinants)}" if len(determinants) else ""
    for changed, question, start, way in (
        ("alone", "does the number of rays matter", o, d),
        (f"from {FARTHER:g} times as near", "are far hits lost", p - t * d / FARTHER, d),
        *([epsilon] if (determinants < LARGEST_EPSILON).any() else []),
        (f"from {FARTHER:g} times as far", "are near hits lost", p - FARTHER * t * d, d),
        ("with d turned by 20 degrees", "is a component of d that is 0 a divisor", p - t * turned, turned),
        ("from the other side", "is one side culled, or a sign of d ignored", p + t * d, -d),
    ):
        given, expected = cast(start, way) or (NONE, NONE)
        there = np.isfinite(expected)
        if there.any() and np.isclose(given[there], expected[there], rtol=TRIED_RTOL, atol=0.0).mean() >= NEARLY_ALL:
            return f"{question}? The same rays hit {changed}", sizes
    if judge.hit.any():
        return "", ""
    question = "is the scene read, do rays reach so far, is every epsilon below the determinants"
    return f"{question}? Further rays miss, too", sizes
