"""Checks of one scene: every way to cast its rays and its image, against each other and against the oracle."""

from collections.abc import Iterator

import numpy as np

from caster import cast
from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.geometry.packing import Packed
from caster.rendering.casting import Culling
from caster.rendering.hits import Hits
from caster.rendering.images import camera_rays, render
from caster.rendering.plan import culling_for
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import DEPTH_ULPS, UNIT_LENGTH_ATOL, t_bounds
from mitsuba_ref.fuzz.findings import Finding, Tally
from mitsuba_ref.judge.checks.adversarial_rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import (
    NearestHits,
    PreparedScene,
    cast_by_culling,
    concatenated,
    content_seed,
    discrepancy,
    error_models,
    error_over_bound,
    nearest_of_hits,
    t_text,
    with_limits,
)
from mitsuba_ref.judge.checks.routes import RouteDifference, route_differences
from mitsuba_ref.judge.checks.scaling import exponents_of, scaling_differences
from mitsuba_ref.oracle.oracle import ExactAnswer, OutsideDomain
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.shapes.targets import Rng

LIMITED_PUBLIC_CALLS = 3  # of them by caster.cast, which takes one pair of limits a call
IMAGE_AOVS = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id")


def cast_publicly(scene: Scene, packed: Packed, rays: RayBatch) -> tuple[np.ndarray, NearestHits]:
    """(rows, their hits) by caster.cast: all rays without limits, and the first few with limits."""
    free = (rays.t_min == 0.0) & np.isinf(rays.t_max)
    calls = [np.flatnonzero(free), *np.flatnonzero(~free)[:LIMITED_PUBLIC_CALLS, None]]
    found = [
        NearestHits(*nearest_of_hits(_cast_public(scene, rays.taken(rows)), packed)) for rows in calls if len(rows)
    ]
    rows = np.concatenate(calls)
    return rows, NearestHits(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _cast_public(scene: Scene, rays: RayBatch) -> Hits:
    return cast(scene, rays.o, rays.d, t_min=float(rays.t_min[0]), t_max=float(rays.t_max[0]))


def check_rays(subject: PreparedScene, rays: RayBatch, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """Findings about these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        first = cast_by_culling(subject.packed, rays, "bvh")
        rays = concatenated(rays, with_limits(rng, rays, first))
    ours = cast_by_culling(subject.packed, rays, "bvh")
    rows, public = cast_publicly(subject.scene, subject.packed, rays)
    findings = [
        *_culling_differences(rays, ours, cast_by_culling(subject.packed, rays, "brute-force"), "brute-force"),
        *_culling_differences(rays.taken(rows), NearestHits(ours.t[rows], ours.prim[rows]), public, "caster.cast"),
        *check_surfaces(subject.scene, rays),
    ]
    return findings + adjudicate(subject, rays, ours, tally)


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


def count_exact_hits(tally: Tally, answers: list[ExactAnswer], bounds: np.ndarray) -> None:
    tally.rays += len(answers)
    hits = [answer for answer in answers if answer.hit]
    tally.hits += len(hits)
    tally.edges += sum(answer.ties[0].where != "inside" for answer in hits)
    tally.ties += sum(len(answer.ties) > 1 for answer in hits)
    tally.unbounded += int(np.isinf(bounds).sum())


def _culling_differences(rays: RayBatch, ours: NearestHits, other: NearestHits, name: str) -> Iterator[Finding]:
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
        culling: render(subject.scene, IMAGE_AOVS, culling=culling, threads=1) for culling in cullings_for(subject)
    }
    expected = images["brute-force"]
    findings = [f for name in images for f in _image_differences(subject, expected, images[name], name)]
    findings += _scaling_differences(subject, tally)
    findings += [_route_finding(found) for found in route_differences(subject.scene)]
    return findings + _adjudicate_image(subject, expected, tally)


def _scaling_differences(subject: PreparedScene, tally: Tally) -> Iterator[Finding]:
    try:
        exponents = exponents_of(subject.scene, content_seed(subject.packed))
        different = scaling_differences(subject.scene, exponents)
    except SceneError:
        tally.outside += 1
        return
    for exponent, aov, pixels in different:
        what = f"{aov}: other bits in {len(pixels)} pixels 2^{exponent} times as large"
        yield Finding("scaling", what, pixel=pixel_of(subject.scene, int(pixels[0])))


def _route_finding(found: RouteDifference) -> Finding:
    return Finding("route", str(found), pixel=(found.x, found.y))


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
    bounds = t_bounds(error_models(scene), packed, found, (rays.o, rays.d)) + DEPTH_ULPS * np.spacing(np.abs(found.t))
    count_exact_hits(tally, answers, bounds)
    rows = zip(answers, found.t.tolist(), found.prim.tolist(), bounds.tolist(), strict=True)
    wrong = ((i, discrepancy(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [Finding(kind, what, rays.taken(slice(i, i + 1)), pixel_of(scene, i)) for i, (kind, what) in wrong if kind]
