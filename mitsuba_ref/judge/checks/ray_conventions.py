"""Conventions that a camera's rays do not show: directions of other lengths, mirrored rays, limits of t."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.scene.model import Scene
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.intersections import Array, dot, rounded, without_float_warnings
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE
from mitsuba_ref.error_model.tolerances import KU, MAJORITY, MATCH_RTOL, NEARLY_ALL
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.judge.checks import CANDIDATE, NOT_JUDGED, Found, check
from mitsuba_ref.judge.checks.knife_edges import NearestHits, cast_by_culling
from mitsuba_ref.reference.shared_input import SharedRays, endless_rays, model_of, packed_float32, shared_rays
from mitsuba_ref.subjects.subject import OURS, CastRequest, NoAnswer, Subject

LENGTHS = (1.0, 0.5, 2.0, 7.0)  # of d; two powers of two, and another number
RAYS, RAYS_TRIED = 64, 1024  # rays that hit something, in each group; rays of the film, for those
LARGEST_OFF = 0.1  # of t: if float32 resolves t no better, a factor of 2 may be rounding


@check(of=(CANDIDATE,), camera=True)
def check_ray_conventions(subject: Subject, scene: Scene, failing: bool = False) -> Found | None:
    """A candidate that takes rays: t counts in lengths of d, and any direction is traced alike.

    None if pixels fail already, or it takes no rays. A group of rays is wrong if most of its t are off by more than
    MATCH_RTOL, far more than rounding. Rays that are wrong at length 1 already, as they may be at edges, say nothing
    about conventions and are left out.
    """
    if failing or not subject.takes_rays:
        return None
    o, d = _hitting_rays(scene)
    if not len(o):
        return 0.0, f"{NOT_JUDGED}: no ray of the camera hits anything"
    groups = dict(_groups(o, d))
    o, d = (np.concatenate(each) for each in zip(*groups.values(), strict=True))
    try:
        given = _answer(subject, scene, o, d)
    except NoAnswer as error:  # or Unsupported: it has answered the rays of the film, whose lengths are near 1
        return np.inf, f"no answer to rays in other directions, |d| not 1: {error}"
    columns = given, *expected_t(scene, o, d), np.linalg.norm(d, axis=1)
    given, t, off, slope, length = (each.reshape(len(groups), -1) for each in columns)
    tells = ~np.isfinite(t) | (off <= LARGEST_OFF * t)  # mirrored, a ray may graze
    right = _match(given, t, off)
    if not tells[0].any():
        return 0.0, f"{NOT_JUDGED}: float32 resolves no t of the camera's rays"
    if not (right[0] & tells[0]).any():
        cause = _cause(given[0], t[0], off[0], length[0])
        return np.inf, f"none of {tells[0].sum()} rays that hit is right for |d| = 1: {cause}"
    tells &= right[0] & tells[0]
    wrong = np.flatnonzero(right.sum(axis=1, where=tells) < MAJORITY * tells.sum(axis=1))
    if not len(wrong):
        return 0.0, f"{len(groups) * tells[0].sum()} rays"
    missed, amiss = tells & np.isposinf(t), tells & ~right
    if (marked := marked_misses(given[missed])) and (amiss & missed).sum() >= NEARLY_ALL * amiss.sum():
        return np.inf, marked
    cause = _cause(*(each[wrong][:, tells[0]] for each in (given, t, off, length)))
    for side, words in ((1.0, "back faces are missed"), (-1.0, "front faces are missed")):
        seen = tells & np.isfinite(t) & (side * slope > 0.0)
        missed = seen & (given > (1.0 + LARGEST_OFF) * t)  # nothing is hit, or what lies behind
        if missed.sum() >= NEARLY_ALL * seen.sum() > 0 and (right | seen | ~tells).all():
            mixed = (tells & np.isfinite(t) & right)[wrong].any()  # else all rays of one direction see one side
            cause = words if mixed else f"{words}, or the sign of a component of d is lost"
    return np.inf, f"{cause}: right for |d| = 1, wrong for {', '.join(np.array([*groups])[wrong])}"


def marked_misses(t: Array) -> str:
    """A sentence about t (m,) along rays that hit nothing, if all are one number other than inf."""
    marked = len(t) > 1 and not np.isposinf(t[0]) and np.allclose(t, t[0], rtol=KU, atol=0.0, equal_nan=True)
    return f"t is {t[0]:.7g} where nothing is hit; a miss has t inf" if marked else ""


# (o, d) (m, 3) -> (the subject's t, the right t) along further rays; None: it gave no answer
CastRays = Callable[[Array, Array], tuple[Array, Array] | None]


def further_rays(subject: Subject, scene: Scene) -> CastRays | None:
    """How a diagnosis casts further rays by a candidate, rounded to float32; None if it takes none, and for ours."""

    def cast(o: Array, d: Array) -> tuple[Array, Array] | None:
        o, d = rounded(o), rounded(d)
        try:
            return _answer(subject, scene, o, d), expected_t(scene, o, d)[0]
        except NoAnswer:
            return None

    return cast if subject.takes_rays and subject is not OURS else None


def _answer(subject: Subject, scene: Scene, o: Array, d: Array) -> Array:
    """t (m,) of a candidate along rays of float32 numbers, without limits.

    A candidate that accepts only as many rays as the film has pixels gets whole films of them.
    """
    try:
        return _answer_to(subject, scene, endless_rays(o, d))
    except NoAnswer:
        x0, y0, x1, y1 = scene.film.window
        size = (x1 - x0) * (y1 - y0)
        films = (np.arange(-(-len(o) // size) * size) % len(o)).reshape(-1, size)
        t = [_answer_to(subject, scene, endless_rays(o[rows], d[rows])) for rows in films]
        return np.concatenate(t)[: len(o)]


def _answer_to(subject: Subject, scene: Scene, rays: SharedRays) -> Array:
    with ScratchFolder() as folder:
        model = model_of(scene, rays)
        return subject.answer(CastRequest(scene, model, rays, Path(folder))).t


def _cast(scene: Scene, o: Array, d: Array, t_min: float) -> NearestHits:
    return cast_by_culling(packed_float32(scene), endless(o, d)._replace(t_min=np.full(len(o), t_min)), "bvh")


def expected_t(scene: Scene, o: Array, d: Array) -> tuple[Array, Array, Array]:
    """t (m,) of our caster, the tolerance for others (MATCH_RTOL, or float32's bound if larger), and n . d."""
    found = _cast(scene, o, d, 0.0)
    model = model_of(scene, endless_rays(o, d))
    at = intersections_at(model, found.prim, o, d, found.t, REFERENCE_SIDE)
    hit = found.prim >= 0
    return found.t, np.where(hit, np.fmax(MATCH_RTOL * found.t, at.t_error), 0.0), np.where(hit, dot(at.n, d), 0.0)


# ---- limits of t, where every number is exact


class Limits(NamedTuple):
    """t_min and t_max of a ray along +z that meets surfaces at t = 2 and 4, and the expected t."""

    t_min: float
    t_max: float
    t: float
    other: float = np.nan  # also accepted: the t of a caster that treats a hit exactly at a limit as `note` says
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


@check(of=(CANDIDATE,), scope="run")
def check_ray_limits(subject: Subject) -> Found | None:
    """t_min and t_max, along rays whose hits have a t that all arithmetic is exact about.

    The result states how the candidate treats hits exactly at the limits. None if it is given no limits.
    """
    if not subject.takes_limits:
        return None
    why = ""
    t_min, t_max = (np.array([each[end] for each in LIMITS]) for end in (0, 1))
    for shapes, at in ((TRIANGLES, (0.5, 0.25, 0.0)), (SPHERE, (0.0, 0.0, 0.0))):
        scene = Scene.model_validate({"camera": Ray(**Ray.MINIMAL), "shape": shapes})
        rays = endless_rays(*(np.tile(v, (len(LIMITS), 1)) for v in (np.array(at), np.array([0.0, 0.0, 1.0]))))
        try:
            given = _answer_to(subject, scene, rays._replace(t_min=t_min, t_max=t_max.astype(np.float32)))
        except NoAnswer as error:  # such as shapes that it does not have
            why = why or str(error)
            continue
        usual, other = np.isclose(
            given[:, None], [(each.t, each.other) for each in LIMITS], rtol=MATCH_RTOL, atol=0.0
        ).T
        if not usual[0]:
            why = f"without limits it gives t = {given[0]:.9g} in place of {LIMITS[0].t:g}"
            continue
        for k in np.flatnonzero(~(usual | other)):
            what = (
                f"a hit has t_min < t <= t_max: surfaces at t = 2 and 4, t_min {t_min[k]:g}, t_max {t_max[k]:g}: "
                f"expected t = {LIMITS[k].t:g}, got {given[k]:g}; --no-limits states that the candidate's interface "
                "has none"
            )
            return np.inf, what
        notes = [LIMITS[k].note for k in np.flatnonzero(other)]
        return 0.0, f"a hit {' and '.join(notes)}" if notes else f"{len(LIMITS)} rays"
    return 0.0, f"{NOT_JUDGED}: {why}"


# ---- lengths and directions


def _hitting_rays(scene: Scene) -> tuple[Array, Array]:
    """o, d (m, 3) of at most RAYS camera rays that hit something: float32 numbers, d of length 1."""
    shared = shared_rays(scene)
    some = _evenly(np.flatnonzero(shared.t_max >= 0.0), RAYS_TRIED)
    o, d = (a[some].astype(np.float64) for a in (shared.o, shared.d))
    d = rounded(d / np.linalg.norm(d, axis=1, keepdims=True))
    t = _cast(scene, o, d, np.nextafter(0.0, -1.0)).t
    some = _evenly(np.flatnonzero(np.isfinite(t) & (t > 0.0)), RAYS)  # a hit where a ray starts may count or not
    return o[some], d[some]


def _evenly(rows: Array, most: int) -> Array:
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(int)]


