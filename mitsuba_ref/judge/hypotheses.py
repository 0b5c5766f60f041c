"""Hypotheses about a subject's wrong pixels: named mistakes, each with what it predicts there, tried in a fixed order.

A hypothesis only explains pixels that fail. It predicts what a caster with that mistake answers; a wrong pixel becomes
right under it where the subject answers just that. What a mistake leaves alone has to be right under it, too.
"""

from collections.abc import Callable, Iterator, Sequence
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

SCREENED_PIXELS = 96  # at which a costly hypothesis is tried first
RIGHT_PIXELS = 512  # that have to stay right under a hypothesis


@dataclass(frozen=True)
class WrongPixels:
    """Rows of the image, and what is exactly right there."""

    judge: Judge
    rows: np.ndarray  # (m,)
    hit: np.ndarray  # (m,) bool, exactly
    t: np.ndarray  # (m,) exact, inf on a miss
    prim: np.ndarray  # (m,) -1 on a miss
    at: Intersections  # (m,) there, as the subject may see it

    def take(self, some: np.ndarray) -> "WrongPixels":
        """Some of them, by mask or index."""
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
        """(m,) how far t is off because it was stored as something else."""
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
        """(m,) bool: the subject's hit or miss and t are what is predicted, within FIT_FACTOR times the bound.

        Or nearly so: a hundredth of the error is left, and a ten-thousandth of t.
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


class Explained(NamedTuple):
    """What a hypothesis makes right."""

    what: str
    remedy: str
    fits: np.ndarray  # (m,) bool
    single: bool = False  # also of fewer than MIN_FITTED_PIXELS: nothing is fitted, and chance makes none right


# wrong pixels, right ones (which must stay so) -> what it explains; nothing where it does not apply
Hypothesis = Callable[[WrongPixels, WrongPixels], Iterator[Explained]]


# ---- t is another quantity

IN_FLOAT32 = "computed in float32: right by float32's bounds, and given as float64"
FLOAT32_REMEDY = "compute in float64, or state --candidate-precision float32"


def _claims_float64(f: WrongPixels) -> bool:
    """Of a candidate; ours is in float64."""
    return f.judge.answer.precision == FLOAT64 and not f.judge.answer.exact_visibility


def float32_inside(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    if not _claims_float64(f):
        return
    with np.errstate(invalid="ignore"):
        near = np.abs(f.given_t - f.t) <= f.at.t_error * (KU / KU_OURS) + f.t_rounding
    yield Explained(IN_FLOAT32, FLOAT32_REMEDY, f.given_hit & f.hit & near)


def other_quantity(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """t times, or plus, something."""
    factors = [
        (
            norm(f.d),
            "distance in place of t, which counts in lengths of d",
            "divide the distance by |d|, or leave d as it is given",
        )
    ]
    if f.judge.scene.camera.type != "ray":
        cosine = unit(f.d) @ camera_axes(f.judge.scene.camera)[2]
        what = "depth along z, the view axis, in place of t along the ray"
        factors += [(cosine, what, "divide by the cosine of the ray with the view axis; of an image: --depth z")]
    for factor, what, remedy in factors:
        fits = f.right_under(f.hit, f.t * factor, f.at.t_error * np.abs(factor))
        with np.errstate(invalid="ignore"):
            fits &= np.abs(f.t * factor - f.t) > f.at.t_error  # elsewhere it is t itself, and explains nothing
        yield Explained(what, remedy, fits & f.hit, single=True)
    some = f.given_hit & f.hit & np.isfinite(f.given_t)
    if some.sum() < MIN_FITTED_PIXELS:
        return
    with np.errstate(all="ignore"):
        offset = float(np.median((f.given_t - f.t)[some]))
        scale = float(np.median((f.given_t / f.t)[some]))
    what = f"t is {abs(offset):.3g} too {'large' if offset > 0 else 'small'} everywhere, a constant"
    fits = f.right_under(f.hit, f.t + offset, f.at.t_error)
    if _is_kept(f, right.right_under(right.hit, right.t + offset, right.at.t_error)):
        yield Explained(what, f"leave out the offset (an epsilon?) of {offset:.3g}", fits & f.hit)
    what = f"t is {scale:.7g} times what it should be"
    fits = f.right_under(f.hit, f.t * scale, f.at.t_error * abs(scale))
    stay = right.right_under(right.hit, right.t * scale, right.at.t_error * abs(scale))
    if abs(scale - 1.0) > DISTINCT_RTOL or _is_kept(f, stay):  # no chance meets a scale that is far from 1
        yield Explained(what, "look for a wrong unit, a scale or a length that is not 1", fits & f.hit)
    with np.errstate(all="ignore"):
        for words, t in (("the square of t", f.t**2), ("1 / t", 1.0 / f.t), ("the logarithm of t", np.log(f.t))):
            yield Explained(f"{words} in place of t", "return t itself", f.right_under(f.hit, t, f.at.t_error) & f.hit)


# ---- pixels in other places, rays that are others


def _image_orders(shape: tuple[int, int], is_list: bool) -> Iterator[tuple[str, str, np.ndarray]]:
    """(sentence, remedy, (n,) the row whose answer stands at each row)."""
    h, w = shape
    rows = np.arange(h * w).reshape(h, w)
    if is_list:
        yield "the answers are in reverse order", "return them in the order of the rays", rows.ravel()[::-1]
        for step in (1, -1):
            yield (f"the answers are moved by {step} ray", "return them in the order of the rays", np.roll(rows, step))
        return
    yield "the image is mirrored, left for right", "turn the sign of x", rows[:, ::-1]
    yield "the image is upside down", "row 0 is the top one: turn the sign of y", rows[::-1]
    yield "the image is turned by half a turn", "turn the signs of x and y", rows[::-1, ::-1]
    what, remedy = "the image is transposed, x for y", "rows come first: index y * width + x"
    yield what, remedy, rows.ravel(order="F")
    if h != w:
        yield what, remedy, np.argsort(rows.ravel(order="F"))
    else:
        for turns, words in ((1, "left"), (3, "right")):
            yield (f"the image is turned by a quarter to the {words}", "exchange x and y", np.rot90(rows, turns))
    for y, x in product((0, 1, -1), repeat=2):
        if x or y:
            where = f"{x:+d} to the right, {y:+d} down"
            remedy = "look for an index that counts from 1"
            yield f"the image is moved by a whole pixel: {where}", remedy, np.roll(rows, (y, x), (0, 1))


def other_order(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """The whole image in another order, by Mitsuba's answer at those places."""
    hit, t = f.judge.result.hit, f.judge.result.t.astype(np.float64)
    for what, remedy, order in _image_orders(f.judge.pair.shape, f.judge.pair.rays.is_list):
        fits, stay = (
            g.right_under(hit[there], t[there], MATCH_RTOL * np.abs(t[there]))
            for g in (f, right)
            for there in (order.ravel()[g.rows],)
        )
        if _explains_hits(f, fits) and _is_kept(f, stay):
            yield Explained(what, remedy, fits)


