"""The table of mistakes: a name, a prediction of the answers of a caster that makes it, and a remedy for each.

A mistake only explains pixels that fail: it explains a wrong pixel if the subject answers as the mistake predicts.
Pixels that are right must not contradict it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Triangles
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.error_model.bracket import RayIntersections
from mitsuba_ref.error_model.intersections import Intersections, dot, norm, row_groups, unit
from mitsuba_ref.error_model.scene_model import kinds_of
from mitsuba_ref.error_model.tolerances import (
    DISTINCT_RTOL,
    FIT_FACTOR,
    KU,
    KU_OURS,
    LARGEST_RESIDUAL,
    LARGEST_USEFUL_NORMAL_ERROR,
    MAJORITY,
    MATCH_RTOL,
    MIN_FITTED_PIXELS,
    NEARLY_ALL,
)
from mitsuba_ref.judge.adjudication import sample_rows
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.reference.shared_input import pixel_centers
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64

SCREENED_PIXELS = 96  # at which a claim about the whole image is tried first
RIGHT_PIXELS = 512  # that have to stay right under a mistake


@dataclass(frozen=True)
class WrongPixels:
    """Rows of the image and the exact answers there."""

    judge: Judge
    rows: np.ndarray  # (m,)
    hit: np.ndarray  # (m,) bool, exactly
    t: np.ndarray  # (m,) exact, inf on a miss
    prim: np.ndarray  # (m,) -1 on a miss
    at: Intersections  # (m,) of these primitives, as the subject may see them

    def take(self, some: np.ndarray) -> "WrongPixels":
        """A subset, by mask or index."""
        at = self.at.take(some)
        return WrongPixels(self.judge, self.rows[some], self.hit[some], self.t[some], self.prim[some], at)

    @property
    def given_hit(self) -> np.ndarray:
        """(m,) bool: the subject's."""
        return self.judge.hit[self.rows]

    @property
    def given_t(self) -> np.ndarray:
        """(m,) the subject's."""
        return self.judge.answer.t[self.rows]

    @property
    def o(self) -> np.ndarray:
        return self.judge.o[self.rows]

    @property
    def d(self) -> np.ndarray:
        return self.judge.d[self.rows]

    @property
    def t_rounding(self) -> np.ndarray:
        """(m,) error of t from storing it in another form."""
        return np.broadcast_to(self.judge.answer.t_rounding, self.judge.answer.t.shape)[self.rows]

    @cached_property
    def off(self) -> np.ndarray:
        """(m,) bool: hit, miss or t is wrong."""
        other = self.given_hit != self.hit
        if self.judge.answer.hits_only:
            return other
        with np.errstate(invalid="ignore"):
            wrong_t = ~(np.abs(self.given_t - self.t) <= self.at.t_error + self.t_rounding)
        return other | (self.given_hit & self.hit & wrong_t)

    def right_under(self, hit: np.ndarray, t: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """(m,) bool: the subject's hit or miss and its t agree with a prediction, within FIT_FACTOR times the bound.

        A larger difference is accepted if it is at most a hundredth of the error and a ten-thousandth of t.
        """
        same: np.ndarray = self.given_hit == hit
        if self.judge.answer.hits_only:
            return same
        with np.errstate(invalid="ignore", over="ignore"):
            left = np.abs(self.given_t - t)
            error = np.where(np.isfinite(self.t), np.abs(self.given_t - self.t), np.inf)
            loose = np.minimum(LARGEST_RESIDUAL * error, MATCH_RTOL * np.abs(t))
            bound = np.where(np.isfinite(bound), FIT_FACTOR * (bound + self.t_rounding), 0.0)
            near = left <= np.maximum(bound, loose) + np.finfo(np.float64).tiny
            better = self.off & (left <= MAJORITY * error)  # of two bounds, a third of one explains nothing
            return same & (~hit | (near & (better | ~self.off)))

    @cached_property
    def roots(self) -> RayIntersections:
        """All intersections of the lines, before and behind the origins; `ray` is the place here."""
        t_max = self.judge.t_max[self.rows]
        return self.judge.bracket.possible_hits(self.o, self.d, t_max, np.full(len(self.rows), -np.inf))


# What a mistake claims beyond the pixels that it explains. SURFACES: nearly all right pixels agree with it. PIXELS: and
# more than a few pixels are wrong. IMAGE: and it explains nearly all wrong hits, not misses alone.
NOTHING, SURFACES, PIXELS, IMAGE = range(4)


class Mistake(NamedTuple):
    """One row of the table."""

    what: str
    remedy: str  # "": a description of what is wrong, not of why
    predicts: Callable[[WrongPixels], np.ndarray]  # (m,) bool: the subject answers as if it made this mistake
    claim: int = NOTHING
    single: bool = False  # one pixel is enough: nothing is fitted, and no pixel fits by chance
    same_surface: bool = False  # the right surface is hit, so that its normal is judged as well


Explanation = tuple[Mistake, np.ndarray]  # and (m,) bool: the pixels that it explains


def explanations(f: WrongPixels, right: WrongPixels) -> Iterator[Explanation]:
    """The mistakes that explain some pixels of f, in the order of the table. right: pixels that may contradict them."""
    for mistake in mistakes(f):
        if mistake.claim == IMAGE:
            few = f.take(sample_rows(np.arange(len(f.rows)), SCREENED_PIXELS))
            if not _explains_hits(few, mistake.predicts(few)):
                continue
        fits = mistake.predicts(f)
        if fits.any() and _is_kept(mistake, f, fits, right):
            yield mistake, fits


def _explains_hits(f: WrongPixels, fits: np.ndarray) -> bool:
    """Whether nearly all wrong hits fit, not misses alone."""
    hits = f.given_hit & f.off
    good = (fits & hits).sum()
    return bool(good >= MIN_FITTED_PIXELS and good >= NEARLY_ALL * hits.sum() and fits[f.off].mean() >= NEARLY_ALL)


def _is_kept(mistake: Mistake, f: WrongPixels, fits: np.ndarray, right: WrongPixels) -> bool:
    """Whether the claim of a mistake holds: a few wrong pixels may fit one of many mistakes by chance."""
    if mistake.claim == IMAGE and not _explains_hits(f, fits):
        return False
    if mistake.claim == NOTHING or not len(right.rows):
        return True
    enough = mistake.claim == SURFACES or len(f.rows) >= (1.0 - NEARLY_ALL) * len(right.rows)
    return bool(enough and mistake.predicts(right).mean() >= NEARLY_ALL)


def mistakes(f: WrongPixels) -> Iterator[Mistake]:
    """The table, the simplest first; numbers in it are fitted to the wrong pixels f."""
    answer, is_list = f.judge.answer, f.judge.pair.rays.is_list
    if len(answer.t) > 1 and not f.judge.hit.any():  # of one pixel, that means nothing
        who = "ours" if answer.exact_visibility else "the candidate"
        farthest = f.t[~f.given_hit & f.hit].max(initial=0.0)
        remedy = f"is the scene read, do rays reach t = {farthest:.3g}{_epsilon_text(f)}?"
        yield Mistake(f"{who} misses everything", remedy, lambda g: ~g.given_hit & g.hit, single=True)
    if is_list and not answer.hits_only:
        yield from OUT_OF_RANGE
    yield DISTANCE
    if f.judge.scene.camera.type != "ray":
        yield Z_DEPTH
    yield from _fitted_quantities(f)
    if _claims_float64(f):
        yield Mistake(IN_FLOAT32, FLOAT32_REMEDY, _right_in_float32, same_surface=True)
    yield from _image_orders(f.judge.pair.shape, is_list)
    if not is_list:
        yield from BESIDE_CENTERS
    yield from SELECTIONS
    yield from OTHER_RAYS
    yield from HIDDEN


# ---- hits and misses, by themselves

OUT_OF_RANGE = (
    Mistake(
        "a hit before t_min, where the ray begins",
        "leave out hits with t <= t_min",
        lambda g: g.given_t < g.judge.t_min[g.rows],
        single=True,
    ),
    Mistake(
        "a hit beyond t_max, where the ray ends",
        "leave out hits with t > t_max",
        lambda g: (g.given_t > g.judge.t_max[g.rows]) & np.isfinite(g.given_t),
        single=True,
    ),
)


def _epsilon_text(f: WrongPixels) -> str:
    """A question about the determinants of the triangles that are hit; "" if none is."""
    determinants = np.abs(dot(f.d, area_vectors(triangle_corners(f.judge, f.prim))))
    some = determinants[f.hit & np.isfinite(determinants)]
    return f", is every epsilon below the determinants of {range_text(some)} here" if len(some) else ""


# ---- t is another quantity

IN_FLOAT32 = "computed in float32: right by float32's bounds, and given as float64"
FLOAT32_REMEDY = "compute in float64, or state --candidate-precision float32"


def _claims_float64(f: WrongPixels) -> bool:
    """Of a candidate; ours is in float64."""
    return f.judge.answer.precision == FLOAT64 and not f.judge.answer.exact_visibility


def _right_in_float32(g: WrongPixels) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        near = np.abs(g.given_t - g.t) <= g.at.t_error * (KU / KU_OURS) + g.t_rounding
    found: np.ndarray = g.given_hit & g.hit & near
    return found


def _is_t_times(g: WrongPixels, factor: np.ndarray) -> np.ndarray:
    """(m,) bool: the subject gives t times a factor (m,), and that differs from t."""
    with np.errstate(invalid="ignore"):
        other = np.abs(g.t * factor - g.t) > g.at.t_error
    return g.right_under(g.hit, g.t * factor, g.at.t_error * np.abs(factor)) & g.hit & other


DISTANCE = Mistake(
    "distance in place of t, which counts in lengths of d",
    "divide the distance by |d|, or leave d as it is given",
    lambda g: _is_t_times(g, norm(g.d)),
    single=True,
    same_surface=True,
)
Z_DEPTH = Mistake(
    "depth along z, the view axis, in place of t along the ray",
    "divide by the cosine of the ray with the view axis; of an image: --depth z",
    lambda g: _is_t_times(g, unit(g.d) @ camera_axes(g.judge.scene.camera)[2]),
    single=True,
    same_surface=True,
)


def _fitted_quantities(f: WrongPixels) -> Iterator[Mistake]:
    """t plus or times a constant, the median over all pixels, and functions of t."""

    def answers(t: Callable[[np.ndarray], np.ndarray], slope: float = 1.0) -> Callable[[WrongPixels], np.ndarray]:
        def predicts(g: WrongPixels) -> np.ndarray:
            with np.errstate(all="ignore"):
                return g.right_under(g.hit, t(g.t), g.at.t_error * abs(slope)) & g.hit

        return predicts

    some = f.given_hit & f.hit & np.isfinite(f.given_t)
    if some.sum() < MIN_FITTED_PIXELS:
        return
    with np.errstate(all="ignore"):
        offset = float(np.median((f.given_t - f.t)[some]))
        scale = float(np.median((f.given_t / f.t)[some]))
    what = f"t is {abs(offset):.3g} too {'large' if offset > 0 else 'small'} everywhere, a constant"
    remedy = f"leave out the offset (an epsilon?) of {offset:.3g}"
    yield Mistake(what, remedy, answers(lambda t: t + offset), PIXELS, same_surface=True)
    claim = NOTHING if abs(scale - 1.0) > DISTINCT_RTOL else PIXELS  # no chance meets a scale that is far from 1
    what, remedy = (
        f"t is {scale:.7g} times what it should be",
        "look for a wrong unit, a scale or a length that is not 1",
    )
    yield Mistake(what, remedy, answers(lambda t: t * scale, scale), claim, same_surface=True)
    for words, function in (("the square of t", np.square), ("1 / t", np.reciprocal)):
        yield Mistake(f"{words} in place of t", "return t itself", answers(function), same_surface=True)


# ---- pixels in other places


def _image_orders(shape: tuple[int, int], is_list: bool) -> Iterator[Mistake]:
    """The whole image in another order: Mitsuba's answers at other pixels."""
    h, w = shape
    rows = np.arange(h * w).reshape(h, w)

    def order(what: str, remedy: str, there: np.ndarray) -> Mistake:
        """there: for each row, the row whose answer the subject gives."""

        def predicts(g: WrongPixels) -> np.ndarray:
            result, places = g.judge.result, there.ravel()[g.rows]
            t = result.t.astype(np.float64)[places]
            return g.right_under(result.hit[places], t, MATCH_RTOL * np.abs(t))

        return Mistake(what, remedy, predicts, IMAGE)

    if is_list:
        for step in (1, -1):
            what = f"the answers are moved by {step} ray"
            yield order(what, "return them in the order of the rays", np.roll(rows, step))
        return
    yield order("the image is mirrored, left for right", "turn the sign of x", rows[:, ::-1])
    yield order("the image is upside down", "row 0 is the top one: turn the sign of y", rows[::-1])
    yield order("the image is turned by half a turn", "turn the signs of x and y", rows[::-1, ::-1])
    transposed = "the image is transposed, x for y", "rows come first: index y * width + x"
    yield order(*transposed, rows.ravel(order="F"))
    if h != w:
        yield order(*transposed, np.argsort(rows.ravel(order="F")))
    for y, x in product((0, 1, -1), repeat=2):
        if x or y:
            what = f"the image is moved by a whole pixel: {x:+d} to the right, {y:+d} down"
            yield order(what, "look for an index that counts from 1", np.roll(rows, (y, x), (0, 1)))


def _beside_centers(x: float, y: float) -> Mistake:
    """Rays through another place of all pixels, x to the right and y down."""

    def predicts(g: WrongPixels) -> np.ndarray:
        scene, centers = g.judge.scene, pixel_centers(g.judge.scene)
        places = (center[g.rows] + step for center, step in zip(centers, (x, y), strict=True))
        rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, *places)
        return _first_hits(g, rays.o + rays.t_min[:, None] * rays.d, rays.d)

    what = f"rays beside the pixel centres, by ({x:+.2f}, {y:+.2f}) of a pixel to the right and down"
    return Mistake(what, "the centre of pixel (x, y) is at (x + 0.5, y + 0.5)", predicts, IMAGE)


