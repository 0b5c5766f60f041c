"""A picture that was taken beside the centres of its pixels: by how much, told by the t that fail."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.candidate.failing import TRIED, Failing
from mitsuba_ref.candidate.judge import CandidateJudge
from mitsuba_ref.export import camera_reference
from mitsuba_ref.scene_check import pixel_centers

STEP = 0.125  # of a pixel, over which the slopes of t are taken
STEPS = 3  # of Newton's method
EXPLAINS = 0.1  # a shift has to leave less than this of what there is to explain
MOST = 0.5  # of the pixels that fail: a shift explains more of them than this
FEWEST = 16  # pixels that a shift is told by
FARTHEST = 4.0  # pixels


class Shift(NamedTuple):
    """In pixels, to the right and down."""

    x: float
    y: float

    @property
    def size(self) -> float:
        return max(abs(self.x), abs(self.y))


class Seen(NamedTuple):
    """Pixels where something is hit, by the candidate and exactly."""

    judge: CandidateJudge
    rows: np.ndarray  # (m,) of the picture
    prim: np.ndarray  # (m,) that is hit
    right: np.ndarray  # (m,) exact t
    t: np.ndarray  # (m,) what the candidate says
    told: np.ndarray  # (m,) bool: it is another

    def beside(self, shift: Shift) -> np.ndarray:
        """(m,) t of the same primitives along rays through another place of their pixels, the root nearest to t."""
        scene = self.judge.scene
        x, y = (centers[self.rows] for centers in pixel_centers(scene))
        rays = camera_reference(scene.camera).rays(scene.camera, scene.film, x + shift.x, y + shift.y)
        o = rays.o + rays.t_min[:, None] * rays.d
        met = self.judge.model.meet(self.prim, o, rays.d, self.judge.answer.ku, ours=True)
        found = np.full(len(self.rows), np.nan)
        away = np.abs(met.at.t - self.right[met.pair])
        order = np.argsort(-away, kind="stable")  # the nearest comes last, and stays
        found[met.pair[order]] = met.at.t[order]
        return found


def shift_of(judge: CandidateJudge, failing: Failing) -> Shift | None:
    """The shift that explains most of t, if one does."""
    seen = _seen(judge, failing)
    if seen.told.sum() < FEWEST:
        return None
    shift = Shift(0.0, 0.0)
    for _ in range(STEPS):
        step = _step(seen, shift)
        if step is None:
            return None
        shift = Shift(shift.x + step.x, shift.y + step.y)
        if not shift.size < FARTHEST:
            return None
    return shift if shift.size > STEP / 4 and _explains(seen, shift) else None


def _seen(judge: CandidateJudge, failing: Failing) -> Seen:
    there = np.flatnonzero(failing.hit & judge.answer.hit[failing.rows])
    there = there[:: max(1, len(there) // TRIED)]
    rows, right = failing.rows[there], failing.t[there]
    t = judge.answer.t[rows]
    with np.errstate(invalid="ignore"):
        told = np.abs(t - right) > 0.0
    return Seen(judge, rows, failing.prim[there], right, t, told)


def _step(seen: Seen, at: Shift) -> Shift | None:
    """One of Newton's method, by the slopes at where the last one led; the fifth that fits least does not count."""
    here = seen.beside(at)
    across = [seen.beside(Shift(at.x + STEP, at.y)) - here, seen.beside(Shift(at.x, at.y + STEP)) - here]
    slopes = np.column_stack(across) / STEP
    fine = seen.told & np.isfinite(slopes).all(axis=1) & np.isfinite(here)
    off = seen.t - here
    fine &= np.abs(off) <= np.quantile(np.abs(off)[fine], 0.8) if fine.any() else fine
    if fine.sum() < FEWEST:
        return None
    x, y = np.linalg.lstsq(slopes[fine], off[fine], rcond=None)[0]
    return Shift(float(x), float(y))


def _explains(seen: Seen, shift: Shift) -> bool:
    with np.errstate(invalid="ignore"):
        left = np.abs(seen.t - seen.beside(shift))
        explained = seen.told & (left <= EXPLAINS * np.abs(seen.t - seen.right))
    return bool(explained.sum() > MOST * seen.told.sum())
