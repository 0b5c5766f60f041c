"""The ways in which the caster can be asked about a ray; all have to give the same bits."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from caster import cast
from caster.geometry.packing import Packed, pack
from caster.rendering.casting import Culling, find_nearest
from caster.rendering.hits import Hits, validated_rays
from caster.rendering.images import Aovs, camera_rays, render
from caster.rendering.plan import culling_for
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import KU_OURS, Intersections
from mitsuba_ref.error_model.scene_model import reference_of
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.findings import Finding, Tally, t_text
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle, OutsideDomain
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.shapes.targets import Rng

LIMITED_RAYS_PER_EXAMPLE = 12  # rays of an example that are cast again with other limits
LIMITED_PUBLIC_CALLS = 3  # of them by caster.cast, which takes one pair of limits a call


class NearestHits(NamedTuple):
    """What each ray meets first."""

    t: np.ndarray  # (n,) lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number in the scene, -1 on a miss


def nearest_of_hits(hits: Hits, packed: Packed) -> NearestHits:
    first = packed.first[np.maximum(hits.shape_id, 0)]
    return NearestHits(hits.t, np.where(hits.shape_id < 0, -1, first + hits.prim_id).astype(np.int64))


def cast_publicly(scene: Scene, packed: Packed, shots: Shots) -> tuple[np.ndarray, NearestHits]:
    """(rows, what they meet) by caster.cast: all rays without limits, and the first few that have some."""
    free = (shots.t_min == 0.0) & np.isinf(shots.t_max)
    calls = [np.flatnonzero(free), *np.flatnonzero(~free)[:LIMITED_PUBLIC_CALLS, None]]
    found = [
        NearestHits(*nearest_of_hits(_cast_public(scene, shots.taken(rows)), packed))
        for rows in calls
        if len(rows)
    ]
    rows = np.concatenate(calls)
    return rows, NearestHits(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _cast_public(scene: Scene, shots: Shots) -> Hits:
    return cast(scene, shots.o, shots.d, t_min=float(shots.t_min[0]), t_max=float(shots.t_max[0]))


def cast_by_culling(packed: Packed, shots: Shots, culling: Culling) -> NearestHits:
    """By the caster's innards; directions brought to about length 1 by a power of two, as caster.cast does."""
    return _cast_scaled(lossless_exponents(shots), packed, shots, culling)


def _cast_scaled(exponent: np.ndarray, packed: Packed, shots: Shots, culling: Culling) -> NearestHits:
    """With directions 2^-exponent as long. Where t is denormal by that, and would not be otherwise, as they are."""
    with np.errstate(over="ignore", under="ignore"):
        d = np.ldexp(shots.d, -exponent[:, None])
        limits = {"t_min": np.ldexp(shots.t_min, exponent), "t_max": np.ldexp(shots.t_max, exponent)}
    rays = validated_rays(shots.o, d, 0.0, np.inf)._replace(**limits)
    nearest = find_nearest(packed, rays, culling, threads=1)
    with np.errstate(over="ignore", under="ignore"):
        found = NearestHits(np.ldexp(nearest.t, -exponent), nearest.prim.astype(np.int64))
    rows = np.flatnonzero((exponent < 0) & (nearest.t < np.finfo(np.float64).tiny))
    if len(rows):
        found.t[rows] = _cast_scaled(np.zeros(len(rows), int), packed, shots.taken(rows), culling).t
    return found


def lossless_exponents(shots: Shots) -> np.ndarray:
    """(n,) k for which 2^-k d is of about length 1; 0 where bits would be lost by that, of d or of the limits."""
    exponent = np.frexp(np.abs(shots.d).max(axis=1, initial=0.0))[1]
    numbers = np.column_stack([shots.d, shots.t_min, shots.t_max])
    powers = exponent[:, None] * np.array([-1, -1, -1, 1, 1])
    with np.errstate(over="ignore", under="ignore"):
        kept = (np.ldexp(np.ldexp(numbers, powers), -powers) == numbers).all(axis=1)
    return np.where(kept, exponent, 0)


def with_limits(rng: Rng, shots: Shots, found: NearestHits, most: int = LIMITED_RAYS_PER_EXAMPLE) -> Shots:
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