BESIDE_CENTERS = tuple(_beside_centers(x, y) for x, y in product((-0.5, 0.0, 0.5), repeat=2) if x or y)


# ---- other rays


def _first_hits(g: WrongPixels, o: np.ndarray, d: np.ndarray, t_factor: float = 1.0) -> np.ndarray:
    """(m,) bool: the subject gives the first hits along o + t d, with t times a factor."""
    roots = g.judge.bracket.possible_hits(o, d, g.judge.t_max[g.rows] / t_factor)
    return _right_among(g, roots, np.ones(len(roots.ray), bool), t_factor=t_factor)


def _right_among(
    g: WrongPixels, roots: RayIntersections, kept: np.ndarray, *, last: bool = False, t_factor: float = 1.0
) -> np.ndarray:
    """(m,) bool: the subject gives the first (or last) of the kept roots, or a miss if there is none.

    A prediction that equals the exact answer explains no wrong pixel.
    """
    roots = roots.take(kept)
    t_min, t_max = g.judge.t_min[g.rows][roots.ray], g.judge.t_max[g.rows][roots.ray]
    at = roots.at
    t, bound = at.t * t_factor, at.t_error * t_factor
    ahead = (t > t_min) & (t <= t_max)
    certain = ahead & at.certain
    first = np.full(len(g.rows), -np.inf if last else np.inf)
    (np.maximum if last else np.minimum).at(first, roots.ray[certain], t[certain])
    each = g.take(roots.ray)
    with np.errstate(invalid="ignore"):
        in_turn = t >= first[roots.ray] - bound if last else t <= first[roots.ray] + bound
        other = ~g.off[roots.ray] | ~each.hit | (np.abs(t - each.t) > each.at.t_error)
    matches = ahead & in_turn & other & each.right_under(np.ones(len(t), bool), t, bound)
    found = ~g.given_hit
    found[roots.ray[ahead]] = False  # at an edge, no root is certain, and a miss may be another mistake
    found[roots.ray[matches & each.given_hit]] = True
    return found


