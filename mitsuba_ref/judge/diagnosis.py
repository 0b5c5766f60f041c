"""Diagnosis of a subject's failing pixels: sentences, each with the pixels it is true of, by testing common mistakes.

Nothing here decides whether a pixel passes; it only describes the numbers of those that fail.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.error_model.intersections import Intersections, dot, norm, unit
from mitsuba_ref.error_model.tolerances import (
    DISTINCT_RTOL,
    LARGEST_USEFUL_NORMAL_ERROR,
    MAJORITY,
    MATCH_RTOL,
)
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.explanations import open_reason, subject_name
from mitsuba_ref.judge.scene_checks import pixel_centers
from mitsuba_ref.judge.verdict import FAILING, REFERENCE_WRONG, UNDECIDED, WRONG

MAX_DIAGNOSED_PIXELS = 4096  # pixels at which costly hypotheses are tested


class Diagnosis(NamedTuple):
    """Each sentence and the rows of the image, ascending, that it is true of; each failing row has one."""

    rows_of: Mapping[str, np.ndarray]

    def by_row(self) -> dict[int, str]:
        """The sentence of each failing row."""
        return {int(row): what for what, rows in self.rows_of.items() for row in rows}


def failing_rows(judgement: Judgement) -> np.ndarray:
    """Rows of the image that fail, ascending: by their class, or because the reference is wrong in an unknown way."""
    unlisted = np.array([row for row, case in judgement.cases.items() if case is None], np.int64)
    return np.union1d(np.flatnonzero(judgement.is_class(*FAILING)), unlisted)


def diagnose(judge: Judge, judgement: Judgement) -> Diagnosis:
    """The first sentence that is true of each pixel that fails, in the order of `hypotheses`."""
    rows_of: dict[str, np.ndarray] = {}
    left = np.zeros(len(judge.t_max), bool)
    left[failing_rows(judgement)] = True
    if not left.any():
        return Diagnosis(rows_of)

    def say(what: str, rows: np.ndarray) -> None:
        mine = rows[left[rows]]
        if len(mine):
            rows_of[what] = np.union1d(rows_of.get(what, np.zeros(0, np.int64)), mine)
            left[mine] = False

    for what, rows in _marked_misses(judge):
        say(what, rows)
    for why, broken in judge.answer.broken.items():
        say(f"no answer: {why}", np.flatnonzero(broken))
    say("a hit where the camera has no ray", np.flatnonzero((judge.t_max < 0.0) & judge.hit))
    of_mitsuba = np.flatnonzero(judgement.classes == CLASS_CODE[REFERENCE_WRONG])
    say(f"{subject_name(judge)} is right, and Mitsuba wrong in no known way", of_mitsuba)
    for row in np.flatnonzero(left & (judgement.classes == CLASS_CODE[UNDECIDED])):
        say(open_reason(judge, judgement, int(row)), np.array([row]))
    wrong = np.flatnonzero(left & (judgement.classes == CLASS_CODE[WRONG]))
    exact = judgement.exact
    inexact = np.intersect1d(wrong, exact.rows[exact.wrong])
    if len(inexact):
        for what, rows in hypotheses(judge, wrong_pixels(judge, judgement, inexact)):
            say(what, rows)
    for what, rows in _wrong_surface(judge, judgement, wrong[left[wrong]]):
        say(what, rows)
    say("not what is there, in no way that is recognised", np.flatnonzero(left))
    return Diagnosis(rows_of)


def _marked_misses(judge: Judge) -> Iterator[tuple[str, np.ndarray]]:
    """A number in place of inf: the same one wherever Mitsuba misses."""
    rows = np.flatnonzero(~judge.result.hit & (judge.t_max >= 0.0) & (not judge.answer.hits_only))
    t = judge.answer.t[rows]
    if len(rows) > 1 and np.isfinite(t[0]) and (t == t[0]).all():
        yield marked_miss(float(t[0])), rows


def marked_miss(t: float) -> str:
    """The sentence about a number in place of inf."""
    return f"t is {t:.7g} where nothing is hit; a miss has t inf"


class WrongPixels(NamedTuple):
    """Rows of the image where the subject is wrong, and what would be right there."""

    rows: np.ndarray  # (m,)
    hit: np.ndarray  # (m,) bool, exactly
    t: np.ndarray  # (m,) exact, inf on a miss
    prim: np.ndarray  # (m,) -1 on a miss
    at: Intersections  # (m,) there, as the subject may see it

    def take(self, some: np.ndarray) -> "WrongPixels":
        """Some of them, by mask."""
        return WrongPixels(self.rows[some], self.hit[some], self.t[some], self.prim[some], self.at.take(some))


def wrong_pixels(judge: Judge, judgement: Judgement, rows: np.ndarray) -> WrongPixels:
    """These adjudicated rows of the image with the exact answers there."""
    answers = [judgement.exact.of(row) for row in rows]
    t = np.array([np.inf if a is None or a.t is None else float(a.t) for a in answers])
    prim = np.array([-1 if a is None else a.prim for a in answers])
    return WrongPixels(rows, prim >= 0, t, prim, judge.near(rows, prim, t))


def hypotheses(judge: Judge, wrong: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """(sentence, rows it is true of) where the exact answer is another one, the most comprehensive first."""
    shift = None if judge.pair.rays.is_list else find_pixel_shift(judge, wrong)
    if shift is not None:
        where = f"({shift.x:+.2f}, {shift.y:+.2f}) of a pixel to the right and down"
        yield f"rays beside the pixel centres, by {where}", wrong.rows
    if judge.pair.rays.is_list:
        yield from _wrong_range(judge, wrong)
    yield from _wrong_hits(judge, wrong)
    there = wrong.take(judge.hit[wrong.rows] & wrong.hit)
    if len(there.rows):
        if not judge.answer.hits_only:
            yield from _wrong_t(judge, there)
        yield from _wrong_prim(judge, there)
        yield from _wrong_normal(judge, there)


def _wrong_hits(judge: Judge, wrong: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    rows, hit = wrong.rows, judge.hit[wrong.rows]
    missed = rows[~hit & wrong.hit]
    everything = len(judge.answer.t) > 1 and not judge.hit.any()  # of one pixel, that means nothing
    if len(missed) and not everything:
        at = np.flatnonzero(~hit & wrong.hit)
        lines = judge.o[missed], judge.d[missed]
        met = judge.model.intersect(wrong.prim[at], *lines, judge.answer.ku, ours=True)
        begins_inside = np.unique(met.pair[(met.at.t < 0.0) & met.at.possible])
        what = "missed: the surface's first root is behind the ray's origin, and the second one was not tried"
        yield what, missed[begins_inside]
    if len(missed):
        all_missed = f"{subject_name(judge)} misses everything"
        yield all_missed if everything else "missed; exact arithmetic hits", missed
    yield "a hit; exact arithmetic misses", rows[hit & ~wrong.hit]


def _wrong_range(judge: Judge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where what is answered lies outside of the ray."""
    if judge.answer.hits_only:
        return
    t, t_min, t_max = judge.answer.t[f.rows], judge.t_min[f.rows], judge.t_max[f.rows]
    yield "a hit before t_min, where the ray begins", f.rows[t < t_min]
    yield "a hit beyond t_max, where the ray ends", f.rows[(t > t_max) & np.isfinite(t)]


