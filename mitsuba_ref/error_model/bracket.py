"""Brackets: the answers that rounding allows along a ray, all primitives near it considered."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import (
    Array,
    Intersections,
    Rays,
    dot,
    joined,
    no_intersections,
    norm,
    row_groups,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.scene_model import PairIntersections, SceneModel, Side

# docs/method.md, "Visibility". A primitive is possible if some numbers within the error bounds hit it, and certain if
# all of them do. The nearest hit is on a possible primitive, and no later than the latest t of any certain one.


CLAIMED_MISS = -1
ANY_SHAPE = -2  # claimed by a subject that names no shape


NOT_CLAIMED = np.zeros((0, 3))  # in place of normals, positions or uv that the subject does not give


class Claims(NamedTuple):
    """The claimed hits of n rays."""

    t: Array  # (n,) inf on a miss; NaN: a hit at no claimed t
    shape: Array  # (n,) index, -1 on a miss, ANY_SHAPE
    n: Array  # (n, 3), or NOT_CLAIMED, as all below
    sh_n: Array = NOT_CLAIMED  # (n, 3)
    p: Array = NOT_CLAIMED  # (n, 3)
    t_rounding: float | Array = 0.0  # (n,) rounding of t itself, where it was computed from a depth
    prim: Array | None = None  # (n,) primitive within its shape; None: not claimed
    uv: Array = NOT_CLAIMED  # (n, 2)


class BracketResult(NamedTuple):
    """For each ray: whether rounding allows the claim, and whether the claim cannot be tested."""

    allowed: Array  # (n,) bool
    open: Array  # (n,) bool: the named surface is so nearly edge-on that its t has no bound


class RayIntersections(NamedTuple):
    """Possible intersections in the range of their rays."""

    ray: Array  # (m,)
    prim: Array  # (m,)
    at: Intersections

    def take(self, rows: Array) -> "RayIntersections":
        """Some of them, by index or mask."""
        return RayIntersections(self.ray[rows], self.prim[rows], self.at.take(rows))


class Bracket:
    """Tests claims of one side about rays through one scene. closed: as in latest_hits."""

    def __init__(self, model: SceneModel, side: Side, *, closed: bool = True):
        self.model, self.side, self.closed = model, side, closed

    def judge(self, line: Rays, claims: Claims, *, also: Array | None = None) -> BracketResult:
        """Whether rounding allows each claim. also: (n,) a primitive to try though the ray misses its box; -1: none."""
        latest = np.full(len(line.o), np.inf)
        fits, untestable = np.zeros((2, len(line.o)), bool)
        for found in self._batches(line, also):
            np.minimum.at(latest, found.ray, latest_hits(found, line, closed=self.closed))
            named, matches = self._fits(found, claims, line, latest[found.ray])
            fits[found.ray[matches]] = True
            untestable[found.ray[named & ~np.isfinite(found.at.t_error)]] = True
        return BracketResult(np.where(claims.shape == CLAIMED_MISS, np.isinf(latest), fits), untestable)

    def _batches(self, line: Rays, also: Array | None = None) -> Iterator[RayIntersections]:
        """Possible intersections of the rays, all of a ray in one batch. also: as in `judge`."""
        near = self.model.near_pairs(line.o, line.d, blurred=not self.side.own and also is None)
        if also is not None:
            named = np.flatnonzero(also >= 0)
            near = iter([np.unique(np.hstack([*near, np.stack([named, also[named]])]), axis=1)])
        for ray, prim in near:
            yield self._intersect_in_range(ray, prim, line)

    def blocked(self, line: Rays, leaving: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
        """(possibly, certainly) whether anything lies on the rays; (n,) bool each.

        leaving: (n,) the primitive a ray starts on, and (n,) how far the start may be off its surface. The intersection
        at the start does not count, and anything else that near, such as the next face at an edge, is never certain.
        """
        count = len(line.o)
        prim, off = leaving if leaving else (np.full(count, -1), np.zeros(count))
        possible, certain = np.zeros((2, count), bool)
        for found in self._batches(line):
            near = near_ray_start(found, line.d, off)
            kept = ~(near & (found.prim == prim[found.ray]))
            found, near = found.take(kept), near[kept]
            possible[found.ray] = True
            certain[found.ray[np.isfinite(latest_hits(found, line)) & ~near]] = True
        return possible, certain

    def possible_hits(self, line: Rays) -> RayIntersections:
        """All possible intersections of the rays, in memory at once."""
        none = RayIntersections(np.zeros(0, int), np.zeros(0, int), no_intersections(0))
        ray, prim, at = zip(none, *self._batches(line), strict=True)
        return RayIntersections(np.concatenate(ray), np.concatenate(prim), joined(at))

    @without_overflow_warnings
    def _intersect_in_range(self, ray: Array, prim: Array, line: Rays) -> RayIntersections:
        met: PairIntersections = self.model.intersect(prim, line.o[ray], line.d[ray], self.side)
        rays = ray[met.pair]
        error = np.where(np.isfinite(met.at.t_error), met.at.t_error, np.inf)
        in_range = ~(met.at.t + error < line.t_min[rays]) & ~(met.at.t - error > line.t_max[rays])
        keep = met.at.possible & in_range & ~np.isnan(met.at.t)
        return RayIntersections(rays, prim[met.pair], met.at).take(keep)

    @without_overflow_warnings
    def _fits(self, found: RayIntersections, claims: Claims, line: Rays, latest: Array) -> tuple[Array, Array]:
        """(m,) bool twice: an intersection may be the claimed one, but for its t; and all that is claimed fits.

        latest: (m,) the latest t that the first hit of the ray may have.
        """
        at, ray = found.at, found.ray
        p = line.o[ray] + at.t[:, None] * line.d[ray]
        t_rounding = np.broadcast_to(claims.t_rounding, claims.t.shape)[ray]
        shape = claims.shape[ray]
        named = (shape == ANY_SHAPE) | (self.model.packed.shape_of(found.prim) == shape)
        if claims.prim is not None:
            named &= claims.prim[ray] == self.model.packed.index_in_shape(found.prim)
        without_t = np.isnan(claims.t[ray])
        named &= without_t | (claims.t[ray] <= latest + t_rounding)
        named &= within_error(claims.n, ray, at.n, at.n_error)
        matches = (named & np.isfinite(at.t_error) & (np.abs(claims.t[ray] - at.t) <= at.t_error + t_rounding)) | (
            named & without_t
        )
        matches &= within_error(claims.sh_n, ray, at.sh_n, at.sh_error) & within_error(claims.p, ray, p, at.p_error)
        if len(claims.uv):
            rows = np.flatnonzero(matches)
            uv = self.model.uv_points(found.prim[rows], claims.uv[ray[rows]], self.side)
            matches[rows] = within_error(uv, np.arange(len(rows)), at.uv[rows], at.uv_error[rows])
        return named, matches


def within_error(claimed: Array, ray: Array, at: Array, error: Array) -> Array:
    """(m,) bool: claimed (n, 3) is within `error` of `at` at each of m intersections; True where nothing is claimed."""
    if not len(claimed):
        return np.ones(len(ray), bool)
    return norm(claimed[ray] - at) <= error


@without_overflow_warnings
def latest_hits(found: RayIntersections, line: Rays, *, closed: bool = True) -> Array:
    """(m,) largest t that rounding allows for each hit; inf if it is not in range, or may be a miss.

    closed: no ray passes between two faces, so a hit in doubt at an edge counts if a second face shares that edge.
    """
    at, ray = found.at, found.ray
    in_range = (at.t - at.t_error > line.t_min[ray]) & (at.t + at.t_error <= line.t_max[ray])
    latest = np.where(at.certain, at.t + at.t_error, _latest_at_edges(found) if closed else np.inf)
    return np.where(in_range, latest, np.inf)


def _latest_at_edges(found: RayIntersections) -> Array:
    """(m,) the same for hits in doubt at one edge: finite if a second face shares the edge, as one of the two is hit.

    Embree's robust mode guarantees this at edges, not at corners.
    """
    edge, side = found.at.edge, found.at.side
    rows = np.flatnonzero(side != 0.0)
    latest = np.full(len(found.ray), np.inf)
    if len(rows):
        keys = np.column_stack([found.ray[rows], edge[rows]])
        which = row_groups(keys)
        left, right = (np.bincount(which[side[rows] == s], minlength=which.max() + 1) > 0 for s in (-1.0, 1.0))
        last = np.full(which.max() + 1, -np.inf)
        np.maximum.at(last, which, (found.at.t + found.at.t_error)[rows])
        latest[rows] = np.where(left & right, last, np.inf)[which]
    return latest


@without_float_warnings
def near_ray_start(found: RayIntersections, d: Array, off: Array) -> Array:
    """(m,) bool: intersections with surfaces no farther from the ray's start than `off` (n,), its uncertainty."""
    height = (np.abs(found.at.t) - found.at.t_error) * np.abs(dot(found.at.n, d[found.ray]))
    near: Array = ~(height > off[found.ray])
    return near & (off[found.ray] > 0.0)
