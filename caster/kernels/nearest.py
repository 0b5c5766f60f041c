"""Rays and their nearest hits: by float64, marked where that is uncertain, and decided exactly."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import implement, inlined, jit
from caster.kernels.exact.numbers import AS_FLOAT_REL_ERROR, as_float, compare, no_root
from caster.kernels.math.vec import TINY, max_norm, row
from caster.kernels.protocol import (
    Vec3,
    camera_ray,
    exact_intersect,
    intersect,
    load,
    prepare,
    same_geometry,
    surely_misses,
    update_best,
)


class Rays(NamedTuple):
    """Points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64
    t_min: np.ndarray  # (n,) float64
    t_max: np.ndarray  # (n,) float64; < 0: there is no ray


class Nearest(NamedTuple):
    """The first hit of each ray, exactly; t is rounded to float64."""

    t: np.ndarray  # (n,) float64, inf on a miss
    prim: np.ndarray  # (n,) int32, number of the primitive, -1 on a miss
    error: np.ndarray  # (n,) float64, the true t is within error of t


def new_rays(count: int) -> Rays:
    """Uninitialised rays."""
    return Rays(np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.empty(count))


def no_hits(count: int) -> Nearest:
    return Nearest(np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros(count))


# ---- rays of a camera, and whether rays from outside are sound ----


@jit
def generate_rays(camera: Any, window: Any, pixels: Any, rays: Any, start: int, stop: int) -> None:
    """Rays start..stop: through the centres of these pixels, numbered row by row through the window."""
    for j in range(start, stop):
        y, x = pixels[j] // window.width, pixels[j] % window.width
        o, d, t_min, t_max = camera_ray(camera, window.x0 + x + 0.5, window.y0 + y + 0.5)
        for c in range(3):
            rays.o[j, c], rays.d[j, c] = o[c], d[c]
        rays.t_min[j], rays.t_max[j] = t_min, t_max


# Results of `find_invalid_ray` if all rays are valid.
ALL_IN_RANGE, OUT_OF_RANGE = -1, -2

# Directions between these have squares, and powers of two in them change no bit of t but its exponent.
MIN_DIRECTION_IN_RANGE, MAX_DIRECTION_IN_RANGE = 2.0**-32, 2.0**32


@jit
def all_finite(v: Vec3) -> bool:
    return math.isfinite(v[0]) and math.isfinite(v[1]) and math.isfinite(v[2])


@jit
def find_invalid_ray(o: Any, d: Any, start: int, stop: int) -> int:
    """The first of rays start..stop that is not finite or has no direction; else ALL_IN_RANGE or OUT_OF_RANGE."""
    plain = True
    for i in range(start, stop):
        length = max_norm(row(d, i))
        if not (length > 0.0 and all_finite(row(o, i)) and all_finite(row(d, i))):
            return i
        plain &= MIN_DIRECTION_IN_RANGE < length < MAX_DIRECTION_IN_RANGE
    return ALL_IN_RANGE if plain else OUT_OF_RANGE


# ---- nearest hits ----


class KeepNearest(NamedTuple):
    """Mode of a traversal: keep the nearest hit, and mark it where float64 cannot decide."""

    any_hit: bool  # any certain hit will do


class Candidates(NamedTuple):
    """Mode of a traversal: list all primitives that may be hit first."""

    ends: np.ndarray  # (n,) int64, the place of the next candidate of each ray
    prims: np.ndarray  # int32, numbers within the kind; empty to count them only


Best = tuple[float, float, int, bool]
"""(t, error, number of the primitive within its kind or -1 for the earlier hit, whether that is uncertain)"""


@implement(update_best, KeepNearest)
def _update_nearest(mode: Any, best: Best, i: int, k: int, hit: tuple[float, float]) -> Best:
    t, error = any_hit_result(hit[0], hit[1], mode.any_hit)
    ahead, margin = best[0] - t if t < math.inf else -math.inf, best[1] + error
    uncertain = best[3] | (abs(ahead) <= margin)
    return (t, error, k, uncertain) if ahead > margin else (best[0], best[1], best[2], uncertain)


# For any-hit rays, a certain hit counts as nearer than all others, which ends the search.
ANY_HIT_T = -1.0


@inlined
def any_hit_result(t: float, error: float, any_hit: bool) -> tuple[float, float]:
    """The result of `intersect`, for any-hit rays with ANY_HIT_T at a certain hit."""
    sure = any_hit & (t < math.inf) & (error < math.inf)
    return ANY_HIT_T if sure else t, 0.0 if sure else error