def concatenated(first: Shots, second: Shots) -> Shots:
    return Shots(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


# How far float64 rounding may put a t from the exact one.


# t itself is a float64, and cast scales it once more: half a unit in the last place each, and the least float64
# where it is denormal.
T_ROUNDING_ULPS = 1.0

# Below 2^-1022 numbers are rounded to multiples of 2^-1074, not to a share of themselves, which the error model does
# not know. A dozen such roundings over a slope of no less than 2^-60 put t off by no more than this.
UNDERFLOW_BOUND = 2.0**-1010


def t_bounds(scene: Scene, packed: Packed, found: NearestHits, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) bound on |t - exact t| of each hit; inf where float64 cannot resolve it, NaN on a miss.

    The judge's error model with K u of float64: numbers perturbed by 4 units in their last places, times the
    condition of each crossing. Taken at the root that is nearest to t.
    """
    bounds = np.full(len(found.t), np.nan)
    shape = packed.shape_of(found.prim)
    for number in np.unique(shape[found.prim >= 0]):
        rows = np.flatnonzero((shape == number) & (found.prim >= 0))
        part = packed.parts[number]
        model = reference_of(scene.shapes[number]).model_of(part)
        intersect = model.intersect_ours or model.intersect
        with np.errstate(all="ignore"):
            k = found.prim[rows] - packed.first[number]
            roots = intersect(part, k, o[rows], d[rows], KU_OURS)
            bounds[rows] = _error_of_nearest_root(found.t[rows], roots)
    with np.errstate(all="ignore"):
        return bounds + T_ROUNDING_ULPS * np.spacing(np.abs(found.t)) + UNDERFLOW_BOUND


def _error_of_nearest_root(t: np.ndarray, roots: Sequence[Intersections]) -> np.ndarray:
    away = np.array([np.abs(root.t - t) for root in roots])
    errors = np.array([root.t_error for root in roots])
    nearest = np.argmin(np.where(np.isnan(away), np.inf, away), axis=0)
    error = errors[nearest, np.arange(len(t))]
    return np.where(np.isnan(error), np.inf, error)


# Rays through one scene: every way to cast them, held to the oracle.


# unit() divides by a rounded length: each component passes at most four roundings, so its square is off by 8 u.
UNIT_ATOL = 16 * 2.0**-53


LARGEST_FLOAT64 = float(np.finfo(np.float64).max)  # a t beyond it may be told as this or as infinite


class PreparedScene(NamedTuple):
    """A scene that is asked about."""

    scene: Scene
    packed: Packed
    oracle: Oracle


def prepared_scene(scene: Scene) -> PreparedScene:
    """Raises OutsideDomain where a primitive's numbers are not finite."""
    packed = pack(scene)
    return PreparedScene(scene, packed, Oracle(packed))


def check_rays(subject: PreparedScene, shots: Shots, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """All that is wrong with these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        first = cast_by_culling(subject.packed, shots, "bvh")
        shots = concatenated(shots, with_limits(rng, shots, first))
    ours = cast_by_culling(subject.packed, shots, "bvh")
    rows, public = cast_publicly(subject.scene, subject.packed, shots)
    findings = [
        *_culling_differences(
            shots, ours, cast_by_culling(subject.packed, shots, "brute-force"), "brute-force"
        ),
        *_culling_differences(
            shots.taken(rows), NearestHits(ours.t[rows], ours.prim[rows]), public, "caster.cast"
        ),
        *check_surfaces(subject.scene, shots),
    ]
    return findings + adjudicate(subject, shots, ours, tally)


def adjudicate(subject: PreparedScene, shots: Shots, ours: NearestHits, tally: Tally) -> list[Finding]:
    """Ours against the exact answers: hit or miss, primitive, and t within its bound."""
    try:
        answers = subject.oracle.first_hits(*shots)
    except OutsideDomain:
        tally.outside += len(shots.t_min)
        return []
    bounds = t_bounds(subject.scene, subject.packed, ours, shots.o, shots.d)
    count_exact_hits(tally, answers, bounds)
    rows = list(zip(answers, ours.t.tolist(), ours.prim.tolist(), bounds.tolist(), strict=True))
    tally.worst = max((tally.worst, *(error_over_bound(*row) for row in rows)))
    wrong = ((i, discrepancy(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [Finding(kind, what, shots.taken(slice(i, i + 1))) for i, (kind, what) in wrong if kind]


def discrepancy(answer: ExactAnswer, t: float, prim: int, bound: float) -> tuple[str, str]:
    """(kind, words) of what is wrong with t and prim; ("", "") if they are right."""
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


def _culling_differences(shots: Shots, ours: NearestHits, other: NearestHits, name: str) -> Iterator[Finding]:
    differs = (ours.t.view(np.int64) != other.t.view(np.int64)) | (ours.prim != other.prim)
    for i in np.flatnonzero(differs):
        one, two = (f"primitive {found.prim[i]} at t {t_text(found.t[i])}" for found in (ours, other))
        yield Finding("culling", f"bvh: {one}; {name}: {two}", shots.taken(slice(i, i + 1)))


def check_surfaces(scene: Scene, shots: Shots) -> Iterator[Finding]:
    """Of every hit: finite positions and normals, geometric normals of length 1, shading normals of 1 or 0."""
    hits = cast(scene, shots.o, shots.d)
    hit = hits.shape_id >= 0
    surface = hits.surface
    length, shading = (np.sqrt((n * n).sum(axis=1)) for n in (surface.n, surface.sh_n))
    unit = np.abs(length - 1.0) <= UNIT_ATOL
    shaded = (np.abs(shading - 1.0) <= UNIT_ATOL) | (shading == 0.0)  # vertex normals may cancel
    with np.errstate(over="ignore", invalid="ignore"):
        beyond = np.isinf(hits.t * np.abs(shots.d).max(axis=1))  # a place that float64 has no numbers for
    fine = (np.isfinite(surface.p).all(axis=1) | beyond) & unit & shaded
    for i in np.flatnonzero(hit & ~fine):
        what = f"p {surface.p[i].tolist()}, n {surface.n[i].tolist()}, sh_n {surface.sh_n[i].tolist()}"
        ray = shots.taken(slice(i, i + 1))._replace(t_min=np.zeros(1), t_max=np.full(1, np.inf))
        yield Finding("surface", f"shape {hits.shape_id[i]} is hit with {what}", ray)


# Camera rays: the pictures of all cullings to the bit, and what they show held to the oracle.


IMAGE_AOVS = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id")

# depth = t |d|: the length passes at most 4 roundings, the product one, and t is found again by a division.
DEPTH_ULPS = 4.0


def cullings_for(subject: PreparedScene) -> tuple[Culling, ...]:
    """Those that the scene's camera allows."""
    film = subject.scene.film
    planned = culling_for(subject.scene.camera.pack(film.width, film.height))[0]
    return ("brute-force", "bvh", "raster") if planned == "raster" else ("brute-force", "bvh")


def check_image(subject: PreparedScene, tally: Tally) -> list[Finding]:
    """All that is wrong with the scene's own picture."""
    pictures = {
        culling: render(subject.scene, IMAGE_AOVS, culling=culling, threads=1)
        for culling in cullings_for(subject)
    }
    obvious = pictures["brute-force"]
    findings = [f for name in pictures for f in _image_differences(subject, obvious, pictures[name], name)]
    return findings + _adjudicate_image(subject, obvious, tally)


def _image_differences(subject: PreparedScene, obvious: Aovs, other: Aovs, name: str) -> Iterator[Finding]:
    for aov in IMAGE_AOVS:
        a, b = (np.ascontiguousarray(images[aov]).view(np.uint8) for images in (obvious, other))
        size = len(obvious.hit.ravel())
        for i in np.flatnonzero((a.reshape(size, -1) != b.reshape(size, -1)).any(axis=1)):
            values = (images[aov].reshape(size, -1)[i].tolist() for images in (obvious, other))
            what = f"{aov}: everything: {next(values)}; {name}: {next(values)}"
            yield Finding("culling", what, pixel=pixel_of(subject.scene, int(i)))


def _adjudicate_image(subject: PreparedScene, picture: Aovs, tally: Tally) -> list[Finding]:
    scene, packed = subject.scene, subject.packed
    rays = camera_rays(scene, threads=1)
    shots = Shots(rays.o, rays.d, rays.t_min, rays.t_max)
    try:
        answers = subject.oracle.first_hits(*shots)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    shape, prim = picture["shape_id"].ravel(), picture["prim_id"].ravel()
    length = np.sqrt((rays.d * rays.d).sum(axis=1))
    depth = picture["depth"].ravel()
    number = np.where(shape < 0, -1, packed.first[np.maximum(shape, 0)] + prim)
    found = NearestHits(depth / length, number)
    bounds = t_bounds(scene, packed, found, rays.o, rays.d) + DEPTH_ULPS * np.spacing(np.abs(found.t))
    count_exact_hits(tally, answers, bounds)
    rows = zip(answers, found.t.tolist(), found.prim.tolist(), bounds.tolist(), strict=True)
    wrong = ((i, discrepancy(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [
        Finding(kind, what, shots.taken(slice(i, i + 1)), pixel_of(scene, i))
        for i, (kind, what) in wrong
        if kind
    ]
