"""Checks of one scene: ours along rays and in its image, against itself and the oracle; any subject by the judge."""

import traceback
from collections.abc import Callable, Iterator
from math import isinf
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from caster import cast
from caster.description.errors import SceneError
from caster.geometry.packing import Packed, packed
from caster.rendering.images import camera_rays
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import UNIT_LENGTH_ATOL
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.fuzz.cases import Case, ray_of, scene_data
from mitsuba_ref.fuzz.findings import JUDGED_KINDS, Finding, Tally
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.random_parts import random_shape
from mitsuba_ref.hard.rays import Frame, endless
from mitsuba_ref.hard.swept_families import NO_VIEW
from mitsuba_ref.judge import checks as registry
from mitsuba_ref.judge.checks import knife_edges
from mitsuba_ref.judge.checks.knife_edges import (
    NearestHits,
    cast_by_culling,
    concatenated,
    nearest_hits,
    t_text,
    with_limits,
)
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import UNDECIDED, WRONG, Failure, SceneVerdict
from mitsuba_ref.oracle.oracle import Oracle, OutsideDomain
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import SharedRays, packed_float32
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.shapes.targets import Rng
from mitsuba_ref.subjects.ray_files import checked_rays, lay_out
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import OURS, NoAnswer, Subject, Unsupported

SCENE_ERRORS = (SceneError, ValidationError, OutsideDomain)  # raised by scenes that cannot be checked
MITSUBA_TIMEOUT_S = 60.0  # seconds; a scene of a few dozen pixels takes a hundredth of one


def find(
    case: Case,
    kind: str = "",
    tally: Tally | None = None,
    subject: Subject = OURS,
    aim: Callable[[Packed], Rays] | None = None,
) -> list[Finding]:
    """Findings about a case; none where it is no valid scene.

    kind: of the finding it was made for. aim: rays that are judged in place of the camera's.
    """
    tally = tally or Tally()
    try:
        scene = scene_of(scene_data(case))
        if kind in JUDGED_KINDS or subject is not OURS:
            return compare_with_mitsuba(scene, tally, subject, aim and aim(packed_float32(scene)))
        oracle, ray = Oracle(packed(scene)), ray_of(case)
        if ray:
            return check_rays(scene, oracle, ray, tally)
        return check_image(scene, oracle, tally, kind in ("", "check"))
    except SCENE_ERRORS:
        return []
    except Exception as error:
        return [exception_finding(error)]


def exception_finding(error: Exception) -> Finding:
    """The finding that an exception was raised."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return Finding("error", f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}")


# ---- ours, without Mitsuba


def check_rays(scene: Scene, oracle: Oracle, rays: Rays, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """Findings about these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        rays = concatenated(rays, with_limits(rng, rays, cast_by_culling(oracle.packed, rays, "bvh")))
    hits = cast(scene, rays.o, rays.d, t_min=rays.t_min, t_max=rays.t_max)
    ours = nearest_hits(oracle.packed, hits.t, hits.shape_id, hits.prim_id)
    slow, findings = cast_by_culling(oracle.packed, rays, "brute-force"), list[Finding]()
    for i in np.flatnonzero(registry.bits_differ(ours.t, slow.t) | (ours.prim != slow.prim)).tolist():
        one, two = (f"primitive {found.prim[i]} at t {t_text(found.t[i])}" for found in (ours, slow))
        findings.append(Finding("culling", f"caster.cast: {one}; brute-force: {two}", rays.take([i])))
    return [*findings, *check_surfaces(hits, rays), *adjudicate(oracle, rays, ours, tally)]


def check_surfaces(hits: Any, rays: Rays) -> Iterator[Finding]:
    """Findings about hits: positions and normals are finite, geometric normals of length 1, shading ones of 1 or 0."""
    p, n, sh_n, _ = hits.surfaces.values()
    length, shading = (np.sqrt((v * v).sum(axis=1)) for v in (n, sh_n))
    unit = np.abs(length - 1.0) <= UNIT_LENGTH_ATOL
    shaded = (np.abs(shading - 1.0) <= UNIT_LENGTH_ATOL) | (shading == 0.0)  # vertex normals may cancel
    with np.errstate(over="ignore", invalid="ignore"):
        beyond = np.isinf(hits.t * np.abs(rays.d).max(axis=1))  # a position that float64 cannot represent
    fine = (np.isfinite(p).all(axis=1) | beyond) & unit & shaded
    for i in np.flatnonzero((hits.shape_id >= 0) & ~fine).tolist():
        what = f"p {p[i].tolist()}, n {n[i].tolist()}, sh_n {sh_n[i].tolist()}"
        yield Finding("surface", f"shape {hits.shape_id[i]} is hit with {what}", rays.take([i]))


