"""How far the reference may be off at each pixel, at the primitive that we say is hit there."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.meeting import KU, KU_OURS, Meetings
from mitsuba_ref.model import Model, PairMeetings


class Bounds(NamedTuple):
    """One row a ray; inf where there is nothing to hold on to."""

    t: np.ndarray  # (n,) where our primitive is met, to float64; NaN on a miss
    t_ours: np.ndarray  # (n,) how far float64 may be off in it
    at: Meetings  # the meeting as the reference may see it


def bounds_of(model: Model, prim: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Bounds:
    """The meeting of ray i with prim[i] (n,) that is nearest to t[i]; prim -1 is a miss."""
    rows = np.flatnonzero(prim >= 0)
    ours = model.meet(prim[rows], o[rows], d[rows], KU_OURS, ours=True)
    theirs = model.meet(prim[rows], o[rows], d[rows], KU, ours=False)
    own, at = nearest_root(ours, t[rows]), nearest_root(theirs, t[rows])
    return Bounds(
        _spread(own.t, rows, len(prim), np.nan),
        _spread(own.t_error, rows, len(prim), np.inf),
        Meetings(*(_spread(a, rows, len(prim), np.inf) for a in at if a is not None)),
    )


def nearest_root(met: PairMeetings, t: np.ndarray) -> Meetings:
    """Of each pair's meetings the one nearest to t (n,), in the order of the pairs."""
    with np.errstate(invalid="ignore"):
        away = np.abs(met.at.t - t[met.pair])
    order = np.lexsort([np.where(np.isnan(away), np.inf, away), met.pair])
    first = order[np.r_[True, np.diff(met.pair[order]) != 0]] if len(order) else order
    return Meetings(*(a[first] for a in met.at if a is not None))


def _spread(values: np.ndarray, rows: np.ndarray, count: int, rest: float) -> np.ndarray:
    out = np.full((count, *values.shape[1:]), rest if values.dtype.kind == "f" else False)
    out = out.astype(values.dtype)
    out[rows] = values
    return out