Lines = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # (o, d) -> the rays that are cast


def _other_rays() -> Iterator[Mistake]:
    def ray(what: str, remedy: str, lines: Lines, t_factor: float = 1.0) -> Mistake:
        return Mistake(what, remedy, lambda g: _first_hits(g, *lines(g.o, g.d), t_factor), IMAGE)

    def of_scale(s: float) -> Mistake:
        what = f"the scene is {s:g} times as large as it should be"
        return ray(what, "use vertices in the units of the rays", lambda o, d: (o / s, d), s)

    def of_axis(s: np.ndarray, name: str) -> Iterator[Mistake]:
        what = f"the {name} axis of directions is turned round"
        yield ray(what, f"turn the sign of d.{name}", lambda o, d: (o, d * s))
        what = f"the {name} axis is turned round, of another handedness"
        yield ray(what, f"use the same axes for rays and scene: turn the sign of {name}", lambda o, d: (o * s, d * s))

    def of_order(p: tuple[int, ...]) -> Iterator[Mistake]:
        what = f"are exchanged: ({', '.join('xyz'[i] for i in p)}) in place of (x, y, z)"
        remedy = "use the same axes for rays and scene (y up or z up?)"
        yield ray(f"the axes of directions {what}", remedy, lambda o, d: (o, d[:, p]))
        yield ray(f"the axes of rays {what}", remedy, lambda o, d: (o[:, p], d[:, p]))

    yield ray("the directions are reversed: -d in place of d", "turn the sign of d", lambda o, d: (o, -d))
    for axis, name in enumerate("xyz"):
        yield from of_axis(np.where(np.arange(3) == axis, -1.0, 1.0), name)
    for order in permutations(range(3)):
        yield from of_order(order) if order != (0, 1, 2) else ()
    what = "the rays' origin is taken for (0, 0, 0)"
    yield ray(what, "subtract, or add, the ray's origin", lambda o, d: (0.0 * o, d))
    yield ray("origin and direction are exchanged", "o comes first", lambda o, d: (d, o))
    for scale in (0.001, 0.01, 0.0254, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0):
        yield of_scale(scale)


