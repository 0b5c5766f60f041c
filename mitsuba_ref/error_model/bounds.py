"""Error bounds at each pixel, on the primitive that the subject hits: of the reference, and of our float64."""

import numpy as np

from caster.aovs import Aovs
from mitsuba_ref.error_model.intersections import (
    Array,
    Intersections,
    no_intersections,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.scene_model import OUR_SIDE, PairIntersections, SceneModel, Side


def intersections_at(model: SceneModel, prim: Array, o: Array, d: Array, t: Array, side: Side) -> Intersections:
    """The intersection of ray i (n, 3) with prim[i], -1: a miss, nearest to t[i], with the error bounds of one side."""
    out = no_intersections(len(prim))
    hits = np.flatnonzero(prim >= 0)
    for start in range(0, len(hits), PIXELS_PER_BATCH):
        rows = hits[start : start + PIXELS_PER_BATCH]
        found = nearest_root(model.intersect(prim[rows], o[rows], d[rows], side), t[rows])
        for everywhere, here in zip(out, found, strict=True):
            everywhere[rows] = here
    return out


PIXELS_PER_BATCH = 1 << 14  # pixels: temporary arrays of three numbers each stay in a cache


@without_overflow_warnings
def nearest_root(met: PairIntersections, t: Array) -> Intersections:
    """The intersection of each pair that is nearest to t (n,), in the order of the pairs."""
    if len(met.pair) == len(t) and (met.pair == np.arange(len(t))).all():
        return met.at
    away = np.abs(met.at.t - t[met.pair])
    order = np.lexsort([np.where(np.isnan(away), np.inf, away), met.pair])
    return met.at.take(order[np.unique(met.pair[order], return_index=True)[1]])


def aov_rows(aovs: Aovs, name: str) -> Array:
    image = aovs[name]
    return image.reshape(-1, *image.shape[2:])


@without_float_warnings
def error_over_bound(error: Array, bound: Array) -> Array:
    """error / bound; inf where either is not a finite number."""
    share = np.where(error == 0.0, 0.0, error / bound)
    fine = np.isfinite(error) & np.isfinite(bound) & np.isfinite(share)
    return np.where(fine, share, np.inf)


@without_float_warnings
def row_distance(a: Array, b: Array) -> Array:
    """Euclidean distance of rows (n, c); NaN where either is not finite."""
    squares, finite = np.zeros(len(a)), np.ones(len(a), bool)
    for one, other in zip(a.T, b.T, strict=True):  # a sum over an axis of three takes five times as long
        squares += (one - other) ** 2
        finite &= np.isfinite(one) & np.isfinite(other)
    return np.where(finite, np.sqrt(squares), np.nan)


# Bounds on the float64 rounding of our caster's t, images and surfaces, against exact answers.


# t is a float64, and cast scales it once more: half a unit in the last place each, and the smallest float64 where it
# is denormal.
T_ROUNDING_ULPS = 1.0

# The error model is about relative roundings; below 2^-1022 numbers are rounded to multiples of 2^-1074 instead.
# A dozen such roundings, divided by a slope of at least 2^-60, move t by no more than this.
UNDERFLOW_BOUND = 2.0**-1010

# unit() divides by a rounded length: each component takes at most four roundings, so its square is off by 8 u.
UNIT_LENGTH_ATOL = 16 * 2.0**-53


@without_overflow_warnings
def t_bounds(model: SceneModel, hits: tuple[Array, Array], rays: tuple[Array, Array]) -> Array:
    """(n,) bound on |t - exact t| of each hit; inf where float64 cannot resolve it, NaN on a miss.

    hits: t, primitive number (n,). rays: o, d (n, 3).
    The judge's error model with K u of float64: perturbations of 4 units in the last place, times the condition of
    each intersection, at the root nearest to t.
    """
    (t, prim), (o, d) = hits, rays
    exponent = np.frexp(np.abs(d).max(axis=1, initial=0.0))[1]  # so that no square of a direction overflows
    d = np.ldexp(d, -exponent[:, None])
    errors = intersections_at(model, prim, o, d, np.ldexp(t, exponent), OUR_SIDE).t_error
    errors = np.where(np.isnan(errors), np.inf, np.ldexp(errors, -exponent))
    bounds = errors + T_ROUNDING_ULPS * np.spacing(np.abs(t)) + UNDERFLOW_BOUND
    return np.where(prim < 0, np.nan, bounds)