@implement(update_best, Candidates)
def _list_candidate(mode: Any, best: Best, i: int, k: int, hit: tuple[float, float]) -> Best:
    """List the primitive unless it is sure to lie behind the best."""
    if hit[0] < math.inf and hit[0] - hit[1] <= best[0] + best[1]:
        if len(mode.prims) > 0:
            mode.prims[mode.ends[i]] = k
        mode.ends[i] += 1
    return best


@jit
def list_candidates(mode: Any, prims: Any, count: int, rays: Any, sketch: Any, start: int, stop: int) -> None:
    """List primitives that rays start..stop may hit first, of all `count` of a kind. sketch: hits by float64."""
    for i in range(start, stop):
        o, d = row(rays.o, i), row(rays.d, i)
        best = sketch.t[i], sketch.error[i], -1, False
        for k in range(count):
            pre = prepare(prims, load(prims, k), o)
            if not surely_misses(prims, pre, d):
                update_best(mode, best, i, k, intersect(prims, pre, d, rays.t_min[i], rays.t_max[i]))


@jit
def nearest_of_candidates(
    prims: Any, rays: Any, starts: Any, candidates: Any, found: Any, start: int, stop: int
) -> None:
    """Find which of candidates[starts[i]:starts[i + 1]] ray i hits first, exactly, for rays start..stop.

    found: misses before. Candidates are ordered by (exact t, number). A t of which float64 is certain is kept.
    """
    for i in range(start, stop):
        o, d, t_min, t_max = row(rays.o, i), row(rays.d, i), rays.t_min[i], rays.t_max[i]
        if not t_min < t_max:  # nothing lies between, and exact arithmetic has no inf but as t_max
            continue
        first, chosen = no_root(), -1
        for at in range(starts[i], starts[i + 1]):
            k = candidates[at]
            if chosen >= 0 and same_geometry(prims, k, chosen):  # the same thing once more
                chosen = min(k, chosen)
                continue
            new = exact_intersect(prims, k, o, d, t_min, t_max)
            if new.hit and (chosen < 0 or precedes(new, k, first, chosen)):
                first, chosen = new, k
        if chosen >= 0:
            t, error = intersect(prims, prepare(prims, load(prims, chosen), o), d, t_min, t_max)
            if not error < math.inf:
                t = as_float(first)
                error = AS_FLOAT_REL_ERROR * t + TINY
            found.t[i], found.prim[i], found.error[i] = t, chosen, error


@jit
def hit_precedes(prims: Any, k: int, number: int, others: Any, j: int, other_number: int, rays: Any, i: int) -> int:
    """1 if ray i meets primitive k of a kind before primitive j of another kind, which it meets as well; else 0."""
    o, d, t_min, t_max = row(rays.o, i), row(rays.d, i), rays.t_min[i], rays.t_max[i]
    mine, theirs = exact_intersect(prims, k, o, d, t_min, t_max), exact_intersect(others, j, o, d, t_min, t_max)
    return 1 if precedes(mine, number, theirs, other_number) else 0


@jit
def precedes(x: Any, k: int, y: Any, j: int) -> bool:
    """Whether root x of primitive k comes before root y of primitive j."""
    first = compare(x, y)
    return first < 0 or (first == 0 and k < j)


@jit
def merge(nearest: Any, found: Any, ids: Any, contested: Any, start: int, stop: int) -> None:
    """Merge the hits of one kind into those of all kinds where float64 can decide; ids[k]: the number in the scene."""
    for i in range(start, stop):
        if found.prim[i] < 0:
            continue
        t, error = found.t[i], found.error[i]
        if t + error < nearest.t[i] - nearest.error[i]:
            nearest.t[i], nearest.prim[i], nearest.error[i] = t, ids[found.prim[i]], error
        elif t - error <= nearest.t[i] + nearest.error[i]:
            contested[i] = True


# One ray against single primitives, without culling.


@jit
def intersect_each(prims: Any, ks: Any, rays: Any, t: Any, error: Any, start: int, stop: int) -> None:
    """t[j], error[j] of ray 0 and primitive ks[j], for j in start..stop; see protocol.intersect."""
    o, d = row(rays.o, 0), row(rays.d, 0)
    for j in range(start, stop):
        pre = prepare(prims, load(prims, ks[j]), o)
        t[j], error[j] = intersect(prims, pre, d, rays.t_min[0], rays.t_max[0])
