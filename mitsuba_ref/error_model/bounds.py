"""Error bounds of the reference at each pixel, at the primitive that the subject hits there."""

from typing import NamedTuple

import numpy as np

from caster.rendering.images import Aovs
from mitsuba_ref.error_model.intersections import KU, KU_OURS, Intersections
from mitsuba_ref.error_model.scene_model import PairIntersections, SceneModel


class Bounds(NamedTuple):
    """One row a ray; inf where there is nothing to hold on to."""

    own: Intersections  # the intersection in float64
    at: Intersections  # the intersection, with the reference's error bounds

    @property
    def resolved(self) -> np.ndarray:
        """(n,) bool: the reference's t has a bound."""
        return np.isfinite(self.at.t_error)


def reference_bounds(
    model: SceneModel, prim: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray
) -> Bounds:
    """The intersection of ray i with prim[i] (n,) that is nearest to t[i]; prim -1 is a miss."""
    own = intersections_at(model, prim, (o, d), t, KU_OURS, ours=True)
    return Bounds(own, intersections_at(model, prim, (o, d), t, KU, ours=False))


def intersections_at(
    model: SceneModel,
    prim: np.ndarray,
    line: tuple[np.ndarray, np.ndarray],
    t: np.ndarray,
    ku: float,
    *,
    ours: bool,
) -> Intersections:
    """The same with the error bounds of one arithmetic. line: o, d (n, 3), (n, 3); ku, ours: as in Model.meet."""
    out = missing_intersections(len(prim))
    hits = np.flatnonzero(prim >= 0)
    for start in range(0, len(hits), PIXELS_PER_BATCH):
        rows = hits[start : start + PIXELS_PER_BATCH]
        o, d = (ends[rows] for ends in line)
        found = nearest_root(model.intersect(prim[rows], o, d, ku, ours=ours), t[rows])
        for everywhere, here in zip(out, found, strict=True):
            if everywhere is not None:
                everywhere[rows] = here
    return out


PIXELS_PER_BATCH = 1 << 17  # pixels; some fifty temporary arrays of three numbers each take 150 MB


def missing_intersections(count: int) -> Intersections:
    """Intersections that do not exist: all numbers inf. Without edges, which are for brackets."""
    t, t_error, n_error, sh_error, p_error = np.full((5, count), np.inf)
    n, sh_n = np.full((2, count, 3), np.inf)
    possible, certain = np.zeros((2, count), bool)
    return Intersections(t, t_error, n, n_error, sh_n, sh_error, possible, certain, p_error)


def nearest_root(met: PairIntersections, t: np.ndarray) -> Intersections:
    """Of each pair's meetings the one nearest to t (n,), in the order of the pairs."""
    with np.errstate(invalid="ignore"):
        away = np.abs(met.at.t - t[met.pair])
    order = np.lexsort([np.where(np.isnan(away), np.inf, away), met.pair])
    first = order[np.r_[True, np.diff(met.pair[order]) != 0]] if len(order) else order
    return met.at.take(first)


def aov_rows(aovs: Aovs, name: str) -> np.ndarray:
    image = aovs[name]
    rows: np.ndarray = image.reshape(-1, *image.shape[2:])
    return rows


def error_over_bound(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """error / bound; inf for anything that is not a number, or where there is no bound to hold on to."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(error == 0.0, 0.0, error / bound)
    fine = np.isfinite(error) & np.isfinite(bound) & np.isfinite(share)
    return np.where(fine, share, np.inf)


def row_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Euclidean distance of rows (n, c); NaN where either is not finite."""
    with np.errstate(invalid="ignore"):
        distance: np.ndarray = np.sqrt(np.sum((a - b) ** 2, axis=1))
    return np.where(np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1), distance, np.nan)
