"""The exact answers about a setting."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mitsuba_ref.exact import ExactAnswer, Oracle
from mitsuba_ref.stress.witnesses import Prepared

# In a closed mesh every ray from inside hits, so that exact arithmetic need not look at all of them: it looks at
# this many, spread evenly, and at the first of those that some witness says are misses.
ASKED_IF_CLOSED, CONFIRMED = 1000, 200


@dataclass(frozen=True)
class Truth:
    """Exact answers, one for each of the rays that were asked about."""

    hit: np.ndarray  # (n,) bool, of all rays
    rows: np.ndarray  # (m,) the rays that exact arithmetic was asked about
    answers: tuple[ExactAnswer, ...]  # m of them

    @cached_property
    def t(self) -> np.ndarray:
        """(m,) to the nearest float64, inf on a miss."""
        return np.array([np.inf if answer.t is None else float(answer.t) for answer in self.answers])


def find_truth(ready: Prepared, doubted: np.ndarray) -> Truth:
    """doubted: (n,) rays of which some witness says that they miss. Only a closed mesh leaves rays unasked."""
    count = len(ready.setting.o)
    if ready.setting.closed:
        sample = np.linspace(0, count - 1, min(count, ASKED_IF_CLOSED)).astype(int)
        rows = np.union1d(sample, np.flatnonzero(doubted)[:CONFIRMED])
    else:
        rows = np.arange(count)
    o, d = (a[rows].astype(np.float64) for a in (ready.setting.o, ready.setting.d))
    answers = tuple(Oracle(ready.packed).ask_all(o, d))
    hit = np.ones(count, bool)
    hit[rows] = [answer.hit for answer in answers]
    if ready.setting.closed and not hit.all():
        raise AssertionError(
            f"ray {int(np.argmin(hit))} leaves a closed mesh from inside, says exact arithmetic"
        )
    return Truth(hit, rows, answers)
