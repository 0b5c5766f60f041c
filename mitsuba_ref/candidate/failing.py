"""The pixels where a candidate is wrong by exact arithmetic, and what would be right there."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.candidate.judge import CandidateJudge, CandidateJudgement, meets_again
from mitsuba_ref.meeting import Meetings

TRIED = 4096  # pixels that costly suppositions are tried at


class Failing(NamedTuple):
    """The rows where the candidate is wrong by an exact answer, and what would be right there."""

    rows: np.ndarray  # (m,)
    hit: np.ndarray  # (m,) bool, exactly
    t: np.ndarray  # (m,) exact, inf on a miss
    prim: np.ndarray  # (m,) -1 on a miss
    at: Meetings  # (m,) there, as the candidate may see it

    def taken(self, some: np.ndarray) -> "Failing":
        """Some of them, by mask."""
        return Failing(self.rows[some], self.hit[some], self.t[some], self.prim[some], self.at.taken(some))


def failing_at(judge: CandidateJudge, judgement: CandidateJudgement, rows: np.ndarray) -> Failing:
    """What is known of these rows of the picture."""
    answers = [judgement.exact.of(row) for row in rows]
    t = np.array([np.inf if a is None or a.t is None else float(a.t) for a in answers])
    prim = np.array([-1 if a is None else a.prim for a in answers])
    return Failing(rows, prim >= 0, t, prim, meets_again(judge, rows, prim, t))