def _explains_hits(f: WrongPixels, fits: np.ndarray) -> bool:
    """Whether hits fit, not misses alone."""
    hits = f.given_hit & f.off
    good = (fits & hits).sum()
    return bool(good >= MIN_FITTED_PIXELS and good >= NEARLY_ALL * hits.sum() and fits[f.off].mean() >= NEARLY_ALL)


def _is_kept(f: WrongPixels, stay: np.ndarray) -> bool:
    """Whether what is said of all pixels is true of nearly all right ones, too, and these are not nearly all there are.

    stay: (r,) bool of right ones, at most RIGHT_PIXELS. A few wrong ones fit one of many such hypotheses by chance.
    """
    if not len(stay):
        return True
    return bool(stay.mean() >= NEARLY_ALL and len(f.rows) >= (1.0 - NEARLY_ALL) * len(stay))


class OtherRay(NamedTuple):
    """Another ray and what it does to t."""

    what: str
    remedy: str
    lines: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # (o, d) -> (o, d)
    t_factor: float = 1.0


def _signs(which: tuple[int, ...]) -> np.ndarray:
    return np.where(np.isin(np.arange(3), which), -1.0, 1.0)


def _other_rays() -> Iterator[OtherRay]:
    what = "the directions are reversed: -d in place of d"
    yield OtherRay(what, "turn the sign of d", lambda o, d: (o, -d))
    for axis, name in enumerate("xyz"):
        signs = _signs((axis,))
        what = f"the {name} axis of directions is turned round"
        yield OtherRay(what, f"turn the sign of d.{name}", lambda o, d, s=signs: (o, d * s))  # type: ignore[misc]
        what = f"the {name} axis is turned round, of another handedness"
        remedy = f"use the same axes for rays and scene: turn the sign of {name}"
        yield OtherRay(what, remedy, lambda o, d, s=signs: (o * s, d * s))  # type: ignore[misc]
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            names = ", ".join("xyz"[i] for i in order)
            what = f"are exchanged: ({names}) in place of (x, y, z)"
            remedy = "use the same axes for rays and scene (y up or z up?)"
            yield OtherRay(f"the axes of directions {what}", remedy, lambda o, d, p=order: (o, d[:, p]))  # type: ignore[misc]
            yield OtherRay(f"the axes of rays {what}", remedy, lambda o, d, p=order: (o[:, p], d[:, p]))  # type: ignore[misc]
    what, remedy = "the rays' origin is taken for (0, 0, 0)", "subtract, or add, the ray's origin"
    yield OtherRay(what, remedy, lambda o, d: (0.0 * o, d))
    yield OtherRay("origin and direction are exchanged", "o comes first", lambda o, d: (d, o))
    for scale in (0.001, 0.01, 0.0254, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0):
        what = f"the scene is {scale:g} times as large as it should be"
        remedy = "use vertices in the units of the rays"
        yield OtherRay(what, remedy, lambda o, d, s=scale: (o / s, d), scale)  # type: ignore[misc]