def adjudicate(oracle: Oracle, rays: Rays, found: NearestHits, tally: Tally) -> list[Finding]:
    """Findings about hits, against the exact answers."""
    try:
        verdicts = knife_edges.adjudicate(oracle, rays, found)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    hits = [each.answer for each in verdicts if each.answer.hit]
    tally.rays += len(verdicts)
    tally.hits += len(hits)
    tally.edges += sum(answer.where != "inside" for answer in hits)
    tally.ties += sum(len(answer.ties) > 1 for answer in hits)
    tally.unbounded += sum(isinf(each.bound) for each in verdicts)
    return [Finding(each.kind, each.text, rays.take([i])) for i, each in enumerate(verdicts) if each.kind]


def check_image(scene: Scene, oracle: Oracle, tally: Tally, thorough: bool = True) -> list[Finding]:
    """Findings about the scene's image, by `render` and the thorough checks, and about its camera's rays.

    thorough: whether to make those as well; without the compiler they take ten times as long as all else.
    """
    checks = registry.checks_of(registry.OURS, thorough=thorough)
    chosen = [each for each in checks if each.thorough or each.name == "render"]
    failing = [each for each in registry.make_checks(chosen, {"scene": scene}) if not each.ok]
    film = camera_rays(scene, threads=1)
    rays = Rays(*film.take(film.t_max > 0.0))
    return [
        *(Finding("check", f"{each.name}: {each.what}", detail=each.name) for each in failing),
        *check_rays(scene, oracle, rays, tally),
    ]


# ---- any subject, with Mitsuba


def compare_with_mitsuba(
    scene: Scene, tally: Tally, subject: Subject = OURS, rays: Rays | None = None
) -> list[Finding]:
    """Findings of the judge about a scene. Vacuous scenes pass: images of a few pixels may hit nothing.

    rays: in place of the camera's. Of a candidate, only wrong pixels are findings.
    """
    shared = None
    try:
        if rays is not None:
            with np.errstate(over="ignore"):
                numbers = np.column_stack(rays).astype(np.float32)
            scene, shared = lay_out(scene, checked_rays(numbers, "rays"))
        verdict = validate_scene(
            Task(scene, "fuzz", subject=subject, rays=shared, timeout=MITSUBA_TIMEOUT_S, send=send_request)
        )
    except SCENE_ERRORS:  # numbers beyond float32
        tally.outside += 1
        return []
    if verdict.unsupported:
        tally.declined += 1
        return []
    tally.judged += 1
    tally.pixels += verdict.pixels
    if verdict.problem:
        return [Finding("crash" if subject is OURS else "answer", verdict.problem)]
    if subject is not OURS and not (verdict.counts[WRONG] or verdict.counts[UNDECIDED]):
        return []
    failing = [each for each in verdict.checks if subject is OURS and not each.ok]
    return [
        *(
            Finding("judged", f"{each.name}: {each.ratio:.3g} times its bound; {each.what}", detail=each.name)
            for each in failing
        ),
        *(_finding_of(each, verdict, scene, shared) for each in verdict.failures),
    ]


def _finding_of(failure: Failure, verdict: SceneVerdict, scene: Scene, rays: SharedRays | None) -> Finding:
    ray = None
    if rays is not None:
        at = [failure.y * scene.film.width + failure.x]
        ray = endless(rays.o[at], rays.d[at])
    lines = (
        f"{failure.reason}; {failure.check} {failure.ratio:.3g} times its bound",
        f"{'candidate:' if verdict.candidate else 'ours:':<10} {failure.subject}",
        f"reference: {failure.reference}",
        f"exact:     {failure.exact}",
    )
    return Finding("judged", "\n      ".join(lines), ray, detail=failure_mode(failure))


OF_PLACE = ("mask", "depth", "position", "on_surface", "shape_id", "uv", "exact")  # which of them is off most varies


def failure_mode(failure: Failure) -> str:
    """The kind of a pixel's failure, which shrinking must preserve."""
    if failure.subject.startswith("miss"):
        return "missed"
    if failure.exact.startswith("miss"):
        return "phantom"
    return "place" if failure.check in OF_PLACE else failure.check


# ---- shapes that a candidate takes


def answers(subject: Subject, shape_type: str) -> bool:
    """Whether a subject does not decline this type of shape."""
    shape = random_shape(np.random.default_rng(0), Frame(), [shape_type])
    try:
        request_answer(subject, scene_of({**NO_VIEW, "shape": [shape]}))
    except NoAnswer as error:  # any other than that it declines is a finding
        return not isinstance(error, Unsupported)
    return True
