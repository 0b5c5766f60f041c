"""How far a candidate is from the exact answer, in shares of what its rounding allows there."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mitsuba_ref.error_model.bounds import intersections_at, row_distance
from mitsuba_ref.judge.classification import LARGEST_USEFUL_NORMAL_ERROR
from mitsuba_ref.oracle.oracle import ExactAnswer

if TYPE_CHECKING:
    from mitsuba_ref.judge.candidate_judge import CandidateJudge


class ExactRatios(NamedTuple):
    """One row a pixel that exact arithmetic was asked about."""

    best: (
        np.ndarray
    )  # (m,) error over bound at the member of the tie set that fits best; inf where hit and miss differ
    of_first: np.ndarray  # (m,) bool: the first member fits, or nothing is hit


def exact_ratios(
    judge: "CandidateJudge", rows: np.ndarray, answers: Sequence[ExactAnswer | None]
) -> ExactRatios:
    """Every member of a tie set is a right answer. Where rounding cannot resolve t, the normal alone is held."""
    hit = judge.answer.hit[rows]
    missed = np.array([answer is not None and answer.t is None for answer in answers], bool)
    best = np.where(missed & ~hit, 0.0, np.inf)
    first = best == 0.0
    owner = np.array([i for i, a in enumerate(answers) for _ in (a.ties if a and hit[i] else ())], np.int64)
    if not len(owner):
        return ExactRatios(best, first)
    members = [each for i, a in enumerate(answers) for each in (a.ties if a and hit[i] else ())]
    prim = np.array([each.prim for each in members])
    exact_t = np.array([float(each.t) for each in members])
    t = judge.answer.t[rows[owner]]
    off = np.array(
        [
            each.t.off(float(value)) if np.isfinite(value) else np.inf
            for each, value in zip(members, t, strict=True)
        ]
    )
    line = judge.o[rows[owner]], judge.d[rows[owner]]
    at = intersections_at(judge.view, prim, line, exact_t, judge.answer.ku, ours=not judge.answer.as_exported)
    t_rounding = np.broadcast_to(judge.answer.t_rounding, judge.answer.t.shape)[rows[owner]]
    share = _over(off, at.t_error + t_rounding)
    if judge.answer.n is not None:
        turned = row_distance(judge.answer.n[rows[owner]], at.n)
        share = np.maximum(share, _over(turned, np.minimum(at.n_error, LARGEST_USEFUL_NORMAL_ERROR)))
    np.minimum.at(best, owner, share)
    begins = np.r_[True, np.diff(owner) != 0]
    first[owner[begins]] = share[begins] <= 1.0
    return ExactRatios(best, first)


def _over(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """error / bound; 0 where there is no bound to hold to, inf where the error is no number."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        share = np.where(error == 0.0, 0.0, error / bound)
    share = np.where(np.isposinf(bound) & np.isfinite(error), 0.0, share)
    return np.where(np.isnan(share), np.inf, share)
