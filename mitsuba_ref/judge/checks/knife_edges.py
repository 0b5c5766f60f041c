"""Rays aimed at edges, vertices, silhouettes and tangents of a scene, compared with exact arithmetic.

Pixels of an image rarely hit a place where rounding decides; these few hundred float64 rays of each scene do. An error
bound of a kernel that is too small shows as a wrong first hit or a wrong t.
"""

import zlib
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.geometry.packing import Packed, packed
from caster.rendering.casting import Culling
from caster.rendering.hits import cast_any_lengths, validated_rays
from caster.rendering.images import camera_rays
from caster.scene.model import Film, Scene
from mitsuba_ref.error_model.bounds import t_bounds
from mitsuba_ref.error_model.intersections import Array, Rays, without_overflow_warnings
from mitsuba_ref.hard.rays import ALL_AIMS, Targets, aimed_rays
from mitsuba_ref.judge.checks import OURS, Found, check
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.reference.shared_input import own_model
from mitsuba_ref.shapes.targets import Rng

# ---- casting rays by any culling, and comparing the first hit and its t with exact arithmetic

LIMITED_RAYS = 12  # rays of an example that are cast again with other limits
LARGEST_FLOAT64 = float(np.finfo(np.float64).max)  # a larger t may be returned as this or as infinite


class NearestHits(NamedTuple):
    """The first hit of each ray."""

    t: Array  # (n,) lengths of d, inf on a miss
    prim: Array  # (n,) number in the scene, -1 on a miss


def nearest_hits(packed: Packed, t: Array, shape: Array, prim: Array) -> NearestHits:
    """Hits by number of the shape, -1 on a miss, and of the primitive within it."""
    within = packed.first[np.maximum(shape, 0)] + np.maximum(prim, 0)
    return NearestHits(t, np.where(shape < 0, -1, within).astype(np.int64))


@without_overflow_warnings
def cast_by_culling(packed: Packed, rays: Rays, culling: Culling) -> NearestHits:
    """Cast rays by a given culling, with directions scaled as caster.cast scales them."""
    given = validated_rays(rays.o, rays.d, 0.0, np.inf)._replace(t_min=rays.t_min, t_max=rays.t_max)  # any limits
    _, nearest, t = cast_any_lengths(packed, given, culling, threads=1)
    return NearestHits(t, nearest.prim.astype(np.int64))


@without_overflow_warnings
def with_limits(rng: Rng, rays: Rays, found: NearestHits, most: int = LIMITED_RAYS) -> Rays:
    """Some of the rays that hit, with t_min or t_max just before, at or beyond the hit."""
    hits = np.flatnonzero((found.prim >= 0) & (found.t > 0.0) & np.isfinite(found.t))
    rows = rng.permutation(hits)[:most]
    t, n = found.t[rows], len(rows)
    before, after = np.nextafter(t, 0.0), np.nextafter(t, np.inf)
    start = np.choose(rng.integers(6, size=n), [t, before, np.zeros(n), np.zeros(n), 0.5 * t, after])
    end = np.choose(rng.integers(4, size=n), [t, before, np.full(n, np.inf), 2.0 * t])
    end = np.where(start > 0.0, np.where(end >= start, end, np.inf), np.minimum(end, t))
    return Rays(rays.o[rows], rays.d[rows], start, end)


