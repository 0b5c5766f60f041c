"""How far the reference may be off at each pixel, at the primitive that we say is hit there."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.meeting import KU, KU_OURS, Meetings
from mitsuba_ref.model import Model, PairMeetings


class Bounds(NamedTuple):
    """One row a ray; inf where there is nothing to hold on to."""

    own: Meetings  # the meeting as float64 sees it
    at: Meetings  # the meeting as the reference may see it


def bounds_of(model: Model, prim: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Bounds:
    """The meeting of ray i with prim[i] (n,) that is nearest to t[i]; prim -1 is a miss."""
    rows = np.flatnonzero(prim >= 0)
    ours = model.meet(prim[rows], o[rows], d[rows], KU_OURS, ours=True)
    theirs = model.meet(prim[rows], o[rows], d[rows], KU, ours=False)
    return Bounds(*(_spread(nearest_root(met, t[rows]), rows, len(prim)) for met in (ours, theirs)))


def nearest_root(met: PairMeetings, t: np.ndarray) -> Meetings:
    """Of each pair's meetings the one nearest to t (n,), in the order of the pairs."""
    with np.errstate(invalid="ignore"):
        away = np.abs(met.at.t - t[met.pair])
    order = np.lexsort([np.where(np.isnan(away), np.inf, away), met.pair])
    first = order[np.r_[True, np.diff(met.pair[order]) != 0]] if len(order) else order
    return Meetings(*(a[first] for a in met.at if a is not None))


def _spread(met: Meetings, rows: np.ndarray, count: int) -> Meetings:
    """Meetings of some rays among those of all; inf where there is none."""
    out = []
    for values in met:
        if values is not None:
            everywhere = np.full((count, *values.shape[1:]), np.inf).astype(values.dtype)
            everywhere[rows] = values
            out.append(everywhere)
    return Meetings(*out)