OTHER_RAYS = tuple(_other_rays())


# ---- the wrong one of several hits


def _faces(f: WrongPixels) -> np.ndarray:
    """(r,) normal . d at each root: positive where the ray hits the back of the surface."""
    return dot(f.roots.at.n, f.d[f.roots.ray])


def _pairs(roots: RayIntersections) -> np.ndarray:
    """(r,) group number: roots of the same ray and primitive."""
    return row_groups(np.column_stack([roots.ray, roots.prim]))


def _first_roots(roots: RayIntersections) -> np.ndarray:
    """(r,) the smallest t of the same ray and primitive."""
    pair = _pairs(roots)
    smallest = np.full(len(pair), np.inf)
    np.minimum.at(smallest, pair, roots.at.t)
    return smallest[pair]


def _is_first(roots: RayIntersections) -> np.ndarray:
    """(r,) bool: the first root of its primitive, also behind the origin."""
    first: np.ndarray = roots.at.t == _first_roots(roots)
    return first


def _is_first_ahead(f: WrongPixels) -> np.ndarray:
    """(r,) bool: the first root of its primitive that is ahead of the origin."""
    ahead = f.roots.at.t > f.judge.t_min[f.rows][f.roots.ray]
    kept = ahead.copy()
    kept[ahead] = _is_first(f.roots.take(ahead))
    return kept


