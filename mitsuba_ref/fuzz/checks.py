"""Checks of one scene: every way to cast its rays and its image, against each other and against the oracle."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from caster import cast
from caster.aovs import Aovs
from caster.geometry.packing import Packed, pack
from caster.rendering.casting import Culling, find_nearest
from caster.rendering.hits import Hits, validated_rays
from caster.rendering.images import camera_rays, render
from caster.rendering.plan import culling_for
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import DEPTH_ULPS, UNIT_LENGTH_ATOL, ErrorModels, t_bounds
from mitsuba_ref.fuzz.aims import RayBatch
from mitsuba_ref.fuzz.findings import Finding, Tally, t_text
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle, OutsideDomain
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.shapes.targets import Rng

LIMITED_RAYS_PER_EXAMPLE = 12  # rays of an example that are cast again with other limits
LIMITED_PUBLIC_CALLS = 3  # of them by caster.cast, which takes one pair of limits a call
LARGEST_FLOAT64 = float(np.finfo(np.float64).max)  # a t beyond it may be returned as this or as infinite
IMAGE_AOVS = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id")


class NearestHits(NamedTuple):
    """The first hit of each ray."""

    t: np.ndarray  # (n,) lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number in the scene, -1 on a miss


def nearest_of_hits(hits: Hits, packed: Packed) -> NearestHits:
    first = packed.first[np.maximum(hits.shape_id, 0)]
    return NearestHits(hits.t, np.where(hits.shape_id < 0, -1, first + hits.prim_id).astype(np.int64))


def cast_publicly(scene: Scene, packed: Packed, rays: RayBatch) -> tuple[np.ndarray, NearestHits]:
    """(rows, their hits) by caster.cast: all rays without limits, and the first few with limits."""
    free = (rays.t_min == 0.0) & np.isinf(rays.t_max)
    calls = [np.flatnonzero(free), *np.flatnonzero(~free)[:LIMITED_PUBLIC_CALLS, None]]
    found = [
        NearestHits(*nearest_of_hits(_cast_public(scene, rays.taken(rows)), packed))
        for rows in calls
        if len(rows)
    ]
    rows = np.concatenate(calls)
    return rows, NearestHits(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _cast_public(scene: Scene, rays: RayBatch) -> Hits:
    return cast(scene, rays.o, rays.d, t_min=float(rays.t_min[0]), t_max=float(rays.t_max[0]))


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


def with_limits(
    rng: Rng, rays: RayBatch, found: NearestHits, most: int = LIMITED_RAYS_PER_EXAMPLE
) -> RayBatch:
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
    packed = pack(scene)
    return PreparedScene(scene, packed, Oracle(packed))


def check_rays(subject: PreparedScene, rays: RayBatch, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """Findings about these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        first = cast_by_culling(subject.packed, rays, "bvh")
        rays = concatenated(rays, with_limits(rng, rays, first))
    ours = cast_by_culling(subject.packed, rays, "bvh")
    rows, public = cast_publicly(subject.scene, subject.packed, rays)
    findings = [
        *_culling_differences(
            rays, ours, cast_by_culling(subject.packed, rays, "brute-force"), "brute-force"
        ),
        *_culling_differences(
            rays.taken(rows), NearestHits(ours.t[rows], ours.prim[rows]), public, "caster.cast"
        ),
        *check_surfaces(subject.scene, rays),
    ]
    return findings + adjudicate(subject, rays, ours, tally)


def error_models(scene: Scene) -> ErrorModels:
    return [reference_of(shape).model_of for shape in scene.shapes]


