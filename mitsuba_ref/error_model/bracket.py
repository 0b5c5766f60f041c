"""Brackets: the answers that rounding allows along a ray, all primitives near it considered."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import (
    Intersections,
    dot,
    no_intersections,
    norm,
    row_groups,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.scene_model import PairIntersections, SceneModel

# docs/method.md, "Visibility". A primitive is possible if some numbers within the error bounds hit it, and certain if
# all of them do. The nearest hit is on a possible primitive, and no later than the latest t of any certain one.


CLAIMED_MISS = -1
ANY_SHAPE = -2  # claimed by a subject that names no shape


NOT_CLAIMED = np.zeros((0, 3))  # in place of normals, positions or uv that the subject does not give


class Claims(NamedTuple):
    """The claimed hits of n rays."""

    t: np.ndarray  # (n,) inf on a miss; NaN: a hit at no claimed t
    shape: np.ndarray  # (n,) index, -1 on a miss, ANY_SHAPE
    n: np.ndarray  # (n, 3), or NOT_CLAIMED, as all below
    sh_n: np.ndarray = NOT_CLAIMED  # (n, 3)
    p: np.ndarray = NOT_CLAIMED  # (n, 3)
    t_rounding: float | np.ndarray = 0.0  # (n,) rounding of t itself, where it was computed from a depth
    prim: np.ndarray | None = None  # (n,) primitive within its shape; None: not claimed
    uv: np.ndarray = NOT_CLAIMED  # (n, 2)


class BracketResult(NamedTuple):
    """For each ray: whether rounding allows the claim, and whether the claim cannot be tested."""

    allowed: np.ndarray  # (n,) bool
    open: np.ndarray  # (n,) bool: the named surface is so nearly edge-on that its t has no bound


class RayIntersections(NamedTuple):
    """Possible intersections in the range of their rays."""

    ray: np.ndarray  # (m,)
    prim: np.ndarray  # (m,)
    at: Intersections

    def take(self, rows: np.ndarray) -> "RayIntersections":
        """Some of them, by index or mask."""
        return RayIntersections(self.ray[rows], self.prim[rows], self.at.take(rows))


class RaySegments(NamedTuple):
    """n rays o + t d, t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3)
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,) negative: no ray


