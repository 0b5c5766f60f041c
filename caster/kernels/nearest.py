"""Rays and their nearest hits: by float64, marked where that is uncertain, and decided exactly."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import generic_inlined, implement, inlined, jit
from caster.kernels.exact.numbers import AS_FLOAT_REL_ERROR, as_float, compare
from caster.kernels.math.vec import MISS, TINY, max_norm, row
from caster.kernels.protocol import (
    Vec3,
    camera_ray,
    exact_intersect,
    intersect,
    load,
    prepare,
    same_geometry,
    surely_misses,
)

Ray = tuple[Vec3, Vec3, float, float]
"""o, d, t_min, t_max"""


class Rays(NamedTuple):
    """Points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64
    t_min: np.ndarray  # (n,) float64
    t_max: np.ndarray  # (n,) float64; < 0: there is no ray

    def take(self, rows: Any) -> "Rays":
        """Some of the rays, by an index of arrays."""
        return Rays(*(a[rows] for a in self))


class Nearest(NamedTuple):
    """The first hit of each ray, exactly; t is rounded to float64."""

    t: np.ndarray  # (n,) float64, inf on a miss
    prim: np.ndarray  # (n,) int32, number of the primitive, -1 on a miss
    error: np.ndarray  # (n,) float64, the true t is within error of t


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


class KeepFirst(NamedTuple):
    """Mode of a traversal: find the primitive that a ray hits first exactly."""

    ray: Ray
    prims: Any
    reach: float  # the hit by float64 is not behind this t


@generic_inlined
def try_primitive(mode: Any, prims: Any, k: int, best: int) -> Any:
    """The best of a mode's rays after primitive k; best: a number of a primitive, or -1."""


@generic_inlined
def reach(mode: Any) -> Any:
    """The t behind which no ray of a mode has a hit that counts."""


@jit
def hit_by_float64(prims: Any, k: int, ray: Ray) -> tuple[float, float]:
    """The result of `intersect` for a ray and primitive k."""
    o, d, t_min, t_max = ray
    pre = prepare(prims, load(prims, k), o)
    return MISS if surely_misses(prims, pre, d) else intersect(prims, pre, d, t_min, t_max)


# For any-hit rays, a certain hit counts as nearer than all others, which ends the search.
ANY_HIT_T = -1.0


@inlined
def any_hit_result(t: float, error: float, any_hit: bool) -> tuple[float, float]:
    """The result of `intersect`, for any-hit rays with ANY_HIT_T at a certain hit."""
    sure = any_hit & (t < math.inf) & (error < math.inf)
    return ANY_HIT_T if sure else t, 0.0 if sure else error


@implement(try_primitive, KeepFirst)
def _try_first(mode: Any, prims: Any, k: int, best: int) -> int:
    t, error = hit_by_float64(prims, k, mode.ray)
    if t < math.inf and t - error <= mode.reach:
        return first_of(prims, mode.ray, k, error < math.inf, best)
    return best


@implement(reach, KeepFirst)
def _reach_of_first(mode: Any) -> float:
    return mode.reach


@jit
def first_of(prims: Any, ray: Ray, k: int, is_hit: bool, first: int) -> int:
    """The number of the first hit: `first` if that is not negative, or primitive k; is_hit: float64 is sure of k."""
    if first >= 0 and same_geometry(prims, k, first):  # the same thing once more
        return min(k, first)
    if first < 0 and is_hit:
        return k
    o, d, t_min, t_max = ray
    new = exact_intersect(prims, k, o, d, t_min, t_max)
    if not new.hit:
        return first
    return k if first < 0 or precedes(new, k, exact_intersect(prims, first, o, d, t_min, t_max), first) else first


@jit
def ray_at(rays: Any, i: int) -> Ray:
    return row(rays.o, i), row(rays.d, i), rays.t_min[i], rays.t_max[i]


@jit
def find_first(prims: Any, count: int, rays: Any, sketch: Any, found: Any, start: int, stop: int) -> None:
    """Find what rays start..stop hit first, exactly, of all `count` primitives of a kind.

    sketch: the hits by float64, behind which nothing is looked for. found: misses before.
    """
    for i in range(start, stop):
        ray = ray_at(rays, i)
        if ray[2] < ray[3]:  # else nothing lies between, and exact arithmetic has no inf but as t_max
            mode, first = KeepFirst(ray, prims, sketch.t[i] + sketch.error[i]), -1
            for k in range(count):
                first = try_primitive(mode, prims, k, first)
            store_first(mode, first, found, i)


@jit
def store_first(mode: Any, k: int, found: Any, i: int) -> None:
    """Store primitive k as the first hit of ray i, unless k is negative. A t of which float64 is certain is kept."""
    if k >= 0:
        t, error = intersect_surely(mode.prims, k, mode.ray)
        if error == math.inf:
            error = AS_FLOAT_REL_ERROR * t + TINY
        found.t[i], found.prim[i], found.error[i] = t, k, error


@jit
def intersect_surely(prims: Any, k: int, ray: Ray) -> tuple[float, float]:
    """The result of protocol.intersect with the exact t, inf for a miss, where the error is infinite."""
    o, d, t_min, t_max = ray
    t, error = hit_by_float64(prims, k, ray)
    if error == math.inf:
        root = exact_intersect(prims, k, o, d, t_min, t_max)
        t = as_float(root) if root.hit else math.inf
    return t, error


@jit
def hit_precedes(prims: Any, k: int, number: int, others: Any, j: int, other_number: int, rays: Any, i: int) -> int:
    """1 if ray i meets primitive k of a kind before primitive j of another kind, which it meets as well; else 0."""
    o, d, t_min, t_max = ray_at(rays, i)
    mine, theirs = exact_intersect(prims, k, o, d, t_min, t_max), exact_intersect(others, j, o, d, t_min, t_max)
    return 1 if precedes(mine, number, theirs, other_number) else 0


@jit
def precedes(x: Any, k: int, y: Any, j: int) -> bool:
    """Whether root x of primitive k comes before root y of primitive j."""
    first = compare(x, y)
    return first < 0 or (first == 0 and k < j)


# One ray against single primitives, without culling.


@jit
def intersect_each(prims: Any, ray: Ray, t: Any, error: Any) -> None:
    """t[k], error[k]: `intersect_surely` of a ray and each primitive k."""
    for k in range(len(t)):
        t[k], error[k] = intersect_surely(prims, k, ray)