def _is_last_prim(f: WrongPixels) -> np.ndarray:
    """(r,) bool: the same, of the primitive with the largest number on its ray."""
    kept = _is_first_ahead(f)
    last = np.full(len(f.rows), -1)
    np.maximum.at(last, f.roots.ray[kept], f.roots.prim[kept])
    found: np.ndarray = kept & (f.roots.prim == last[f.roots.ray])
    return found


def _is_far_or_only(f: WrongPixels) -> np.ndarray:
    """(r,) bool: not the first root of its primitive, unless there is no other."""
    pair, other = _pairs(f.roots), ~_is_first(f.roots)
    found: np.ndarray = other | (np.bincount(pair, other)[pair] == 0)
    return found


def _selection(
    what: str, remedy: str, kept: Callable[[WrongPixels], np.ndarray], *, last: bool = False, single: bool = False
) -> Mistake:
    """A caster that considers only some intersections. kept: (r,) bool of the roots of its pixels."""

    def predicts(g: WrongPixels) -> np.ndarray:
        return _right_among(g, g.roots, kept(g), last=last) & (g.hit | ~g.given_hit)

    return Mistake(what, remedy, predicts, SURFACES, single)


HIT_BOTH_SIDES = "hit both sides: no test of the sign of the determinant or of n . d"
SELECTIONS = (
    _selection(
        "another root of the surface that is hit first, such as the far one",
        "take the smaller root that is ahead of the origin",
        _is_far_or_only,
        single=True,
    ),
    _selection(
        "missed: the surface's first root is behind the ray's origin, and the second one was not tried",
        "where the first root is not ahead, try the second",
        lambda g: _is_first(g.roots) | ~(_first_roots(g.roots) < 0.0),
        single=True,
    ),
    _selection(
        "back faces are culled: surfaces seen from behind are missed", HIT_BOTH_SIDES, lambda g: _faces(g) < 0.0
    ),
    _selection(
        "front faces are culled: surfaces seen from the front are missed", HIT_BOTH_SIDES, lambda g: _faces(g) > 0.0
    ),
    _selection(
        "the last surface in the order of the scene in place of the nearest",
        "keep a hit only where its t is smaller than that of the last one kept",
        _is_last_prim,
    ),
    _selection(
        "the last surface along the ray in place of the first",
        "keep the hit with the smallest t",
        _is_first_ahead,
        last=True,
    ),
)