OTHER_RAYS = tuple(_other_rays())


def other_rays(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """First hits along other rays, tried on a few pixels first."""
    few = f.take(sample_rows(np.flatnonzero(f.off), SCREENED_PIXELS))
    for ray in OTHER_RAYS:
        if _explains_hits(few, _first_hit_along(few, ray)):
            fits = _first_hit_along(f, ray)
            if _explains_hits(f, fits) and _is_kept(f, _first_hit_along(right, ray, or_exact=True)):
                yield Explained(ray.what, ray.remedy, fits)


def _first_hit_along(f: WrongPixels, ray: OtherRay, *, or_exact: bool = False) -> np.ndarray:
    """(m,) bool: right under first hits along these rays."""
    return _first_hits(f, *ray.lines(f.o, f.d), ray.t_factor, or_exact=or_exact)


def _first_hits(
    f: WrongPixels, o: np.ndarray, d: np.ndarray, t_factor: float = 1.0, *, or_exact: bool = False
) -> np.ndarray:
    """(m,) bool: right under first hits along o + t d, where t is counted times a factor."""
    roots = f.judge.bracket.possible_hits(o, d, f.judge.t_max[f.rows] / t_factor)
    return _right_among(f, roots, np.ones(len(roots.ray), bool), t_factor=t_factor, or_exact=or_exact)


def _right_among(
    f: WrongPixels,
    roots: RayIntersections,
    kept: np.ndarray,
    *,
    last: bool = False,
    t_factor: float = 1.0,
    or_exact: bool = False,
) -> np.ndarray:
    """(m,) bool: the subject answers the first of the roots that are kept, before nothing that is certain.

    Or the last of them; or a miss, where there is none. or_exact: also where that is the exact answer, by which no
    wrong pixel is explained.
    """
    roots = roots.take(kept)
    t_min, t_max = f.judge.t_min[f.rows][roots.ray], f.judge.t_max[f.rows][roots.ray]
    at = roots.at
    t, bound = at.t * t_factor, at.t_error * t_factor
    ahead = (t > t_min) & (t <= t_max)
    certain = ahead & at.certain
    first = np.full(len(f.rows), -np.inf if last else np.inf)
    (np.maximum if last else np.minimum).at(first, roots.ray[certain], t[certain])
    with np.errstate(invalid="ignore"):
        in_turn = t >= first[roots.ray] - bound if last else t <= first[roots.ray] + bound
    each = f.take(roots.ray)
    with np.errstate(invalid="ignore"):
        other = or_exact | ~each.hit | (np.abs(t - each.t) > each.at.t_error)
    matches = ahead & in_turn & other & each.right_under(np.ones(len(t), bool), t, bound)
    found = ~f.given_hit
    found[roots.ray[ahead]] = False  # at an edge, no root is certain, and a miss may be another mistake
    found[roots.ray[matches & each.given_hit]] = True
    return found


# ---- a shift of the image by parts of a pixel

SLOPE_STEP_PIXELS = 0.125  # of a pixel, over which the slopes of t are taken
NEWTON_STEPS = 3  # of Newton's method
MIN_DIFFERING_PIXELS = 16  # pixels from which a shift is computed
MAX_SHIFT_PIXELS = 4.0  # pixels


def shifted_image(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """Rays through another place of their pixels, the same everywhere, found by Newton's method from t."""
    if f.judge.pair.rays.is_list or f.judge.answer.hits_only:
        return
    seen = f.take(sample_rows(np.flatnonzero(f.given_hit & f.hit), SHIFT_SAMPLES))
    if len(seen.rows) < MIN_DIFFERING_PIXELS:
        return
    shift = np.zeros(2)
    for _ in range(NEWTON_STEPS):
        step = _newton_step(seen, shift)
        if step is None or not np.abs(shift + step).max() < MAX_SHIFT_PIXELS:
            return
        shift = shift + step
    if np.abs(shift).max() > SLOPE_STEP_PIXELS / 4:
        where = f"({shift[0]:+.2f}, {shift[1]:+.2f}) of a pixel to the right and down"
        remedy = "the centre of pixel (x, y) is at (x + 0.5, y + 0.5)"
        what = f"rays beside the pixel centres, by {where}"
        fits = _first_hits(f, *_rays_at(f, shift))
        if _explains_hits(f, fits) and _is_kept(f, _first_hits(right, *_rays_at(right, shift), or_exact=True)):
            yield Explained(what, remedy, fits)


SHIFT_SAMPLES = 1024  # pixels from which a shift is computed, at most


def _rays_at(f: WrongPixels, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """o, d through another place of the pixels. shift: (2,) pixels to the right and down."""
    scene = f.judge.scene
    x, y = (centers[f.rows] for centers in pixel_centers(scene))
    rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x + shift[0], y + shift[1])
    return rays.o + rays.t_min[:, None] * rays.d, rays.d


def _t_at(f: WrongPixels, shift: np.ndarray) -> np.ndarray:
    """(m,) t of the same primitives along those rays, the root nearest to t."""
    met = f.judge.model.intersect(f.prim, *_rays_at(f, shift), f.judge.answer.ku, ours=True)
    found = np.full(len(f.rows), np.nan)
    order = np.argsort(-np.abs(met.at.t - f.t[met.pair]), kind="stable")  # the nearest comes last, and stays
    found[met.pair[order]] = met.at.t[order]
    return found


def _newton_step(f: WrongPixels, at: np.ndarray) -> np.ndarray | None:
    """One step by the slopes at where the last one led; the fifth that fits least does not count."""
    here = _t_at(f, at)
    across = [_t_at(f, at + step) - here for step in SLOPE_STEP_PIXELS * np.eye(2)]
    slopes = np.column_stack(across) / SLOPE_STEP_PIXELS
    fine = np.isfinite(slopes).all(axis=1) & np.isfinite(here)
    off = f.given_t - here
    fine &= np.abs(off) <= np.quantile(np.abs(off)[fine], 0.8) if fine.any() else fine
    if fine.sum() < MIN_DIFFERING_PIXELS:
        return None
    step: np.ndarray = np.linalg.lstsq(slopes[fine], off[fine], rcond=None)[0]
    return step


# ---- the wrong one of several hits


class Selection(NamedTuple):
    """Roots that a caster with this mistake considers."""

    what: str
    remedy: str
    kept: Callable[[WrongPixels], np.ndarray]  # (r,) bool of f.roots
    last: bool = False
    single: bool = False  # as of Explained


def _faces(f: WrongPixels) -> np.ndarray:
    """(r,) cosine-like: positive where a root leaves through the back of its surface."""
    return dot(f.roots.at.n, f.d[f.roots.ray])


def _is_first_root(f: WrongPixels, roots: RayIntersections | None = None) -> np.ndarray:
    """(r,) bool: the first root of its primitive among these, or all, wherever that is."""
    roots = f.roots if roots is None else roots
    first: np.ndarray = roots.at.t == _first_roots(roots)
    return first


def _first_roots(roots: RayIntersections) -> np.ndarray:
    """(r,) the smallest t of the same ray and primitive."""
    pair = row_groups(np.column_stack([roots.ray, roots.prim]))
    smallest = np.full(len(pair), np.inf)
    np.minimum.at(smallest, pair, roots.at.t)
    return smallest[pair]


def _is_first_ahead(f: WrongPixels) -> np.ndarray:
    """(r,) bool: the first root of its primitive that is ahead of the origin."""
    ahead = f.roots.at.t > f.judge.t_min[f.rows][f.roots.ray]
    kept = ahead.copy()
    kept[ahead] = _is_first_root(f, f.roots.take(ahead))
    return kept


def _is_last_prim(f: WrongPixels) -> np.ndarray:
    """(r,) bool: the same, of the primitive with the largest number on its ray."""
    kept = _is_first_ahead(f)
    last = np.full(len(f.rows), -1)
    np.maximum.at(last, f.roots.ray[kept], f.roots.prim[kept])
    found: np.ndarray = kept & (f.roots.prim == last[f.roots.ray])
    return found


def _is_only_root(f: WrongPixels) -> np.ndarray:
    """(r,) bool: its primitive has no other."""
    first = _is_first_root(f)
    roots = f.roots
    seconds = {(r, p) for r, p in zip(roots.ray[~first], roots.prim[~first], strict=True)}
    return np.array([(r, p) not in seconds for r, p in zip(roots.ray, roots.prim, strict=True)], bool)


SELECTIONS = (
    Selection(
        "another root of the surface that is hit first, such as the far one",
        "take the smaller root that is ahead of the origin",
        lambda f: ~_is_first_root(f) | _is_only_root(f),
        single=True,
    ),
    Selection(
        "missed: the surface's first root is behind the ray's origin, and the second one was not tried",
        "where the first root is not ahead, try the second",
        lambda f: _is_first_root(f) | ~(_first_roots(f.roots) < 0.0),
        single=True,
    ),
    Selection(
        "back faces are culled: surfaces seen from behind are missed",
        "hit both sides: no test of the sign of the determinant or of n . d",
        lambda f: _faces(f) < 0.0,
    ),
    Selection(
        "front faces are culled: surfaces seen from the front are missed",
        "hit both sides: no test of the sign of the determinant or of n . d",
        lambda f: _faces(f) > 0.0,
    ),
    Selection(
        "the last surface in the order of the scene in place of the nearest",
        "keep a hit only where its t is smaller than that of the last one kept",
        lambda f: _is_last_prim(f),
    ),
    Selection(
        "the last surface along the ray in place of the first",
        "keep the hit with the smallest t",
        lambda f: _is_first_ahead(f),
        last=True,
    ),
)


def other_selection(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """Another of the hits that there are."""
    for each in SELECTIONS:
        fits = _right_among(f, f.roots, each.kept(f), last=each.last) & (f.hit | ~f.given_hit)
        if not fits.any():
            continue
        kept = _right_among(right, right.roots, each.kept(right), last=each.last, or_exact=True)
        if not len(kept) or kept.mean() >= NEARLY_ALL:
            yield Explained(each.what, each.remedy, fits, each.single)


def first_one_missed(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """What is hit first is not seen; what lies behind it is, if anything."""
    missed = ~f.given_hit & f.hit
    behind = np.zeros(len(f.rows), bool)
    if not f.judge.answer.hits_only and f.given_hit.any():
        t = f.given_t[f.roots.ray]
        with np.errstate(invalid="ignore"):
            on_one = np.abs(t - f.roots.at.t) <= np.maximum(f.roots.at.t_error, MATCH_RTOL * np.abs(t))
            farther = f.given_hit & (f.given_t > f.t * (1.0 + DISTINCT_RTOL))
        behind[f.roots.ray[on_one]] = True
        behind &= farther & f.hit
    if missed.any() and behind.any():
        yield Explained("the first surface is missed, and what lies behind it is hit, if anything", "", missed | behind)
    yield Explained("a surface that lies behind the first one", "", behind)


# ---- hits and misses, by themselves


def out_of_range(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    """Of rays of a list: what is answered lies outside of the ray."""
    if f.judge.answer.hits_only or not f.judge.pair.rays.is_list:
        return
    t, t_min, t_max = f.given_t, f.judge.t_min[f.rows], f.judge.t_max[f.rows]
    what = "a hit before t_min, where the ray begins"
    yield Explained(what, "leave out hits with t <= t_min", t < t_min, single=True)
    what = "a hit beyond t_max, where the ray ends"
    yield Explained(what, "leave out hits with t > t_max", (t > t_max) & np.isfinite(t), single=True)


def everything_missed(f: WrongPixels, right: WrongPixels) -> Iterator[Explained]:
    if len(f.judge.answer.t) > 1 and not f.judge.hit.any():  # of one pixel, that means nothing
        who = "ours" if f.judge.answer.exact_visibility else "the candidate"
        what = f"{who} misses everything"
        missed = ~f.given_hit & f.hit
        remedy = f"is the scene read, do rays reach t = {f.t[missed].max(initial=0.0):.3g}{_epsilon_text(f)}?"
        yield Explained(what, remedy, missed, single=True)


def _epsilon_text(f: WrongPixels) -> str:
    """A question about the determinants of the triangles that are hit; "" where none is."""
    corners = triangle_corners(f.judge, f.prim)
    with np.errstate(invalid="ignore"):
        edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        determinants = np.abs(dot(f.d, edges))
    some = determinants[f.hit & np.isfinite(determinants)]
    return f", is every epsilon below the determinants of {range_text(some)} here" if len(some) else ""


# The simplest first: of those that explain nearly all, the first wins.
HYPOTHESES: Sequence[Hypothesis] = (
    everything_missed,
    out_of_range,
    other_quantity,
    float32_inside,
    other_order,
    shifted_image,
    other_selection,
    other_rays,
)
# Where none of them does: of these, and of those, each takes what it explains.
DESCRIPTIONS: Sequence[Hypothesis] = (first_one_missed,)


# ---- normals


class NormalHypothesis(NamedTuple):
    """Normals that a caster with this mistake gives."""

    what: str
    remedy: str
    n: np.ndarray  # (m, 3)


def explain_normals(f: WrongPixels, n: np.ndarray) -> Iterator[Explained]:
    """Wrong normals at right surfaces, n (m, 3) as given: what explains nearly all first, then the rest."""
    right, d = f.at.n, f.d
    error = row_distance(n, right)
    off = ~(error <= np.minimum(f.at.n_error, LARGEST_USEFUL_NORMAL_ERROR))
    if not off.any():
        return
    opposite = off & (row_distance(n, -right) <= MATCH_RTOL)
    towards = dot(right, d) > 0.0
    if (opposite & towards).sum() >= NEARLY_ALL * off.sum():
        what = "the normal is turned towards the ray; geometric normals point outside, whoever looks"
        yield Explained(what, "do not turn normals by the sign of n . d", opposite & towards)
        off &= ~(opposite & towards)
        if not off.any():
            return
    left = off.copy()
    for each in _normal_hypotheses(f, n, off):
        fits = left & (row_distance(n, each.n) <= MATCH_RTOL) & (row_distance(each.n, right) > DISTINCT_RTOL)
        alone = "turned round" in each.what or "interpolated" in each.what
        enough = fits.sum() >= max(NEARLY_ALL * left.sum(), MIN_FITTED_PIXELS)
        if fits.any() and (alone or (enough and np.ptp(right[fits], axis=0).max() > DISTINCT_RTOL)):
            yield Explained(each.what, each.remedy, fits)
            left &= ~fits
    shifted = left & _of_corners_seen_from_the_origin(f, n, error)
    if shifted.sum() >= max(MAJORITY * left.sum(), MIN_FITTED_PIXELS):
        what = "the normal is computed from corners minus the ray's origin, and lost digits there"
        yield Explained(what, "compute it from the edges of the face, or in float64", shifted)
        left &= ~shifted
    with np.errstate(invalid="ignore"):
        single = left & (error <= f.at.n_error * (KU / KU_OURS))
    if _claims_float64(f) and single.sum() >= max(NEARLY_ALL * left.sum(), MIN_FITTED_PIXELS):
        yield Explained(IN_FLOAT32, FLOAT32_REMEDY, single)
        left &= ~single
    finite = left & np.isfinite(error)
    if finite.any():
        yield Explained(f"the normal is off by {range_text(error[finite])} of its length", "", left)


# A choice: a hypothesis that names what is wrong leaves no more than so much of an error.
MAX_SHARE_OF_ERROR_LEFT = 0.5


def _of_corners_seen_from_the_origin(f: WrongPixels, n: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(m,) bool: normals of triangles, right but for the rounding of corner - o to float32."""
    if f.judge.answer.precision != FLOAT32:
        return np.zeros(len(n), bool)
    corners = triangle_corners(f.judge, f.prim)
    with np.errstate(invalid="ignore", over="ignore"):
        seen = (corners.astype(np.float32) - f.o.astype(np.float32)[:, None]).astype(np.float64)
        predicted = unit(np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0]))
        left = row_distance(n, predicted)
        found: np.ndarray = (left <= FIT_FACTOR * f.at.n_error) & (left < MAX_SHARE_OF_ERROR_LEFT * error)
    return found


def _normal_hypotheses(f: WrongPixels, n: np.ndarray, off: np.ndarray) -> Iterator[NormalHypothesis]:
    right, d = f.at.n, f.d
    yield NormalHypothesis("the normal is turned round", "turn its sign: normals point outside", -right)
    what = "the interpolated normal in place of the geometric one"
    yield NormalHypothesis(what, "return the normal of the face, the cross product of its edges", f.at.sh_n)
    if f.judge.scene.camera.type != "ray":
        axes = np.asarray(camera_axes(f.judge.scene.camera))
        for signs in product((1.0, -1.0), repeat=3):
            what = "the normal is in the camera's axes in place of the world's"
            yield NormalHypothesis(what, "turn it by the camera's matrix", (right @ axes.T) * signs)
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if (order, signs) not in (((0, 1, 2), (1.0, 1.0, 1.0)), ((0, 1, 2), (-1.0, -1.0, -1.0))):
            names = ", ".join("-"[: s < 0] + "xyz"[i] for i, s in zip(order, signs, strict=True))
            what = f"the normal's axes are permuted or signed: ({names}) in place of (x, y, z)"
            yield NormalHypothesis(what, "use the same axes for normals and scene", right[:, order] * signs)
    what, remedy = "the normal is stored as a colour, (n + 1) / 2", "return n itself, from -1 to 1"
    yield NormalHypothesis(what, remedy, unit(right + 1.0))
    with np.errstate(invalid="ignore"):
        p = f.o + np.where(np.isfinite(f.t), f.t, 0.0)[:, None] * d
    yield NormalHypothesis("the position in place of the normal", "subtract the centre", unit(p))
    what = "the ray's direction in place of the normal"
    yield NormalHypothesis(what, "return the surface's normal", unit(d))
    yield NormalHypothesis(f"{what}, reversed", "return the surface's normal", -unit(d))
    alike = np.broadcast_to(np.median(n[off], axis=0), n.shape)
    yield NormalHypothesis("one normal everywhere", "compute it for each hit", alike)
    turn = _rotation(right[off], n[off])
    if turn is not None:
        what = "all normals are turned by one rotation"
        yield NormalHypothesis(what, "look for a matrix that is missing, or there twice", right @ turn.T)


def _rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """The rotation that turns rows a nearest to rows b (Kabsch), of those that are finite; None where they do not
    determine it."""
    finite = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    u, s, vt = np.linalg.svd(b[finite].T @ a[finite])
    if s[1] <= DISTINCT_RTOL * s[0]:
        return None
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turned: np.ndarray = u @ flip @ vt
    return turned


def triangle_corners(judge: Judge, prim: np.ndarray) -> np.ndarray:
    """(m, 3, 3) corners of primitives; NaN of those that are no triangles."""
    packed = judge.model.packed
    corners = np.full((len(prim), 3, 3), np.nan)
    shape = packed.shape_of(prim)
    for place, kind in enumerate(packed.kinds):
        if isinstance(kind.prims, Triangles):
            rows = np.flatnonzero((packed.kind_of[shape] == place) & (prim >= 0))
            k = prim[rows] - packed.first[shape[rows]] + packed.start[shape[rows]]
            corners[rows] = kind.prims.vertices[kind.prims.faces[k]]
    return corners


def range_text(sizes: np.ndarray) -> str:
    """From the smallest to the largest."""
    low, high = f"{sizes.min():.2g}", f"{sizes.max():.2g}"
    return low if low == high else f"{low} to {high}"