def adjudicate(subject: PreparedScene, rays: RayBatch, ours: NearestHits, tally: Tally) -> list[Finding]:
    """Ours against the exact answers: hit or miss, primitive, and t within its bound."""
    try:
        answers = subject.oracle.first_hits(*rays)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    bounds = t_bounds(error_models(subject.scene), subject.packed, ours, (rays.o, rays.d))
    count_exact_hits(tally, answers, bounds)
    rows = list(zip(answers, ours.t.tolist(), ours.prim.tolist(), bounds.tolist(), strict=True))
    tally.worst = max((tally.worst, *(error_over_bound(*row) for row in rows)))
    wrong = ((i, discrepancy(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [Finding(kind, what, rays.taken(slice(i, i + 1))) for i, (kind, what) in wrong if kind]


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


def count_exact_hits(tally: Tally, answers: list[ExactAnswer], bounds: np.ndarray) -> None:
    tally.rays += len(answers)
    hits = [answer for answer in answers if answer.hit]
    tally.hits += len(hits)
    tally.edges += sum(answer.ties[0].where != "inside" for answer in hits)
    tally.ties += sum(len(answer.ties) > 1 for answer in hits)
    tally.unbounded += int(np.isinf(bounds).sum())


def _culling_differences(
    rays: RayBatch, ours: NearestHits, other: NearestHits, name: str
) -> Iterator[Finding]:
    differs = (ours.t.view(np.int64) != other.t.view(np.int64)) | (ours.prim != other.prim)
    for i in np.flatnonzero(differs):
        one, two = (f"primitive {found.prim[i]} at t {t_text(found.t[i])}" for found in (ours, other))
        yield Finding("culling", f"bvh: {one}; {name}: {two}", rays.taken(slice(i, i + 1)))


def check_surfaces(scene: Scene, rays: RayBatch) -> Iterator[Finding]:
    """Of every hit: finite positions and normals, geometric normals of length 1, shading normals of 1 or 0."""
    hits = cast(scene, rays.o, rays.d)
    hit = hits.shape_id >= 0
    surface = hits.surface
    length, shading = (np.sqrt((n * n).sum(axis=1)) for n in (surface.n, surface.sh_n))
    unit = np.abs(length - 1.0) <= UNIT_LENGTH_ATOL
    shaded = (np.abs(shading - 1.0) <= UNIT_LENGTH_ATOL) | (shading == 0.0)  # vertex normals may cancel
    with np.errstate(over="ignore", invalid="ignore"):
        beyond = np.isinf(hits.t * np.abs(rays.d).max(axis=1))  # a position that float64 cannot represent
    fine = (np.isfinite(surface.p).all(axis=1) | beyond) & unit & shaded
    for i in np.flatnonzero(hit & ~fine):
        what = f"p {surface.p[i].tolist()}, n {surface.n[i].tolist()}, sh_n {surface.sh_n[i].tolist()}"
        ray = rays.taken(slice(i, i + 1))._replace(t_min=np.zeros(1), t_max=np.full(1, np.inf))
        yield Finding("surface", f"shape {hits.shape_id[i]} is hit with {what}", ray)


def cullings_for(subject: PreparedScene) -> tuple[Culling, ...]:
    """The cullings that the scene's camera supports."""
    film = subject.scene.film
    planned = culling_for(subject.scene.camera.pack(film.width, film.height))[0]
    return ("brute-force", "bvh", "raster") if planned == "raster" else ("brute-force", "bvh")


def check_image(subject: PreparedScene, tally: Tally) -> list[Finding]:
    """Findings about the image of the scene's own camera."""
    images = {
        culling: render(subject.scene, IMAGE_AOVS, culling=culling, threads=1)
        for culling in cullings_for(subject)
    }
    expected = images["brute-force"]
    findings = [f for name in images for f in _image_differences(subject, expected, images[name], name)]
    return findings + _adjudicate_image(subject, expected, tally)


def _image_differences(subject: PreparedScene, expected: Aovs, other: Aovs, name: str) -> Iterator[Finding]:
    for aov in IMAGE_AOVS:
        a, b = (np.ascontiguousarray(image[aov]).view(np.uint8) for image in (expected, other))
        size = len(expected.hit.ravel())
        for i in np.flatnonzero((a.reshape(size, -1) != b.reshape(size, -1)).any(axis=1)):
            values = (image[aov].reshape(size, -1)[i].tolist() for image in (expected, other))
            what = f"{aov}: brute-force: {next(values)}; {name}: {next(values)}"
            yield Finding("culling", what, pixel=pixel_of(subject.scene, int(i)))


def _adjudicate_image(subject: PreparedScene, image: Aovs, tally: Tally) -> list[Finding]:
    scene, packed = subject.scene, subject.packed
    film = camera_rays(scene, threads=1)
    rays = RayBatch(film.o, film.d, film.t_min, film.t_max)
    try:
        answers = subject.oracle.first_hits(*rays)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    shape, prim = image["shape_id"].ravel(), image["prim_id"].ravel()
    length = np.sqrt((rays.d * rays.d).sum(axis=1))
    depth = image["depth"].ravel()
    number = np.where(shape < 0, -1, packed.first[np.maximum(shape, 0)] + prim)
    found = NearestHits(depth / length, number)
    bounds = t_bounds(error_models(scene), packed, found, (rays.o, rays.d)) + DEPTH_ULPS * np.spacing(
        np.abs(found.t)
    )
    count_exact_hits(tally, answers, bounds)
    rows = zip(answers, found.t.tolist(), found.prim.tolist(), bounds.tolist(), strict=True)
    wrong = ((i, discrepancy(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [
        Finding(kind, what, rays.taken(slice(i, i + 1)), pixel_of(scene, i))
        for i, (kind, what) in wrong
        if kind
    ]