def concatenated(first: Rays, second: Rays) -> Rays:
    return Rays(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


class RayVerdict(NamedTuple):
    """The hit of one ray, compared with the exact answer."""

    answer: ExactAnswer
    bound: float  # of t
    ratio: float = 0.0  # the error of t over its bound; inf for another first hit
    kind: str = ""  # "missed", "phantom", "prim" or "t"; "" if right
    text: str = ""  # both hits in words; "" if right


def adjudicate(oracle: Oracle, rays: Rays, found: NearestHits) -> list[RayVerdict]:
    """Compare hit or miss, primitive, and t within its bound.

    Raises OutsideDomain for rays that the oracle does not take.
    """
    answers = oracle.first_hits(*rays)
    bounds = t_bounds(own_model(oracle.packed), found, (rays.o, rays.d))
    return list(map(_verdict, answers, found.t.tolist(), found.prim.tolist(), bounds.tolist()))


def _verdict(answer: ExactAnswer, t: float, prim: int, bound: float) -> RayVerdict:
    if prim != answer.prim:
        kind = "missed" if prim < 0 else "phantom" if answer.t is None else "prim"
        return RayVerdict(answer, bound, np.inf, kind, _in_words(answer, t, prim))
    if answer.t is None:
        return RayVerdict(answer, bound)
    off = float(answer.t.off(t))
    largest = t >= LARGEST_FLOAT64
    ratio = 0.0 if largest else off / bound
    if off <= bound or (largest and answer.t > LARGEST_FLOAT64):
        return RayVerdict(answer, bound, ratio)
    ratio = max(ratio, float(np.nextafter(1.0, 2.0))) if off == off else np.inf
    return RayVerdict(answer, bound, ratio, "t", f"{_in_words(answer, t, prim)}: {off:.3g} off, bound {bound:.3g}")


def _in_words(answer: ExactAnswer, t: float, prim: int) -> str:
    ours = f"ours hits primitive {prim} at t {t_text(t)}" if prim >= 0 else "ours misses"
    if answer.t is None:
        return f"{ours}, exactly it is a miss"
    return f"{ours}, exactly primitive {answer.prim} ({answer.where}) is hit at t {t_text(answer.distance)}"


def t_text(t: float) -> str:
    return f"{t!r} ({float(t).hex()})" if np.isfinite(t) else "a miss"


# ---- aimed rays

# Rays of one scene: one for so many pixels of its film, within limits.
PIXELS_PER_AIMED_RAY = 4
MIN_AIMED_RAYS, MAX_AIMED_RAYS = 32, 320
SHARE_OF_OTHERS = 0.1  # further rays of the scene's own camera, and as many cast again with t_min or t_max at the hit
REPRODUCERS = 2  # files for one scene


class AimedFailure(NamedTuple):
    """One ray whose first hit or t, or the origin of a ray after it, is wrong by exact arithmetic."""

    what: str
    scene: Scene  # of one pixel, with this ray
    label: str = "knife-edge"  # of its file


@check(of=(OURS,))
def check_knife_edges(scene: Scene, wrong_rays: list[AimedFailure]) -> Found:
    """Compare first hits of aimed rays with exact arithmetic: the primitive, and t within its float64 bound.

    Some of the failing rays are appended to `wrong_rays` as scenes of one ray.
    """
    numbers = packed(scene)
    oracle = Oracle(numbers)
    if not numbers.first[-1]:
        return 0.0, "no primitive to aim at"
    rays = rays_at_edges(scene)
    verdicts = adjudicate(oracle, rays, cast_by_culling(numbers, rays, "bvh"))
    bad, words = [i for i, each in enumerate(verdicts) if each.kind], f"{len(verdicts)} aimed rays"
    if bad:
        o, d = (a[bad[0]].tolist() for a in (rays.o, rays.d))
        words = f"{len(bad)} of {words}, first from {o} along {d}: {verdicts[bad[0]].text}"
    for i in bad[:REPRODUCERS]:
        wrong_rays.append(
            AimedFailure(verdicts[i].text, scene_of_ray(scene, rays.o[i], rays.d[i], float(rays.t_max[i])))
        )
    return max(each.ratio for each in verdicts), words


@np.errstate(all="ignore")  # of kernels in plain Python, on directions of 1e-30 and 1e30
def rays_at_edges(scene: Scene) -> Rays:
    """Aimed rays, some of the camera's rays, and some of both with other limits; the same for the same scene."""
    numbers, seed = packed(scene), 0  # from the geometry in world space alone, not from names and files
    for array in chain.from_iterable(numbers.parts):
        seed = zlib.crc32(np.ascontiguousarray(array).view(np.uint8).data, seed)
    rng = np.random.default_rng(seed)
    targets = Targets(numbers, rng)
    eye = np.array(scene.camera.eye, np.float64)

    def from_eye(targets: Targets, count: int) -> tuple[Array, Array]:
        return np.tile(eye, (count, 1)), targets.points(count).p - eye

    film = camera_rays(scene, threads=1)
    count = int(np.clip(len(film.o) // PIXELS_PER_AIMED_RAY, MIN_AIMED_RAYS, MAX_AIMED_RAYS))
    others = int(SHARE_OF_OTHERS * count)
    there = np.flatnonzero(film.t_max > 0.0)
    rows = np.sort(rng.choice(there, min(others, len(there)), replace=False))
    own = Rays(*film.take(rows))
    targets.fit_frame()
    rays = concatenated(own, aimed_rays(targets, count, (*ALL_AIMS, from_eye)))
    first = cast_by_culling(numbers, rays, "bvh")
    return concatenated(rays, with_limits(rng, rays, first, others))


def scene_of_ray(scene: Scene, o: Array, d: Array, t_max: float = np.inf, **parts: Any) -> Scene:
    """The scene with this ray as its camera, and with these parts in place of its own; without lights."""
    camera = Ray(origin=o, direction=d, t_max=t_max if 0.0 < t_max < np.inf else None)
    film = Film(width=1, height=1)
    return scene.model_copy(update={"film": film, "camera": camera, "lights": (), "checks": {}, **parts})