def _groups(o: Array, d: Array) -> Iterator[tuple[str, tuple[Array, Array]]]:
    """(name, rays) for each length, then for mirrors in each axis about the middle of points on the rays."""
    for length in LENGTHS:
        yield f"|d| = {length:g}", (o, rounded(length * d))
    middle = (o + d * np.linalg.norm(o, axis=1, keepdims=True)).mean(axis=0)
    for axis, name in enumerate("xyz"):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield f"rays mirrored in {name}", (rounded(np.where(sign < 0.0, 2.0 * middle - o, o)), sign * d)


@without_float_warnings
def _match(given: Array, t: Array, off: Array) -> Array:
    near = np.isfinite(t) & np.isfinite(given) & (np.abs(given - t) <= off)
    return near | (np.isposinf(given) & np.isposinf(t))


def _cause(given: Array, t: Array, off: Array, length: Array) -> str:
    """The common cause of nearly all wrong groups."""
    hit = np.isfinite(t)
    for what, factor in (
        ("t is a distance, it has to count in lengths of d (divide it by |d|)", length),
        ("t is divided by |d| once too often", 1.0 / length),
    ):
        if hit.any() and _match(given, t * factor, off * factor)[hit].mean() >= NEARLY_ALL:
            return what
    if hit.any() and np.isposinf(given)[hit].mean() >= NEARLY_ALL:
        return "nothing is hit"
    return "other hits"
