"""Checks of one scene: every way to cast its rays and its image, against each other and against the oracle."""

import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from caster import cast
from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.rendering.casting import Culling
from caster.rendering.images import camera_rays, render
from caster.rendering.plan import culling_for
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import DEPTH_ULPS, UNIT_LENGTH_ATOL
from mitsuba_ref.fuzz.findings import Finding, Tally
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks import knife_edges
from mitsuba_ref.judge.checks.knife_edges import (
    NearestHits,
    PreparedScene,
    cast_by_culling,
    concatenated,
    nearest_of_hits,
    t_text,
    with_limits,
)
from mitsuba_ref.oracle.oracle import OutsideDomain
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.shapes.targets import Rng

LIMITED_PUBLIC_CALLS = 3  # of them by caster.cast, which takes one pair of limits a call
IMAGE_AOVS = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id")
SCENE_ERRORS = (SceneError, ValidationError, OutsideDomain)  # raised by scenes that cannot be checked


def exception_finding(error: Exception) -> Finding:
    """The finding that an exception was raised."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Finding("error", f"{type(error).__name__} at {where}: {error}")


def check_rays(subject: PreparedScene, rays: RayBatch, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """Findings about these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        first = cast_by_culling(subject.packed, rays, "bvh")
        rays = concatenated(rays, with_limits(rng, rays, first))
    ours = cast_by_culling(subject.packed, rays, "bvh")
    slow = cast_by_culling(subject.packed, rays, "brute-force")
    rows, public = cast_publicly(subject, rays)
    return [
        *_culling_differences(rays, ours, slow, "brute-force"),
        *_culling_differences(rays.taken(rows), NearestHits(ours.t[rows], ours.prim[rows]), public, "caster.cast"),
        *check_surfaces(subject.scene, rays),
        *adjudicate(subject, rays, ours, tally),
    ]


def cast_publicly(subject: PreparedScene, rays: RayBatch) -> tuple[np.ndarray, NearestHits]:
    """(rows, their hits) by caster.cast: all rays without limits, and the first few with limits."""
    free = (rays.t_min == 0.0) & np.isinf(rays.t_max)
    calls = [np.flatnonzero(free), *np.flatnonzero(~free)[:LIMITED_PUBLIC_CALLS, None]]
    found = []
    for rows in filter(len, calls):
        o, d, t_min, t_max = rays.taken(rows)
        hits = cast(subject.scene, o, d, t_min=float(t_min[0]), t_max=float(t_max[0]))
        found.append(nearest_of_hits(hits, subject.packed))
    return np.concatenate(calls), NearestHits(*(np.concatenate(column) for column in zip(*found, strict=True)))


def adjudicate(
    subject: PreparedScene,
    rays: RayBatch,
    found: NearestHits,
    tally: Tally,
    pixels: Sequence[tuple[int, int]] = (),
    depth_ulps: float = 0.0,
) -> list[Finding]:
    """Findings about hits, against the exact answers. pixels: of an image's rays."""
    try:
        verdicts = knife_edges.adjudicate(subject, rays, found, depth_ulps)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    hits = [answer for answer in verdicts.answers if answer.hit]
    tally.rays += len(verdicts.answers)
    tally.hits += len(hits)
    tally.edges += sum(answer.ties[0].where != "inside" for answer in hits)
    tally.ties += sum(len(answer.ties) > 1 for answer in hits)
    tally.unbounded += int(np.isinf(verdicts.bounds).sum())
    tally.worst = max(tally.worst, float(verdicts.ratios[np.isfinite(verdicts.ratios)].max(initial=0.0)))
    return [
        Finding(kind, what, rays.taken(slice(i, i + 1)), pixels[i] if pixels else None)
        for i, (kind, what) in enumerate(zip(verdicts.kinds, verdicts.texts, strict=True))
        if kind
    ]


