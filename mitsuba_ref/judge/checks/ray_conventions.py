"""Conventions that the rays of a camera do not show: directions of other lengths, mirrored ones, limits of t."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.geometry.packing import Packed
from caster.scene.model import Scene
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.tolerances import KU, MAJORITY, MATCH_RTOL, NEARLY_ALL
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks import CANDIDATE, check
from mitsuba_ref.judge.checks.knife_edges import NearestHits, cast_by_culling
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.shared_input import SharedRays, model_of, packed_float32, shared_rays
from mitsuba_ref.subjects.subject import CastRequest, NoAnswer, Subject, Unsupported

NAME = "ray_conventions"
LENGTHS = (1.0, 0.5, 2.0, 7.0)  # of d; two powers of two, and a number that is none
RAYS = 16  # of each group, which the candidate has right
HITS_TRIED, RAYS_TRIED = 64, 1024  # that hit something, to find these; of the film, to find those
LARGEST_OFF = 0.1  # of t: of a ray whose t float32 resolves no better, a factor of 2 is not told from rounding
ONE = np.ones(1)  # length of d


@check(of=(CANDIDATE,), camera=True)
def check_ray_conventions(subject: Subject, scene: Scene, failing: bool = False) -> SceneCheck | None:
    """A candidate that takes rays: t counts in lengths of d, any direction is traced alike, hits lie within the limits.

    How it treats hits exactly at the limits is stated, and passes. None where pixels fail already, or without rays.
    """
    if failing or not subject.takes_rays:
        return None
    limits = _mistaken_limits(subject) if subject.takes_limits else ""
    if limits and not limits.startswith(AT_THE_ENDS):
        return SceneCheck(NAME, np.inf, limits)
    found = _check_directions(subject, scene)
    return replace(found, what=f"{found.what}; {limits}") if limits and found.ok else found


def _check_directions(subject: Subject, scene: Scene) -> SceneCheck:
    """Along rays of the camera, of other lengths and mirrored.

    A group of rays is wrong where most of its t are off by more than MATCH_RTOL, far more than rounding. Rays that the
    candidate has wrong as the camera casts them (at edges it may) say nothing about conventions, and are left out.
    """
    traced = Traced(scene, packed_float32(scene))
    o, d = _hitting_rays(traced)
    if not len(o):
        return SceneCheck(NAME, 0.0, "no ray of the camera hits anything")
    t, off = traced.expected(o, d)
    o, d, t, off = (each[off <= LARGEST_OFF * t] for each in (o, d, t, off))
    if not len(o):
        return SceneCheck(NAME, 0.0, "float32 resolves no t of the camera's rays")
    try:
        given = traced.by(subject, o, d)
    except Unsupported:
        return SceneCheck(NAME, 0.0, "declined")
    except NoAnswer as error:
        return SceneCheck(NAME, np.inf, f"no answer to {len(o)} rays of length 1: {error}")
    right = np.flatnonzero(_match(given, t, off))
    if not len(right):
        return SceneCheck(
            NAME, np.inf, f"none of {len(o)} rays that hit is right for |d| = 1: {_cause(given, t, off, ONE)}"
        )
    chosen = right[np.linspace(0, len(right) - 1, min(len(right), RAYS)).astype(int)]
    groups = dict(_groups(o[chosen], d[chosen]))
    o, d = (np.concatenate(each) for each in zip(*groups.values(), strict=True))
    count = len(o)
    t, off = (each.reshape(len(groups), -1) for each in traced.expected(o, d))
    try:
        given = traced.by(subject, o, d).reshape(t.shape)
    except NoAnswer as error:
        return SceneCheck(NAME, np.inf, f"no answer to rays whose |d| is not 1: {error}")
    wrong = [name for name, share in zip(groups, _match(given, t, off).mean(axis=1), strict=True) if share < MAJORITY]
    if not wrong:
        return SceneCheck(NAME, 0.0, f"{count} rays")
    rows = [i for i, name in enumerate(groups) if name in wrong]
    length = np.linalg.norm(d, axis=1).reshape(t.shape)[rows]
    return SceneCheck(NAME, np.inf, f"{_cause(given[rows], t[rows], off[rows], length)}: {_places(wrong)}")


class Traced(NamedTuple):
    """A scene, and its primitives as they are traced."""

    scene: Scene
    packed: Packed

    def by(self, subject: Subject, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """t (m,) of a candidate along rays without limits, which float32 holds.

        A candidate that takes as many rays as the film has, and no others, is given whole films of them.
        """
        try:
            return self._answer(subject, o, d)
        except Unsupported:
            raise
        except NoAnswer:
            x0, y0, x1, y1 = self.scene.film.window
            size = (x1 - x0) * (y1 - y0)
            rows = np.arange(-(-len(o) // size) * size) % len(o)
            return np.concatenate([self._answer(subject, o[some], d[some]) for some in rows.reshape(-1, size)])[
                : len(o)
            ]

    def _answer(self, subject: Subject, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        rays = _without_limits(o, d)
        with ScratchFolder() as folder:
            request = CastRequest(self.scene, model_of(self.scene, self.packed, rays), rays, Path(folder))
            return subject.answer(request).t

    def cast(self, o: np.ndarray, d: np.ndarray, t_min: float = 0.0) -> NearestHits:
        return cast_by_culling(self.packed, RayBatch(o, d, np.full(len(o), t_min), np.full(len(o), np.inf)), "bvh")

    def expected(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """t (m,) of our caster, and how far off another may be: MATCH_RTOL, or by float32 if that is more."""
        found = self.cast(o, d)
        model = model_of(self.scene, self.packed, _without_limits(o, d))
        at = intersections_at(model, found.prim, (o, d), found.t, KU, ours=False)
        return found.t, np.where(found.prim < 0, 0.0, np.fmax(MATCH_RTOL * found.t, at.t_error))


def _without_limits(o: np.ndarray, d: np.ndarray) -> SharedRays:
    return SharedRays(o.astype(np.float32), d.astype(np.float32), np.full(len(o), np.inf, np.float32), np.zeros(len(o)))


# ---- limits of t, where every number is exact


class Limits(NamedTuple):
    """t_min and t_max of a ray along +z that meets surfaces at t = 2 and 4, and the expected t."""

    t_min: float
    t_max: float
    t: float


LIMITS = (
    Limits(0.0, np.inf, 2.0),
    Limits(0.0, 3.0, 2.0),
    Limits(0.0, 2.0, 2.0),
    Limits(0.0, 1.5, np.inf),
    Limits(1.5, np.inf, 2.0),
    Limits(2.0, np.inf, 4.0),
    Limits(2.5, np.inf, 4.0),
    Limits(2.0, 4.0, 4.0),
    Limits(2.5, 3.5, np.inf),
    Limits(4.0, np.inf, np.inf),
)
# What a caster may take for t_min < t <= t_max.
AT_THE_ENDS = "a hit at "
RULES = {
    "t_min and t_max are not heeded": lambda t, low, high: t > 0.0,
    "t_max is not heeded": lambda t, low, high: low < t,
    "t_min is not heeded": lambda t, low, high: 0.0 < t <= high,
    "a hit at t_max is missed": lambda t, low, high: low < t < high,
    "a hit at t_min is taken": lambda t, low, high: max(low, 1e-9) <= t <= high,
    "a hit at t_min is taken, one at t_max is missed": lambda t, low, high: max(low, 1e-9) <= t < high,
}
TRIANGLES = [{"type": "triangle", "vertices": [(-4, -4, z), (8, -4, z), (-4, 8, z)]} for z in (2, 4)]
SPHERE = [{"type": "sphere", "center": (0.0, 0.0, 3.0), "radius": 1.0}]


def _mistaken_limits(subject: Subject) -> str:
    """What a subject makes of t_min and t_max, along rays whose hits have a t that all arithmetic is exact about.

    "" where that is right, or nothing is known: it has to hit both surfaces at all.
    """
    for shapes, at in ((TRIANGLES, (0.5, 0.25, 0.0)), (SPHERE, (0.0, 0.0, 0.0))):
        scene = Scene.model_validate({"camera": Ray(**Ray.MINIMAL), "shape": shapes})
        o, d = (np.tile(np.array(v, np.float32), (len(LIMITS), 1)) for v in (at, (0.0, 0.0, 1.0)))
        t_min, t_max, expected = (np.array(column) for column in zip(*LIMITS, strict=True))
        rays = SharedRays(o, d, t_max.astype(np.float32), np.zeros(len(o)), t_min)
        try:
            with ScratchFolder() as folder:
                given = subject.answer(
                    CastRequest(scene, model_of(scene, packed_float32(scene), rays), rays, Path(folder))
                ).t
        except Unsupported:  # such as shapes that it does not have
            continue
        except NoAnswer:
            return ""
        if given[0] != expected[0]:
            return ""  # the image shows what is wrong
        wrong = np.flatnonzero(given != expected)
        if not len(wrong):
            return ""
        names = [name for name, rule in RULES.items() if np.array_equal(given, _hits_by(rule))]
        i, cause = wrong[0], names[0] if names else "t_min and t_max are heeded otherwise"
        return (
            f"{cause}: a hit has t_min < t <= t_max: surfaces at t = 2 and 4, t_min {t_min[i]:g}, t_max {t_max[i]:g}: "
            f"expected t = {expected[i]:g}, got {given[i]:g}"
        )
    return ""


def _hits_by(rule: Callable[[float, float, float], bool]) -> np.ndarray:
    return np.array([min((t for t in (2.0, 4.0) if rule(t, low, high)), default=np.inf) for low, high, _ in LIMITS])


# ---- lengths and directions


def _hitting_rays(traced: Traced) -> tuple[np.ndarray, np.ndarray]:
    """o, d (m, 3) of length 1, as float32 holds them, of at most HITS_TRIED rays of the camera that hit something."""
    shared = shared_rays(traced.scene)
    there = np.flatnonzero(shared.t_max >= 0.0)
    some = there[np.linspace(0, len(there) - 1, min(len(there), RAYS_TRIED)).astype(int)]
    o, d = (a[some].astype(np.float64) for a in (shared.o, shared.d))
    d = _rounded(d / np.linalg.norm(d, axis=1, keepdims=True))
    t = traced.cast(o, d, np.nextafter(0.0, -1.0)).t
    hits = np.flatnonzero(np.isfinite(t) & (t > 0.0))  # whether a ray hits a surface that it starts on is open
    some = hits[np.linspace(0, len(hits) - 1, min(len(hits), HITS_TRIED)).astype(int)]
    return o[some], d[some]


def _rounded(v: np.ndarray) -> np.ndarray:
    return v.astype(np.float32).astype(np.float64)


def _groups(o: np.ndarray, d: np.ndarray) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Name, and rays: of each length, then mirrored in each axis, about the middle of points on the rays."""
    for length in LENGTHS:
        yield f"|d| = {length:g}", (o, _rounded(length * d))
    middle = (o + d * np.linalg.norm(o, axis=1, keepdims=True)).mean(axis=0)
    for axis, name in enumerate("xyz"):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield f"mirrored in {name}", (_rounded(np.where(sign < 0.0, 2.0 * middle - o, o)), sign * d)