class Bracket:
    """Tests claims about rays through one scene. ku, ours: as in SceneModel.intersect; closed: as in latest_hits."""

    def __init__(self, model: SceneModel, ku: float, *, ours: bool, closed: bool = True):
        self.model, self.ku, self.ours, self.closed = model, ku, ours, closed

    def judge(
        self,
        o: np.ndarray,
        d: np.ndarray,
        t_max: np.ndarray,
        claims: Claims,
        *,
        t_min: float | np.ndarray = 0.0,
        also: np.ndarray | None = None,
    ) -> BracketResult:
        """Whether rounding allows each claim.

        o, d: (n, 3) float64. t_max: (n,); a hit has t_min < t <= t_max. also: (n,) a primitive to consider even if the
        ray misses its box; -1: none.
        """
        line = RaySegments(o, d, np.broadcast_to(t_min, t_max.shape), t_max)
        allowed, untestable = np.ones(len(o), bool), np.zeros(len(o), bool)
        seen = np.zeros(len(o), bool)
        for ray, prim in self._pairs(o, d, also):
            found = self._intersect_in_range(ray, prim, line)
            rays = np.unique(ray)
            seen[rays] = True
            allowed[rays], untestable[rays] = self._allows(found, claims, line, rays)
        allowed[~seen] = claims.shape[~seen] == CLAIMED_MISS
        return BracketResult(allowed, untestable)

    def _pairs(self, o: np.ndarray, d: np.ndarray, also: np.ndarray | None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of a ray and a primitive near it or named in `also`, in batches; each ray is in one batch only."""
        if also is None:
            yield from ((near.ray, near.box) for near in self.model.distinct.crossings(o, d))
            return
        named = np.flatnonzero(also >= 0)
        pieces = [np.stack([near.ray, near.box]) for near in self.model.distinct.crossings(o, d)]
        together = np.unique(np.hstack([*pieces, np.stack([named, also[named]])]), axis=1)
        yield together[0], together[1]

    def blocked(
        self, o: np.ndarray, d: np.ndarray, t_max: np.ndarray, leaving: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(possibly, certainly) whether anything lies on the rays o + t d, 0 < t < t_max; (n,) bool each.

        leaving: (n,) the primitive a ray starts on, and (n,) how far the start may be off its surface. The intersection
        at the start does not count, and anything else that near, such as the next face at an edge, is never certain.
        """
        prim, off = leaving if leaving else (np.full(len(o), -1), np.zeros(len(o)))
        line = RaySegments(o, d, np.zeros(len(o)), t_max)
        possible, certain = np.zeros(len(o), bool), np.zeros(len(o), bool)
        for _, ray, each, _ in self.model.distinct.crossings(o, d):
            found = self._intersect_in_range(ray, each, line)
            near = near_ray_start(found, d, off)
            # A primitive identical to the one that the ray leaves is just as near, and does count.
            kept = ~(near & (found.prim == prim[found.ray]) & ~self.model.has_twins(found.prim))
            found, near = found.take(kept), near[kept]
            possible[found.ray] = True
            certain[found.ray[np.isfinite(latest_hits(found, t_max)) & ~near]] = True
        return possible, certain

    def possible_hits(
        self, o: np.ndarray, d: np.ndarray, t_max: np.ndarray, t_min: float | np.ndarray = 0.0
    ) -> RayIntersections:
        """All possible intersections of the rays, in memory at once."""
        line = RaySegments(o, d, np.broadcast_to(t_min, t_max.shape), t_max)
        found = [self._intersect_in_range(ray, prim, line) for _, ray, prim, _ in self.model.nearby.crossings(o, d)]
        if not found:
            return RayIntersections(np.zeros(0, int), np.zeros(0, int), no_intersections(0))
        at = Intersections(*(np.concatenate(a) for a in zip(*(f.at for f in found), strict=True)))
        return RayIntersections(np.concatenate([f.ray for f in found]), np.concatenate([f.prim for f in found]), at)

    @without_overflow_warnings
    def _intersect_in_range(self, ray: np.ndarray, prim: np.ndarray, line: RaySegments) -> RayIntersections:
        met: PairIntersections = self.model.intersect(prim, line.o[ray], line.d[ray], self.ku, ours=self.ours)
        rays = ray[met.pair]
        error = np.where(np.isfinite(met.at.t_error), met.at.t_error, np.inf)
        in_range = ~(met.at.t + error < line.t_min[rays]) & ~(met.at.t - error > line.t_max[rays])
        keep = met.at.possible & in_range & ~np.isnan(met.at.t)
        return RayIntersections(rays, prim[met.pair], met.at).take(keep)

    @without_overflow_warnings
    def _allows(
        self, found: RayIntersections, claims: Claims, line: RaySegments, rays: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        at, ray = found.at, found.ray
        p = line.o[ray] + at.t[:, None] * line.d[ray]
        latest = np.full(len(line.o), np.inf)
        np.minimum.at(latest, ray, latest_hits(found, line.t_max, line.t_min, closed=self.closed))
        t_rounding = np.broadcast_to(claims.t_rounding, claims.t.shape)[ray]
        shape = claims.shape[ray]
        named = (shape == ANY_SHAPE) | (self.model.packed.shape_of(found.prim) == shape)
        if claims.prim is not None:
            named &= self._is_or_equals(claims.prim[ray], found.prim)
        without_t = np.isnan(claims.t[ray])
        named &= without_t | (claims.t[ray] <= latest[ray] + t_rounding)
        named &= within_error(claims.n, ray, at.n, at.n_error)
        matches = (named & np.isfinite(at.t_error) & (np.abs(claims.t[ray] - at.t) <= at.t_error + t_rounding)) | (
            named & without_t
        )
        matches &= within_error(claims.sh_n, ray, at.sh_n, at.sh_error) & within_error(claims.p, ray, p, at.p_error)
        if len(claims.uv):
            rows = np.flatnonzero(matches)
            uv = self.model.uv_points(found.prim[rows], claims.uv[ray[rows]], ours=self.ours)
            matches[rows] = within_error(uv, np.arange(len(rows)), at.uv[rows], at.uv_error[rows])
        has_match, untestable = np.zeros(len(line.o), bool), np.zeros(len(line.o), bool)
        has_match[ray[matches]] = True
        untestable[ray[named & ~np.isfinite(at.t_error)]] = True
        missed = claims.shape[rays] == CLAIMED_MISS
        return np.where(missed, np.isinf(latest[rays]), has_match[rays]), untestable[rays]

    def _is_or_equals(self, claimed: np.ndarray, prim: np.ndarray) -> np.ndarray:
        """(m,) bool: number claimed[i] within the shape of prim[i] is prim[i], or a primitive identical to it."""
        packed, identical = self.model.packed, self.model.identical
        if identical is None:
            return claimed == packed.index_in_shape(prim)
        shape = packed.shape_of(prim)
        number = packed.first[shape] + claimed
        there = (claimed >= 0) & (number < packed.first[shape + 1])
        return there & (identical[np.where(there, number, 0)] == identical[prim])


def within_error(claimed: np.ndarray, ray: np.ndarray, at: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(m,) bool: claimed (n, 3) is within `error` of `at` at each of m intersections; True where nothing is claimed."""
    if not len(claimed):
        return np.ones(len(ray), bool)
    return norm(claimed[ray] - at) <= error


@without_overflow_warnings
def latest_hits(
    found: RayIntersections, t_max: np.ndarray, t_min: np.ndarray | None = None, *, closed: bool = True
) -> np.ndarray:
    """(m,) largest t that rounding allows for a certain hit; inf if the hit is not certain or not in range.

    t_min, t_max: (n,) limits of the rays; t_min is 0 if not given. closed: no ray passes between two faces.
    """
    at = found.at
    earliest = 0.0 if t_min is None else t_min[found.ray]
    in_range = (at.t - at.t_error > earliest) & (at.t + at.t_error <= t_max[found.ray])
    latest = np.where(at.certain, at.t + at.t_error, _latest_at_edges(found) if closed else np.inf)
    return np.where(in_range, latest, np.inf)


def _latest_at_edges(found: RayIntersections) -> np.ndarray:
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
def near_ray_start(found: RayIntersections, d: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(m,) bool: intersections with surfaces no farther from the ray's start than `off` (n,), its uncertainty."""
    height = (np.abs(found.at.t) - found.at.t_error) * np.abs(dot(found.at.n, d[found.ray]))
    near: np.ndarray = ~(height > off[found.ray])
    return near & (off[found.ray] > 0.0)