def _behind_first(g: WrongPixels) -> np.ndarray:
    """(m,) bool: a surface behind the first one is answered."""
    if g.judge.answer.hits_only or not g.given_hit.any():
        return np.zeros(len(g.rows), bool)
    t = g.given_t[g.roots.ray]
    with np.errstate(invalid="ignore"):
        on_one = np.abs(t - g.roots.at.t) <= np.maximum(g.roots.at.t_error, MATCH_RTOL * np.abs(t))
        farther = g.given_hit & (g.given_t > g.t * (1.0 + DISTINCT_RTOL))
    behind = np.zeros(len(g.rows), bool)
    behind[g.roots.ray[on_one]] = True
    return behind & farther & g.hit


def _hidden(g: WrongPixels) -> np.ndarray:
    """(m,) bool: a miss, or a surface behind the first one, if both occur."""
    missed, behind = ~g.given_hit & g.hit, _behind_first(g)
    return (missed | behind) & bool(missed.any() and behind.any())


HIDDEN = (
    Mistake("the first surface is missed, and what lies behind it is hit, if anything", "", _hidden),
    Mistake("a surface that lies behind the first one", "", _behind_first),
)


# ---- normals


class NormalMistake(NamedTuple):
    """One row of the table of normals, reported if it explains enough of the wrong ones."""

    what: str
    remedy: str
    fits: np.ndarray  # (m,) bool: the normal is that of a caster that makes this mistake
    share: float = NEARLY_ALL  # of the normals that are wrong
    least: int = MIN_FITTED_PIXELS


