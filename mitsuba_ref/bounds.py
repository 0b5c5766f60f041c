"""How far the reference may be off at each pixel, at the primitive that we say is hit there."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.meeting import KU, KU_OURS, Meetings
from mitsuba_ref.model import Model, PairMeetings


class Bounds(NamedTuple):
    """One row a ray; inf where there is nothing to hold on to."""

    own: Meetings  # the meeting as float64 sees it
    at: Meetings  # the meeting as the reference may see it

    @property
    def resolved(self) -> np.ndarray:
        """(n,) bool: the reference's t has a bound."""
        return np.isfinite(self.at.t_error)


def bounds_of(model: Model, prim: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Bounds:
    """The meeting of ray i with prim[i] (n,) that is nearest to t[i]; prim -1 is a miss."""
    own = meetings_of(model, prim, (o, d), t, KU_OURS, ours=True)
    return Bounds(own, meetings_of(model, prim, (o, d), t, KU, ours=False))


def meetings_of(
    model: Model,
    prim: np.ndarray,
    line: tuple[np.ndarray, np.ndarray],
    t: np.ndarray,
    ku: float,
    *,
    ours: bool,
) -> Meetings:
    """The same as one kind of arithmetic may see it. line: o, d (n, 3), (n, 3); ku, ours: as in Model.meet."""
    out = nowhere(len(prim))
    hits = np.flatnonzero(prim >= 0)
    for start in range(0, len(hits), AT_ONCE):
        rows = hits[start : start + AT_ONCE]
        o, d = (ends[rows] for ends in line)
        found = nearest_root(model.meet(prim[rows], o, d, ku, ours=ours), t[rows])
        for everywhere, here in zip(out, found, strict=True):
            if everywhere is not None:
                everywhere[rows] = here
    return out


AT_ONCE = 1 << 17  # pixels; some fifty temporary arrays of three numbers each take 150 MB


def nowhere(count: int) -> Meetings:
    """Meetings that do not take place: all numbers inf. Without edges, which are for brackets."""
    t, t_error, n_error, sh_error, p_error = np.full((5, count), np.inf)
    n, sh_n = np.full((2, count, 3), np.inf)
    possible, certain = np.zeros((2, count), bool)
    return Meetings(t, t_error, n, n_error, sh_n, sh_error, possible, certain, p_error)


def nearest_root(met: PairMeetings, t: np.ndarray) -> Meetings:
    """Of each pair's meetings the one nearest to t (n,), in the order of the pairs."""
    with np.errstate(invalid="ignore"):
        away = np.abs(met.at.t - t[met.pair])
    order = np.lexsort([np.where(np.isnan(away), np.inf, away), met.pair])
    first = order[np.r_[True, np.diff(met.pair[order]) != 0]] if len(order) else order
    return met.at.taken(first)