def _match(given: np.ndarray, t: np.ndarray, off: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        near = np.isfinite(t) & (np.abs(given - t) <= off)
    return near | (np.isposinf(given) & np.isposinf(t))


def _cause(given: np.ndarray, t: np.ndarray, off: np.ndarray, length: np.ndarray) -> str:
    """What nearly all of the wrong groups have in common."""
    hit = np.isfinite(t)
    for what, factor in (
        ("t is a distance, it has to count in lengths of d (divide it by |d|)", length),
        ("t is divided by |d| once too often", 1.0 / length),
        ("t is divided by |d|^2, it has to count in lengths of d", length**-2.0),
    ):
        if hit.any() and _match(given, t * factor, off * factor)[hit].mean() >= NEARLY_ALL:
            return what
    if hit.any() and np.isposinf(given)[hit].mean() >= NEARLY_ALL:
        return "nothing is hit"
    return "other hits"


def _places(wrong: list[str]) -> str:
    lengths = [name.removeprefix("|d| = ") for name in wrong if name.startswith("|d|")]
    mirrored = [name.removeprefix("mirrored in ") for name in wrong if name.startswith("mirrored")]
    words = [f"for |d| = {', '.join(lengths)}"] if lengths else []
    words += [f"for the same rays mirrored in {', '.join(mirrored)}"] if mirrored else []
    return f"right for |d| = 1, wrong {' and '.join(words)}"