def _culling_differences(rays: RayBatch, ours: NearestHits, other: NearestHits, name: str) -> Iterator[Finding]:
    differs = (ours.t.view(np.int64) != other.t.view(np.int64)) | (ours.prim != other.prim)
    for i in np.flatnonzero(differs):
        one, two = (f"primitive {found.prim[i]} at t {t_text(found.t[i])}" for found in (ours, other))
        yield Finding("culling", f"bvh: {one}; {name}: {two}", rays.taken(slice(i, i + 1)))


def check_surfaces(scene: Scene, rays: RayBatch) -> Iterator[Finding]:
    """Of every hit: finite positions and normals, geometric normals of length 1, shading normals of 1 or 0."""
    hits = cast(scene, rays.o, rays.d)
    surface = hits.surface
    length, shading = (np.sqrt((n * n).sum(axis=1)) for n in (surface.n, surface.sh_n))
    unit = np.abs(length - 1.0) <= UNIT_LENGTH_ATOL
    shaded = (np.abs(shading - 1.0) <= UNIT_LENGTH_ATOL) | (shading == 0.0)  # vertex normals may cancel
    with np.errstate(over="ignore", invalid="ignore"):
        beyond = np.isinf(hits.t * np.abs(rays.d).max(axis=1))  # a position that float64 cannot represent
    fine = (np.isfinite(surface.p).all(axis=1) | beyond) & unit & shaded
    for i in np.flatnonzero((hits.shape_id >= 0) & ~fine):
        what = f"p {surface.p[i].tolist()}, n {surface.n[i].tolist()}, sh_n {surface.sh_n[i].tolist()}"
        ray = rays.taken(slice(i, i + 1))._replace(t_min=np.zeros(1), t_max=np.full(1, np.inf))
        yield Finding("surface", f"shape {hits.shape_id[i]} is hit with {what}", ray)


def check_image(subject: PreparedScene, tally: Tally) -> list[Finding]:
    """Findings about the image of the scene's own camera: by every culling, and by exact arithmetic."""
    scene = subject.scene
    planned = culling_for(scene.camera.pack(scene.film.width, scene.film.height))[0]
    cullings: tuple[Culling, ...] = ("bvh", "raster") if planned == "raster" else ("bvh",)
    expected = render(scene, IMAGE_AOVS, culling="brute-force", threads=1)
    findings: list[Finding] = []
    for culling in cullings:
        image = render(scene, IMAGE_AOVS, culling=culling, threads=1)
        findings += _image_differences(scene, expected, image, culling)
    return findings + _adjudicate_image(subject, expected, tally)


def _image_differences(scene: Scene, expected: Aovs, other: Aovs, name: str) -> Iterator[Finding]:
    size = expected.hit.size
    for aov in IMAGE_AOVS:
        a, b = (np.ascontiguousarray(image[aov]).view(np.uint8) for image in (expected, other))
        for i in np.flatnonzero((a.reshape(size, -1) != b.reshape(size, -1)).any(axis=1)):
            slow, fast = (image[aov].reshape(size, -1)[i].tolist() for image in (expected, other))
            yield Finding("culling", f"{aov}: brute-force: {slow}; {name}: {fast}", pixel=pixel_of(scene, int(i)))


def _adjudicate_image(subject: PreparedScene, image: Aovs, tally: Tally) -> list[Finding]:
    film = camera_rays(subject.scene, threads=1)
    shape, prim = image["shape_id"].ravel(), image["prim_id"].ravel()
    t = image["depth"].ravel() / np.sqrt((film.d * film.d).sum(axis=1))
    found = NearestHits(t, np.where(shape < 0, -1, subject.packed.first[np.maximum(shape, 0)] + prim))
    pixels = [pixel_of(subject.scene, i) for i in range(len(t))]
    rays = RayBatch(film.o, film.d, film.t_min, film.t_max)
    return adjudicate(subject, rays, found, tally, pixels, DEPTH_ULPS)
