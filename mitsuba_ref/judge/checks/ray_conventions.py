"""Conventions that a camera's rays do not show: directions of other lengths, mirrored rays, limits of t."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.scene.model import Scene
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.tolerances import MAJORITY, MATCH_RTOL, NEARLY_ALL
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks import CANDIDATE, check
from mitsuba_ref.judge.checks.knife_edges import cast_by_culling
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.shared_input import SharedRays, model_of, packed_float32, shared_rays
from mitsuba_ref.subjects.subject import CastRequest, NoAnswer, Subject, Unsupported

NAME = "ray_conventions"
LENGTHS = (1.0, 0.5, 2.0, 7.0)  # of d; two powers of two, and another number
RAYS, RAYS_TRIED = 16, 1024  # rays in each group, which hit something; rays of the film among which they are found


@check(of=(CANDIDATE,), camera=True)
def check_ray_conventions(subject: Subject, scene: Scene, failing: bool = False) -> SceneCheck | None:
    """A candidate that takes rays: t counts in lengths of d, any direction is traced alike, hits lie within the limits.

    The result states how it treats hits exactly at the limits. None if pixels fail already, or it takes no rays.
    """
    if failing or not subject.takes_rays:
        return None
    limits = _check_limits(subject) if subject.takes_limits else SceneCheck(NAME, 0.0, "")
    found = _check_directions(subject, scene) if limits.ok else limits
    return replace(found, what=f"{found.what}; {limits.what}") if limits.ok and limits.what and found.ok else found


def _check_directions(subject: Subject, scene: Scene) -> SceneCheck:
    """Rays of the camera, of other lengths and mirrored.

    A group of rays is wrong if most of its t are off by more than MATCH_RTOL, far more than rounding; a few may be,
    at edges. If the rays of length 1 are not nearly all right, the image shows it, and the others are not judged.
    """
    packed = packed_float32(scene)
    o, d = _hitting_rays(scene)
    if not len(o):
        return SceneCheck(NAME, 0.0, "no ray of the camera hits anything")
    groups = dict(_groups(o, d))
    rays = [np.concatenate(each).astype(np.float32) for each in zip(*groups.values(), strict=True)]
    count = len(rays[0])
    lines = rays[0].astype(np.float64), rays[1].astype(np.float64)
    batch = RayBatch(*lines, np.zeros(count), np.full(count, np.inf))
    t = cast_by_culling(packed, batch, "bvh").t.reshape(len(groups), -1)
    shared = SharedRays(rays[0], rays[1], np.full(count, np.inf, np.float32), np.zeros(count))
    try:
        with ScratchFolder() as folder:
            request = CastRequest(scene, model_of(scene, packed, shared), shared, Path(folder))
            try:
                given = subject.answer(request).t.reshape(t.shape)
            except NoAnswer as error:
                subject.answer(request.with_rays(shared.rows(slice(len(o)))))
                return SceneCheck(NAME, np.inf, f"no answer to rays whose |d| is not 1: {error}")
    except Unsupported:
        return SceneCheck(NAME, 0.0, "declined")
    except NoAnswer as error:
        return SceneCheck(NAME, 0.0, f"not judged: no answer to {len(o)} rays: {error}")
    right = _match(given, t).mean(axis=1)
    wrong = [name for name, share in zip(groups, right, strict=True) if share < MAJORITY]
    first = next(iter(groups))
    if right[0] < NEARLY_ALL:
        return SceneCheck(NAME, 0.0, f"not judged: rays of {first} are wrong already")
    if not wrong:
        return SceneCheck(NAME, 0.0, f"{count} rays")
    rows = [i for i, name in enumerate(groups) if name in wrong]
    length = np.linalg.norm(batch.d, axis=1).reshape(t.shape)[rows]
    cause = _cause(given[rows], t[rows], length)
    return SceneCheck(NAME, np.inf, f"{cause}: right for {first}, wrong for {', '.join(wrong)}")


# ---- limits of t, where every number is exact


class Limits(NamedTuple):
    """t_min and t_max of a ray along +z that meets surfaces at t = 2 and 4, and the expected t."""

    t_min: float
    t_max: float
    t: float
    other: float = np.nan  # accepted as well, of a caster for which a hit exactly at a limit
    note: str = ""


LIMITS = (
    Limits(0.0, np.inf, 2.0),
    Limits(0.0, 3.0, 2.0),
    Limits(0.0, 1.5, np.inf),
    Limits(1.5, np.inf, 2.0),
    Limits(2.5, np.inf, 4.0),
    Limits(2.5, 3.5, np.inf),
    Limits(0.0, 2.0, 2.0, np.inf, "is missed at t_max"),
    Limits(2.0, np.inf, 4.0, 2.0, "is taken at t_min"),
)
TRIANGLES = [{"type": "triangle", "vertices": [(-4, -4, z), (8, -4, z), (-4, 8, z)]} for z in (2, 4)]
SPHERE = [{"type": "sphere", "center": (0.0, 0.0, 3.0), "radius": 1.0}]


def _check_limits(subject: Subject) -> SceneCheck:
    """t_min and t_max along rays whose hits have a t that all arithmetic is exact about.

    A subject that does not hit both surfaces without limits passes: the image shows what is wrong.
    """
    for shapes, at in ((TRIANGLES, (0.5, 0.25, 0.0)), (SPHERE, (0.0, 0.0, 0.0))):
        scene = Scene.model_validate({"camera": Ray(**Ray.MINIMAL), "shape": shapes})
        o, d = (np.tile(np.array(v, np.float32), (len(LIMITS), 1)) for v in (at, (0.0, 0.0, 1.0)))
        t_min, t_max = (np.array([each[end] for each in LIMITS]) for end in (0, 1))
        rays = SharedRays(o, d, t_max.astype(np.float32), np.zeros(len(o)), t_min)
        try:
            with ScratchFolder() as folder:
                request = CastRequest(scene, model_of(scene, packed_float32(scene), rays), rays, Path(folder))
                given = subject.answer(request).t.tolist()
        except Unsupported:  # such as shapes that it does not have
            continue
        except NoAnswer:
            break
        if given[0] != LIMITS[0].t:
            break
        for each, t in zip(LIMITS, given, strict=True):
            if t not in (each.t, each.other):
                what = (
                    f"a hit has t_min < t <= t_max: surfaces at t = 2 and 4, t_min {each.t_min:g}, "
                    f"t_max {each.t_max:g}: expected t = {each.t:g}, got {t:g}"
                )
                return SceneCheck(NAME, np.inf, what)
        notes = [each.note for each, t in zip(LIMITS, given, strict=True) if t == each.other]
        return SceneCheck(NAME, 0.0, f"a hit {' and '.join(notes)}" if notes else "")
    return SceneCheck(NAME, 0.0, "")


# ---- lengths and directions


def _hitting_rays(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """o, d (m, 3) of at most RAYS rays of the camera that hit something."""
    shared = shared_rays(scene)
    there = np.flatnonzero(shared.t_max >= 0.0)
    some = there[np.linspace(0, len(there) - 1, min(len(there), RAYS_TRIED)).astype(int)]
    o, d, t_max = (a[some].astype(np.float64) for a in (shared.o, shared.d, shared.t_max))
    t = cast_by_culling(packed_float32(scene), RayBatch(o, d, np.zeros(len(o)), t_max), "bvh").t
    hits = np.flatnonzero(np.isfinite(t))
    chosen = hits[np.linspace(0, len(hits) - 1, min(len(hits), RAYS)).astype(int)]
    return o[chosen], d[chosen]


def _groups(o: np.ndarray, d: np.ndarray) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """(name, rays) for each length, then for mirrors in each axis about the middle of points on the rays."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    for length in LENGTHS:
        yield f"|d| = {length:g}", (o, length * d)
    middle = (o + d * np.linalg.norm(o, axis=1, keepdims=True)).mean(axis=0)
    for axis, name in enumerate("xyz"):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield f"rays mirrored in {name}", (np.where(sign < 0.0, 2.0 * middle - o, o), sign * d)


def _match(given: np.ndarray, t: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        near = np.isfinite(t) & (np.abs(given - t) <= MATCH_RTOL * np.abs(t))
    return near | (np.isposinf(given) & np.isposinf(t))


def _cause(given: np.ndarray, t: np.ndarray, length: np.ndarray) -> str:
    """The common cause of nearly all wrong groups."""
    hit = np.isfinite(t)
    for what, predicted in (
        ("t is a distance, it has to count in lengths of d (divide it by |d|)", t * length),
        ("t is divided by |d| once too often", t / length),
    ):
        if hit.any() and _match(given, predicted)[hit].mean() >= NEARLY_ALL:
            return what
    return "other hits"
