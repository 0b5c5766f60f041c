"""The ways in which the caster can be asked about a ray; all have to give the same bits."""

from typing import NamedTuple

import numpy as np

from caster import cast
from caster.casting import Culling, find_nearest
from caster.hits import Hits, checked_rays
from caster.packing import Packed
from caster.scene import Scene
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.setting import Rng

LIMITED = 12  # rays of an example that are cast again with other limits
CALLS = 3  # of them by caster.cast, which takes one pair of limits a call


class Found(NamedTuple):
    """What each ray meets first."""

    t: np.ndarray  # (n,) lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number in the scene, -1 on a miss


def of_hits(hits: Hits, packed: Packed) -> Found:
    first = packed.first[np.maximum(hits.shape_id, 0)]
    return Found(hits.t, np.where(hits.shape_id < 0, -1, first + hits.prim_id).astype(np.int64))


def publicly(scene: Scene, packed: Packed, shots: Shots) -> tuple[np.ndarray, Found]:
    """(rows, what they meet) by caster.cast: all rays without limits, and the first few that have some."""
    free = (shots.t_min == 0.0) & np.isinf(shots.t_max)
    calls = [np.flatnonzero(free), *np.flatnonzero(~free)[:CALLS, None]]
    found = [Found(*of_hits(_cast(scene, shots.taken(rows)), packed)) for rows in calls if len(rows)]
    rows = np.concatenate(calls)
    return rows, Found(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _cast(scene: Scene, shots: Shots) -> Hits:
    return cast(scene, shots.o, shots.d, t_min=float(shots.t_min[0]), t_max=float(shots.t_max[0]))


def by_culling(packed: Packed, shots: Shots, culling: Culling) -> Found:
    """By the caster's innards; directions brought to about length 1 by a power of two, as caster.cast does."""
    return _scaled_by(lossless_exponents(shots), packed, shots, culling)


def _scaled_by(exponent: np.ndarray, packed: Packed, shots: Shots, culling: Culling) -> Found:
    """With directions 2^-exponent as long. Where t is denormal by that, and would not be otherwise, as they are."""
    with np.errstate(over="ignore", under="ignore"):
        d = np.ldexp(shots.d, -exponent[:, None])
        limits = {"t_min": np.ldexp(shots.t_min, exponent), "t_max": np.ldexp(shots.t_max, exponent)}
    rays = checked_rays(shots.o, d, 0.0, np.inf)._replace(**limits)
    nearest = find_nearest(packed, rays, culling, threads=1)
    with np.errstate(over="ignore", under="ignore"):
        found = Found(np.ldexp(nearest.t, -exponent), nearest.prim.astype(np.int64))
    rows = np.flatnonzero((exponent < 0) & (nearest.t < np.finfo(np.float64).tiny))
    if len(rows):
        found.t[rows] = _scaled_by(np.zeros(len(rows), int), packed, shots.taken(rows), culling).t
    return found


def lossless_exponents(shots: Shots) -> np.ndarray:
    """(n,) k for which 2^-k d is of about length 1; 0 where bits would be lost by that, of d or of the limits."""
    exponent = np.frexp(np.abs(shots.d).max(axis=1, initial=0.0))[1]
    numbers = np.column_stack([shots.d, shots.t_min, shots.t_max])
    powers = exponent[:, None] * np.array([-1, -1, -1, 1, 1])
    with np.errstate(over="ignore", under="ignore"):
        kept = (np.ldexp(np.ldexp(numbers, powers), -powers) == numbers).all(axis=1)
    return np.where(kept, exponent, 0)


def with_limits(rng: Rng, shots: Shots, found: Found, most: int = LIMITED) -> Shots:
    """Some of the rays that hit, ending or beginning just before, at or beyond the hit."""
    hits = np.flatnonzero((found.prim >= 0) & (found.t > 0.0) & np.isfinite(found.t))
    rows = rng.permutation(hits)[:most]
    t, n = found.t[rows], len(rows)
    with np.errstate(over="ignore"):  # t may be the largest float64
        before, after = np.nextafter(t, 0.0), np.nextafter(t, np.inf)
        start = np.choose(rng.integers(6, size=n), [t, before, np.zeros(n), np.zeros(n), 0.5 * t, after])
        end = np.choose(rng.integers(4, size=n), [t, before, np.full(n, np.inf), 2.0 * t])
    end = np.where(start > 0.0, np.where(end >= start, end, np.inf), np.minimum(end, t))
    return Shots(shots.o[rows], shots.d[rows], start, end)


def together(first: Shots, second: Shots) -> Shots:
    return Shots(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