def _wrong_t(judge: Judge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where t is not what it should be."""
    t, d = judge.answer.t[f.rows], judge.d[f.rows]
    t_rounding = np.broadcast_to(judge.answer.t_rounding, judge.answer.t.shape)[f.rows]
    off = ~(np.abs(t - f.t) <= f.at.t_error + t_rounding)
    root = off & _other_root(judge, f, t)
    yield "another root of the surface that is hit first, such as the far one", f.rows[root]
    if judge.scene.camera.type != "ray":
        cosine = unit(d) @ camera_axes(judge.scene.camera)[2]
        what = "depth along z, the view axis, in place of t along the ray"
        yield what, f.rows[_matches_factor(t, f.t, cosine, off)]
    what = "distance in place of t, which counts in lengths of d"
    yield what, f.rows[_matches_factor(t, f.t, norm(d), off)]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(off, t / f.t - 1.0, 0.0)
    if not off.any():
        return
    middle = float(np.median(share[off]))
    same = off & (np.abs(share - middle) <= 0.01 * abs(middle))
    if same.sum() > MAJORITY * off.sum() and same.sum() > 1:
        yield f"t is {1.0 + middle:.7g} times what it should be", f.rows[same]
    behind = off & (share > DISTINCT_RTOL) & _hits_other_surface(judge, f, t)
    yield "a surface that lies behind the first one", f.rows[behind]
    for some, word in ((off & (share < 0.0), "before"), (off & (share > 0.0), "behind")):
        if some.any():
            what = f"t is off: {word} what is hit, by {_range_text(np.abs(share[some]))} of itself"
            yield what, f.rows[some]


def _wrong_prim(judge: Judge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where t is right, and another primitive is named."""
    what, answer, packed = (
        "another primitive than the first one, at the same t",
        judge.answer,
        judge.model.packed,
    )
    if answer.prim is not None:
        yield what, f.rows[answer.prim[f.rows] != f.prim]
    for ids, right in ((answer.shape_id, packed.shape_of), (answer.prim_id, packed.index_in_shape)):
        if ids is not None:
            yield what, f.rows[ids[f.rows] != right(f.prim)]


def _matches_factor(t: np.ndarray, right: np.ndarray, factor: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(m,) bool: t is like `factor` times what is right; where the factor is nearly 1, only if others show it."""
    fits = off & _close(t, right * factor)
    telling = fits & (np.abs(factor - 1.0) > DISTINCT_RTOL)
    return fits if telling.sum() > MAJORITY * off.sum() else telling


def _wrong_normal(judge: Judge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where t is right and the normal is not."""
    n = judge.n
    if n is None:
        return
    n = n[f.rows]
    error = row_distance(n, f.at.n)
    off = ~(error <= np.minimum(f.at.n_error, LARGEST_USEFUL_NORMAL_ERROR))
    towards = dot(f.at.n, judge.d[f.rows]) > 0.0
    opposite = off & (row_distance(n, -f.at.n) <= MATCH_RTOL)
    yield (
        "the normal is turned towards the ray; geometric normals point outside, whoever looks",
        f.rows[opposite & towards],
    )
    yield "the normal is turned round", f.rows[opposite]
    shading = off & (row_distance(n, f.at.sh_n) <= MATCH_RTOL)
    shading &= row_distance(f.at.sh_n, f.at.n) > DISTINCT_RTOL
    yield "the interpolated normal in place of the geometric one", f.rows[shading]
    finite = error[off & np.isfinite(error)]
    if len(finite):
        yield f"the normal is off by {_range_text(finite)} of its length", f.rows[off]


def _wrong_surface(judge: Judge, judgement: Judgement, rows: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where the primitive and t are right: what else of the subject is beyond float64's bounds there."""
    if not judge.names_prims or not len(rows):
        return
    at = judge.bounds.own.take(rows)
    yield from _wrong_normal(
        judge, WrongPixels(rows, at.possible, judge.answer.t[rows], judge.prim[rows], at)
    )
    failing = {check.name: check.fails[rows] for check in judge.self_checks}
    if "diffuse" in judgement.ratios:
        failing["diffuse"] = ~(judgement.ratios["diffuse"][rows] <= 1.0)
    what = "beyond what float64 rounding allows at the primitive that is hit, in {}"
    yield from ((what.format(name), rows[where]) for name, where in failing.items())


def _range_text(sizes: np.ndarray) -> str:
    """From the smallest to the largest."""
    low, high = f"{sizes.min():.2g}", f"{sizes.max():.2g}"
    return low if low == high else f"{low} to {high}"


def _close(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        near: np.ndarray = np.abs(a - b) <= MATCH_RTOL * np.abs(b)
    return near


def _other_root(judge: Judge, f: WrongPixels, t: np.ndarray) -> np.ndarray:
    """(m,) bool: t is a root of the same primitive, though not the first."""
    met = judge.model.intersect(f.prim, judge.o[f.rows], judge.d[f.rows], judge.answer.ku, ours=True)
    found = np.zeros(len(t), bool)
    with np.errstate(invalid="ignore"):
        matches = _close(t[met.pair], met.at.t) & ~_close(met.at.t, f.t[met.pair]) & met.at.possible
    found[met.pair[matches]] = True
    return found


def _hits_other_surface(judge: Judge, f: WrongPixels, t: np.ndarray) -> np.ndarray:
    """(m,) bool: some other surface on the ray is at t."""
    rows = f.rows[:MAX_DIAGNOSED_PIXELS]
    possible = judge.bracket.possible_hits(judge.o[rows], judge.d[rows], judge.t_max[rows], judge.t_min[rows])
    found = np.zeros(len(t), bool)
    found[possible.ray[_close(t[possible.ray], possible.at.t)]] = True
    return found


# ---- a shift of the image that would explain the wrong pixels ----

SLOPE_STEP_PIXELS = 0.125  # of a pixel, over which the slopes of t are taken
NEWTON_STEPS = 3  # of Newton's method
LARGEST_RESIDUAL_RATIO = 0.1  # a shift has to leave less than this of what there is to explain
MIN_EXPLAINED_FRACTION = 0.5  # of the pixels that fail: a shift explains more of them than this
MIN_DIFFERING_PIXELS = 16  # pixels from which a shift is computed
MAX_SHIFT_PIXELS = 4.0  # pixels


class PixelShift(NamedTuple):
    """In pixels, to the right and down."""

    x: float
    y: float

    @property
    def size(self) -> float:
        return max(abs(self.x), abs(self.y))


class ShiftSamples(NamedTuple):
    """Pixels where something is hit, by the subject and exactly."""

    judge: Judge
    rows: np.ndarray  # (m,) of the image
    prim: np.ndarray  # (m,) that is hit
    right: np.ndarray  # (m,) exact t
    t: np.ndarray  # (m,) the subject's
    differs: np.ndarray  # (m,) bool: it is another

    def t_at(self, shift: PixelShift) -> np.ndarray:
        """(m,) t of the same primitives along rays through another place of their pixels, the root nearest to t."""
        scene = self.judge.scene
        x, y = (centers[self.rows] for centers in pixel_centers(scene))
        rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x + shift.x, y + shift.y)
        o = rays.o + rays.t_min[:, None] * rays.d
        met = self.judge.model.intersect(self.prim, o, rays.d, self.judge.answer.ku, ours=True)
        found = np.full(len(self.rows), np.nan)
        away = np.abs(met.at.t - self.right[met.pair])
        order = np.argsort(-away, kind="stable")  # the nearest comes last, and stays
        found[met.pair[order]] = met.at.t[order]
        return found


def find_pixel_shift(judge: Judge, failing: WrongPixels) -> PixelShift | None:
    """The shift that explains most of t, if one does."""
    seen = _samples(judge, failing)
    if seen.differs.sum() < MIN_DIFFERING_PIXELS:
        return None
    shift = PixelShift(0.0, 0.0)
    for _ in range(NEWTON_STEPS):
        step = _newton_step(seen, shift)
        if step is None:
            return None
        shift = PixelShift(shift.x + step.x, shift.y + step.y)
        if not shift.size < MAX_SHIFT_PIXELS:
            return None
    return shift if shift.size > SLOPE_STEP_PIXELS / 4 and _explains(seen, shift) else None


def _samples(judge: Judge, failing: WrongPixels) -> ShiftSamples:
    there = np.flatnonzero(failing.hit & judge.answer.hit[failing.rows])
    there = there[:: max(1, len(there) // MAX_DIAGNOSED_PIXELS)]
    rows, right = failing.rows[there], failing.t[there]
    t = judge.answer.t[rows]
    with np.errstate(invalid="ignore"):
        differs = np.abs(t - right) > 0.0
    return ShiftSamples(judge, rows, failing.prim[there], right, t, differs)


def _newton_step(seen: ShiftSamples, at: PixelShift) -> PixelShift | None:
    """One of Newton's method, by the slopes at where the last one led; the fifth that fits least does not count."""
    here = seen.t_at(at)
    across = [
        seen.t_at(PixelShift(at.x + SLOPE_STEP_PIXELS, at.y)) - here,
        seen.t_at(PixelShift(at.x, at.y + SLOPE_STEP_PIXELS)) - here,
    ]
    slopes = np.column_stack(across) / SLOPE_STEP_PIXELS
    fine = seen.differs & np.isfinite(slopes).all(axis=1) & np.isfinite(here)
    off = seen.t - here
    fine &= np.abs(off) <= np.quantile(np.abs(off)[fine], 0.8) if fine.any() else fine
    if fine.sum() < MIN_DIFFERING_PIXELS:
        return None
    x, y = np.linalg.lstsq(slopes[fine], off[fine], rcond=None)[0]
    return PixelShift(float(x), float(y))


def _explains(seen: ShiftSamples, shift: PixelShift) -> bool:
    with np.errstate(invalid="ignore"):
        left = np.abs(seen.t - seen.t_at(shift))
        explained = seen.differs & (left <= LARGEST_RESIDUAL_RATIO * np.abs(seen.t - seen.right))
    return bool(explained.sum() > MIN_EXPLAINED_FRACTION * seen.differs.sum())
