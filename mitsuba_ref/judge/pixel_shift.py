"""Pixels where the subject is wrong by exact arithmetic, and a shift of the image that would explain them."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.scene_checks.scene_check import pixel_centers
from mitsuba_ref.reference.rendering import camera_reference

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
        rays = camera_reference(scene.camera).rays(scene.camera, scene.film, x + shift.x, y + shift.y)
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