def explain_normals(f: WrongPixels, n: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """(what, remedy, (m,) bool) of wrong normals n (m, 3) at right surfaces: each is in one of them."""
    error = row_distance(n, f.at.n)
    left = ~(error <= np.minimum(f.at.n_error, LARGEST_USEFUL_NORMAL_ERROR))
    for row in _normal_mistakes(f, n, error, left.copy()) if left.any() else ():
        fits = left & row.fits
        if fits.any() and fits.sum() >= max(row.share * left.sum(), row.least):
            yield row.what, row.remedy, fits
            left &= ~fits
    finite = left & np.isfinite(error)
    if finite.any():
        yield f"the normal is off by {range_text(error[finite])} of its length", "", left


def _normal_mistakes(f: WrongPixels, n: np.ndarray, error: np.ndarray, off: np.ndarray) -> Iterator[NormalMistake]:
    """The table, the simplest first. off: (m,) bool, the wrong ones."""
    right, d = f.at.n, f.d

    def given(predicted: np.ndarray) -> np.ndarray:
        """(m,) bool: these normals are given, and are other than the right ones."""
        fits: np.ndarray = (row_distance(n, predicted) <= MATCH_RTOL) & (row_distance(predicted, right) > DISTINCT_RTOL)
        return fits

    def varied(predicted: np.ndarray) -> np.ndarray:
        """The same where the right normals are not all alike."""
        fits = given(predicted)
        some = right[fits & off]
        return fits & bool(len(some) and np.ptp(some, axis=0).max() > DISTINCT_RTOL)

    opposite = row_distance(n, -right) <= MATCH_RTOL
    what = "the normal is turned towards the ray; geometric normals point outside, whoever looks"
    yield NormalMistake(what, "do not turn normals by the sign of n . d", opposite & (dot(right, d) > 0.0), least=1)
    yield NormalMistake(
        "the normal is turned round", "turn its sign: normals point outside", given(-right), 0.0, least=1
    )
    what = "the interpolated normal in place of the geometric one"
    remedy = "return the normal of the face, the cross product of its edges"
    yield NormalMistake(what, remedy, given(f.at.sh_n), 0.0, least=1)
    if f.judge.scene.camera.type != "ray":
        axes = np.asarray(camera_axes(f.judge.scene.camera))
        for signs in product((1.0, -1.0), repeat=3):
            what = "the normal is in the camera's axes in place of the world's"
            yield NormalMistake(what, "turn it by the camera's matrix", varied((right @ axes.T) * signs))
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if order != (0, 1, 2) or len(set(signs)) > 1:
            names = ", ".join("-"[: s < 0] + "xyz"[i] for i, s in zip(order, signs, strict=True))
            what = f"the normal's axes are permuted or signed: ({names}) in place of (x, y, z)"
            yield NormalMistake(what, "use the same axes for normals and scene", varied(right[:, order] * signs))
    with np.errstate(invalid="ignore"):
        p = f.o + np.where(np.isfinite(f.t), f.t, 0.0)[:, None] * d
    alike = np.broadcast_to(np.median(n[off], axis=0), n.shape)
    ray = "the ray's direction in place of the normal"
    for what, remedy, predicted in (
        ("the normal is stored as a colour, (n + 1) / 2", "return n itself, from -1 to 1", unit(right + 1.0)),
        ("the position in place of the normal", "subtract the centre", unit(p)),
        (ray, "return the surface's normal", unit(d)),
        (f"{ray}, reversed", "return the surface's normal", -unit(d)),
        ("one normal everywhere", "compute it for each hit", alike),
    ):
        yield NormalMistake(what, remedy, varied(predicted))
    what = "the normal is computed from corners minus the ray's origin, and lost digits there"
    remedy = "compute it from the edges of the face, or in float64"
    yield NormalMistake(what, remedy, _of_corners_seen_from_the_origin(f, n, error), MAJORITY)
    if _claims_float64(f):
        with np.errstate(invalid="ignore"):
            yield NormalMistake(IN_FLOAT32, FLOAT32_REMEDY, error <= f.at.n_error * (KU / KU_OURS))


# A choice: a mistake that names what is wrong leaves no more than so much of an error.
MAX_SHARE_OF_ERROR_LEFT = 0.5


def _of_corners_seen_from_the_origin(f: WrongPixels, n: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(m,) bool: normals of triangles, right but for the rounding of corner - o to float32."""
    if f.judge.answer.precision != FLOAT32:
        return np.zeros(len(n), bool)
    corners = triangle_corners(f.judge, f.prim)
    with np.errstate(invalid="ignore", over="ignore"):
        seen = (corners.astype(np.float32) - f.o.astype(np.float32)[:, None]).astype(np.float64)
        predicted = unit(area_vectors(seen))
        left = row_distance(n, predicted)
        found: np.ndarray = (left <= FIT_FACTOR * f.at.n_error) & (left < MAX_SHARE_OF_ERROR_LEFT * error)
    return found


def triangle_corners(judge: Judge, prim: np.ndarray) -> np.ndarray:
    """(m, 3, 3) corners of primitives; NaN for those that are no triangles."""
    packed = judge.model.packed
    corners = np.full((len(prim), 3, 3), np.nan)
    place, k = kinds_of(packed, prim)
    for number, kind in enumerate(packed.kinds):
        if isinstance(kind.prims, Triangles):
            rows = np.flatnonzero((place == number) & (prim >= 0))
            corners[rows] = kind.prims.vertices[kind.prims.faces[k[rows]]]
    return corners


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """(m, 3) normals of triangles (m, 3, 3), twice as long as their area."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def range_text(sizes: np.ndarray) -> str:
    """From the smallest to the largest."""
    low, high = f"{sizes.min():.2g}", f"{sizes.max():.2g}"
    return low if low == high else f"{low} to {high}"
