"""Rays of a scene, cast by every culling, and compared with exact arithmetic: the first hit, and its t."""

from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed, packed
from caster.rendering.casting import Culling, find_nearest
from caster.rendering.hits import Hits, validated_rays
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import ErrorModels
from mitsuba_ref.judge.independent_checks.aims import RayBatch
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.shapes.targets import Rng

LIMITED_RAYS = 12  # rays of an example that are cast again with other limits
LARGEST_FLOAT64 = float(np.finfo(np.float64).max)  # a t beyond it may be returned as this or as infinite


class NearestHits(NamedTuple):
    """The first hit of each ray."""

    t: np.ndarray  # (n,) lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number in the scene, -1 on a miss


def nearest_of_hits(hits: Hits, packed: Packed) -> NearestHits:
    first = packed.first[np.maximum(hits.shape_id, 0)]
    return NearestHits(hits.t, np.where(hits.shape_id < 0, -1, first + hits.prim_id).astype(np.int64))


def cast_by_culling(packed: Packed, rays: RayBatch, culling: Culling) -> NearestHits:
    """By the internal casting; directions scaled to about length 1 by a power of two, as caster.cast does."""
    return _cast_scaled(lossless_exponents(rays), packed, rays, culling)


def _cast_scaled(exponent: np.ndarray, packed: Packed, rays: RayBatch, culling: Culling) -> NearestHits:
    """With directions 2^-exponent as long; unscaled where the scaling alone makes t denormal."""
    with np.errstate(over="ignore", under="ignore"):
        d = np.ldexp(rays.d, -exponent[:, None])
        limits = {"t_min": np.ldexp(rays.t_min, exponent), "t_max": np.ldexp(rays.t_max, exponent)}
    scaled = validated_rays(rays.o, d, 0.0, np.inf)._replace(**limits)
    nearest = find_nearest(packed, scaled, culling, threads=1)
    with np.errstate(over="ignore", under="ignore"):
        found = NearestHits(np.ldexp(nearest.t, -exponent), nearest.prim.astype(np.int64))
    rows = np.flatnonzero((exponent < 0) & (nearest.t < np.finfo(np.float64).tiny))
    if len(rows):
        found.t[rows] = _cast_scaled(np.zeros(len(rows), int), packed, rays.taken(rows), culling).t
    return found


def lossless_exponents(rays: RayBatch) -> np.ndarray:
    """(n,) k for which 2^-k d is of about length 1; 0 where bits would be lost by that, of d or of the limits."""
    exponent = np.frexp(np.abs(rays.d).max(axis=1, initial=0.0))[1]
    numbers = np.column_stack([rays.d, rays.t_min, rays.t_max])
    powers = exponent[:, None] * np.array([-1, -1, -1, 1, 1])
    with np.errstate(over="ignore", under="ignore"):
        kept = (np.ldexp(np.ldexp(numbers, powers), -powers) == numbers).all(axis=1)
    return np.where(kept, exponent, 0)


def with_limits(rng: Rng, rays: RayBatch, found: NearestHits, most: int = LIMITED_RAYS) -> RayBatch:
    """Some of the rays that hit, with t_min or t_max just before, at or beyond the hit."""
    hits = np.flatnonzero((found.prim >= 0) & (found.t > 0.0) & np.isfinite(found.t))
    rows = rng.permutation(hits)[:most]
    t, n = found.t[rows], len(rows)
    with np.errstate(over="ignore"):  # t may be the largest float64
        before, after = np.nextafter(t, 0.0), np.nextafter(t, np.inf)
        start = np.choose(rng.integers(6, size=n), [t, before, np.zeros(n), np.zeros(n), 0.5 * t, after])
        end = np.choose(rng.integers(4, size=n), [t, before, np.full(n, np.inf), 2.0 * t])
    end = np.where(start > 0.0, np.where(end >= start, end, np.inf), np.minimum(end, t))
    return RayBatch(rays.o[rows], rays.d[rows], start, end)


def concatenated(first: RayBatch, second: RayBatch) -> RayBatch:
    return RayBatch(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


class PreparedScene(NamedTuple):
    """A scene, packed, with its oracle."""

    scene: Scene
    packed: Packed
    oracle: Oracle


def prepared_scene(scene: Scene) -> PreparedScene:
    """Raises OutsideDomain where a primitive's numbers are not finite."""
    numbers = packed(scene)
    return PreparedScene(scene, numbers, Oracle(numbers))


def error_models(scene: Scene) -> ErrorModels:
    return [reference_of(shape).model_of for shape in scene.shapes]


def discrepancy(answer: ExactAnswer, t: float, prim: int, bound: float) -> tuple[str, str]:
    """(kind, text) of an error in t or prim; ("", "") if they are right."""
    if answer.t is None:
        what = f"ours hits primitive {prim} at t {t_text(t)}, exactly it is a miss"
        return ("", "") if prim < 0 else ("phantom", what)
    if prim == answer.prim:
        off = answer.t.off(t)
        if off <= bound or (t >= LARGEST_FLOAT64 and answer.t > LARGEST_FLOAT64):
            return "", ""
        return "t", f"{in_words(answer, t, prim)}: {off:.3g} off, bound {bound:.3g}"
    return ("missed" if prim < 0 else "prim"), in_words(answer, t, prim)


def error_over_bound(answer: ExactAnswer, t: float, prim: int, bound: float) -> float:
    """The error of t over its bound; 0 where either is no number, and where another primitive is hit."""
    if answer.t is None or prim != answer.prim or not 0.0 < bound < np.inf or t >= LARGEST_FLOAT64:
        return 0.0
    return float(answer.t.off(t)) / bound


def in_words(answer: ExactAnswer, t: float, prim: int) -> str:
    ours = f"ours hits primitive {prim} at t {t_text(t)}" if prim >= 0 else "ours misses"
    exact = "" if answer.t is None else t_text(float(answer.t))
    return f"{ours}, exactly primitive {answer.prim} ({answer.ties[0].where}) is hit at t {exact}"


def t_text(t: float) -> str:
    return f"{t!r} ({float(t).hex()})" if np.isfinite(t) else "a miss"
