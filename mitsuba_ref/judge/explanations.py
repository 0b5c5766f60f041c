"""Explanations: why a pixel has its class, what exceeds its bound, and whether a shift explains failures."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.known_defects import defect_name
from mitsuba_ref.judge.scene_checks import pixel_centers
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    JUDGED_WITHOUT_REFERENCE,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    UNLISTED,
)

QUANTITY_NAMES = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}
COMPARED_AT_HITS = ("depth", "position", "normal", "shading_normal")  # compared where both sides hit


def subject_name(judge: Judge) -> str:
    """In a sentence."""
    return "ours" if judge.answer.exact_visibility else "the candidate"


def constant_reasons(judge: Judge) -> dict[str, str]:
    """The classes whose reason is the same at every pixel."""
    if not judge.answer.exact_visibility:
        return {
            AGREE: "all that is given is within the bounds of the candidate's arithmetic",
            TIE: "several primitives are hit at exactly this t, and any of them is a right answer",
        }
    return {
        AGREE: "every quantity is within its bound",
        EXPLAINED: "ours is exactly right, and rounding in float32 allows Mitsuba's answer, too",
        TIE: "several primitives are hit at exactly this t; ours is the first of them, Mitsuba's is another",
        OUT_OF_DOMAIN: "ours is exactly right; float32 cannot resolve this pixel",
    }


def reason(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int) -> str:
    """Why a row of the image has its class; the same words for many pixels. diagnosed: row that fails -> diagnosis."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        defect = format_defect(judgement.cases.get(row))
        return f"{subject_name(judge)} is right, and Mitsuba's answer is beyond what float32 allows; {defect}"
    if row in diagnosed:
        return diagnosed[row]
    constant = constant_reasons(judge).get(verdict)
    return constant or _rounding_reason(judge, judgement, verdict, row)


def _rounding_reason(judge: Judge, judgement: Judgement, verdict: str, row: int) -> str:
    """Whose rounding excuses a pixel: of a subject whose own visibility is rounded, it may be the subject's."""
    precision = judge.answer.precision
    if judgement.is_right(row):
        return {
            EXPLAINED: "the candidate is exactly right, and rounding in float32 allows Mitsuba's answer, too",
            OUT_OF_DOMAIN: "the candidate is exactly right; float32, in which Mitsuba computes, cannot resolve this "
            "pixel",
        }[verdict]
    return {
        EXPLAINED: f"rounding in {precision} allows the candidate's answer, which is not the exact one",
        OUT_OF_DOMAIN: f"{precision}, in which the candidate computes, cannot resolve this pixel",
    }[verdict]


def open_reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Why a row of the image is undecided."""
    inconsistent = [name for name, where in judge.inconsistent.items() if where[row]]
    if inconsistent:
        return f"our image contradicts our own hit: {', '.join(inconsistent)}"
    worst = max(judgement.names, key=lambda name: judgement.excess(name)[row])
    if judgement.excess(worst)[row] > 1.0 >= judgement.ratio(worst)[row]:
        return f"beyond the share of the bound that [check.{worst}] allows"
    if judgement.exact.of(row) is None:
        return "exact arithmetic gave no answer"
    return "no shadow that rounding allows gives this value, and nothing shows whose fault that is"


def format_defect(case: int | None) -> str:
    """A known defect with its number."""
    if case is None:
        return f"{UNLISTED}: none of the cases that are known"
    return f"case {case}: {defect_name(case)}"


def full_reason(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int) -> str:
    """The reason, and which quantities exceed their bounds by what factor."""
    exceeded = exceeded_bounds(error_ratios(judge, judgement, row))
    return "; ".join(filter(None, (reason(judge, judgement, diagnosed, row), exceeded)))


def error_ratios(judge: Judge, judgement: Judgement, row: int) -> dict[str, float]:
    """Error over bound of every quantity, from Mitsuba or from the subject's own primitive, whichever is more."""
    found = {name: float(judgement.ratio(name)[row]) for name in judgement.names}
    for check in judge.self_checks:
        if check.fails_at(row):
            error, bound = float(check.error[row]), float(check.bound[row])
            own = error / bound if bound > 0.0 and np.isfinite(error) else np.inf
            found[check.name] = max(found[check.name], own)
    return found


def exceeded_bounds(ratios: Mapping[str, float]) -> str:
    """Which quantities exceed their bounds, and by what factor; "" where none does.

    A hit in place of a miss has no factor. That t is not the exact one is the least specific, where it has none either.
    """
    found = {name: ratio for name, ratio in ratios.items() if not ratio <= 1.0}
    if len(found) > 1 and not np.isfinite(found.get(EXACT, 0.0)):
        del found[EXACT]
    factors = {name: f" {ratio:.3g}x" if np.isfinite(ratio) else "" for name, ratio in found.items()}
    words = [f"{QUANTITY_NAMES.get(name, name)}{factor}" for name, factor in factors.items()]
    return f"beyond {'its bound' if len(words) == 1 else 'their bounds'}: {', '.join(words)}" if words else ""


def not_judged(judge: Judge, judgement: Judgement, row: int) -> dict[str, str]:
    """Quantities of our caster that were not compared, and why: a ratio of 0 would pass for agreement."""
    ours, theirs = bool(judge.hit[row]), bool(judge.pair.reference.hit.ravel()[row])
    found = not_compared(ours, theirs, "ours", COMPARED_AT_HITS)
    if not ours:
        found["on_surface"] = "ours hits nothing"
    if why := _diffuse(judge, judgement, row):
        found["diffuse"] = why
    if judgement.exact.of(row) is None:
        found[EXACT] = "there is no ray" if judge.t_max[row] < 0.0 else "exact arithmetic gave no answer"
    # What contradicts something else is reported as beyond all bounds, whatever else was not compared.
    return {name: why for name, why in found.items() if not judgement.ratio(name)[row] > 0.0}


def not_compared(subject: bool, reference: bool, who: str, names: tuple[str, ...]) -> dict[str, str]:
    """Why these are not compared where the subject or Mitsuba misses; nothing where both hit."""
    if subject and reference:
        return {}
    why = f"{who if subject else 'Mitsuba'} alone hits" if subject or reference else "nothing is hit"
    return dict.fromkeys(names, why)


def _diffuse(judge: Judge, judgement: Judgement, row: int) -> str:
    """Light is compared with Mitsuba's where geometry agrees, and else held to float64 where ours is right."""
    name = CLASSES[int(judgement.classes[row])]
    if not judge.hit[row]:
        return "ours hits nothing"
    if name == AGREE:
        return ""
    if name not in JUDGED_WITHOUT_REFERENCE:
        already = "undecided" if name == UNDECIDED else "wrong"
        return f"what is hit, or where, is {already} already"
    if not np.isfinite(judge.bounds.own.t_error[row]):
        return "float64 does not resolve where the hit is"
    return "not against Mitsuba's, which is of another surface or place; it is what float64 gives on ours"


# Pixels where the subject is wrong by exact arithmetic, and a shift of the image that would explain them.


MAX_DIAGNOSED_PIXELS = 4096  # pixels at which costly hypotheses are tested


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
