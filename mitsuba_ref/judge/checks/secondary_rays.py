"""Checks of secondary rays: the laws of reflection and refraction, which rays there have to be, and where they start.

The laws are judged by the judge's own normals, the origins of several rules in exact arithmetic (docs/method.md).
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.geometry.world_space import as_float32
from caster.rendering.bounces import RAY_KINDS, Bounce
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.intersections import Array, Rays, cross, dot, norm, rounded, unit
from mitsuba_ref.error_model.lambert import direction_to_light
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE
from mitsuba_ref.error_model.tolerances import KU_OURS, U32
from mitsuba_ref.judge.adjudication import named_prims
from mitsuba_ref.judge.checks import NOT_JUDGED, OURS, Found, check
from mitsuba_ref.judge.checks.knife_edges import AimedFailure, scene_of_ray
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import FINDINGS, SKIPPED, WRONG, Departures, OriginJudge
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.reference.shared_input import SharedRays, model_of, own_model
from mitsuba_ref.subjects.subject import NoAnswer

# ---- the laws

# A ray may be left out whose cosine with the normal is within two roundings, of the direction before it and of its own,
# and within the error of a normal that is known to half of float64's bits.
LEFT_OUT = 4.0 * U32


@check(of=(OURS,))
def check_secondary_rays(bounce: Bounce, scene: Scene) -> Iterator[Found]:
    """Each ray follows the law of its kind within the rounding of float32, and none is missing or too many."""
    rays, parents = bounce.rays, bounce.parents
    kinds, prim = np.array(RAY_KINDS)[rays.kind], np.where(bounce.continues, parents.nearest.prim, -1)
    hit, t = prim >= 0, parents.nearest.t
    at = intersections_at(own_model(parents.packed), prim, *parents.rays[:2], t, OUR_SIDE)
    materials = [scene.material_of(shape) for shape in scene.shapes]
    material = np.array([*(each.type for each in materials), ""])[np.where(hit, parents.shape_id, -1)]
    ior = rounded(np.array([*(getattr(each, "ior", 1.0) for each in materials), 1.0]))[parents.shape_id]
    d, n, n_error = unit(parents.rays.d), np.where(hit[:, None], at.n, 0.0), np.where(hit, at.n_error, 0.0) + KU_OURS
    cosine = dot(d, n)
    seen = np.abs(cosine) > n_error + LEFT_OUT
    eta = np.where(cosine < 0.0, 1.0 / ior, ior)
    squared = 1.0 - eta * eta * (1.0 - cosine * cosine)
    error = 4.0 * ior * ior * n_error + KU_OURS
    passes = np.sqrt(np.maximum(squared - error - 4.0 * ior * ior * LEFT_OUT, 0.0)) > n_error + LEFT_OUT

    def counted(kind: str, may: Array, must: Array) -> Found:
        count = np.bincount(rays.parent[kinds == kind], minlength=len(hit))
        return _worst(np.where((count > may) | (count < must), np.inf, 0.0), f"hits with missing or extra {kind} rays")

    shiny, glass = np.isin(material, ("mirror", "glass")), material == "glass"
    for kind, side, index, may, must in (
        ("reflected", -1.0, np.ones(len(hit)), shiny, shiny & seen),
        ("refracted", 1.0, eta, glass & (squared > -error), glass & seen & passes),
    ):
        yield counted(kind, may, must)
        mine = kinds == kind
        of, leaving = rays.parent[mine], rays.d[mine]
        # The law: index n x d = n x d', where d' has been rounded to float32, on the side that the kind goes to.
        off = norm(cross(n[of], index[of, None] * d[of] - leaving))
        away = side * np.sign(cosine[of]) * dot(n[of], leaving)
        bound = U32 + (1.0 + index[of]) * n_error[of] + 4.0 * KU_OURS
        yield _worst(np.where(away > -bound, off / bound, np.inf), f"the law of {kind} rays")

    lights, mine = [light for light in scene.lights if light.type != "ambient"], kinds == "shadow"
    nearest, lit = np.full(int(mine.sum()), np.inf), np.zeros(len(hit), int)
    for light in lights:
        way, reach = direction_to_light(light, rays.o[mine])
        off = norm(cross(unit(way), rays.d[mine])) / (U32 + 8.0 * KU_OURS)
        ends = np.isclose(rays.t_max[mine], norm(way) * reach, rtol=2.0 * U32, atol=0.0)
        nearest = np.fmin(nearest, np.where(ends & (dot(way, rays.d[mine]) > 0.0), off, np.inf))
        p = parents.rays.o + np.where(hit, at.t, 0.0)[:, None] * parents.rays.d
        way = direction_to_light(light, p)[0]
        margin = n_error + LEFT_OUT + 4.0 * (np.where(hit, at.p_error, 0.0) + U32 * norm(p)) / norm(way)
        lit += seen & (-np.sign(cosine) * dot(unit(way), n) > margin)
    diffuse = material == "diffuse"
    yield counted("shadow", diffuse * len(lights), diffuse * lit)
    yield _worst(nearest, "the way of shadow rays to a light")


def _worst(shares: Array, what: str) -> Found:
    wrong = int((~(shares <= 1.0)).sum())
    return float(shares.max(initial=0.0)), f"{what}: {wrong} of {len(shares)}" if wrong else what


# ---- origins

# (points, normals, directions (n, 3) float64) -> origins (n, 3)
Rule = Callable[[Array, Array, Array], Array]

PBRT_ROUNDINGS = 7  # of a point on a triangle, in units of U32: gamma(7) of its coordinates
CONSTANT_OFFSET = 1e-3  # scene units


def along_normal(points: Array, normals: Array, directions: Array) -> Array:
    """A constant along the normal, in float32."""
    side = np.where(dot(normals, directions) < 0.0, -CONSTANT_OFFSET, CONSTANT_OFFSET)
    return as_float32(as_float32(points) + side[:, None] * normals)


def pbrt_rule(points: Array, normals: Array, directions: Array) -> Array:
    """An error box of the float32 point, projected on the normal; then every coordinate moves on by one float32.

    A point does not tell the magnitude of the vertices that it was computed from: its largest coordinate stands for it.
    Source: Pharr, Jakob and Humphreys, Physically Based Rendering, 4th edition, section 6.8.6.
    """
    p, n = points.astype(np.float32), normals.astype(np.float32)
    distance = np.float32(PBRT_ROUNDINGS * U32) * np.abs(p).max(axis=1) * np.abs(n).sum(axis=1)
    step = np.where(dot(normals, directions) < 0.0, -distance, distance)[:, None].astype(np.float32) * n
    return np.where(step == 0.0, p, np.nextafter(p + step, np.copysign(np.float32(np.inf), step))).astype(np.float64)


RULES: dict[str, Rule] = {"pbrt": pbrt_rule, "constant": along_normal}
MITSUBA = "mitsuba"  # names its spawn_ray where a rule may be given


class LeavingRays(NamedTuple):
    """Rays that leave the hits of parents in a scene, packed in float32."""

    scene: Scene
    packed: Packed
    rays: Departures


def leaving_rays(scene: Scene, packed: Packed, parents: Rays, prim: Array, t: Array, w: Array, q: Array) -> LeavingRays:
    """Rays from q along w (n, 3) after the hits of their parents: primitive, -1 on a miss, and t, (n,) each."""
    o, d = parents.o, parents.d
    at = intersections_at(own_model(packed), prim, o, d, t, OUR_SIDE)
    with np.errstate(all="ignore"):
        way = at.t[:, None] * d
        p = o + way
        error = np.abs(d) * at.t_error[:, None] + KU_OURS * (np.abs(p) + np.abs(way))
    return LeavingRays(scene, packed, Departures(*parents, prim, at.t, at.n, p, error, w, q))


def rays_of_bounce(bounce: Bounce) -> LeavingRays:
    """The secondary rays with their own origins."""
    of, hits = bounce.rays.parent, bounce.parents
    parents, nearest = Rays(*hits.rays).take(of), hits.nearest
    return leaving_rays(hits.scene, hits.packed, parents, nearest.prim[of], nearest.t[of], bounce.rays.d, bounce.rays.o)


class OriginFindings(NamedTuple):
    """Findings on the origins of one rule."""

    leaving: LeavingRays
    found: Array  # (n,) uint8, a sum of SELF_HIT, SKIPPED, WRONG_SIDE, UNDECIDED
    between: Array  # (n,) int64, number of a skipped primitive, -1

    @property
    def wrong(self) -> Array:
        """Rows of the wrong origins."""
        return np.flatnonzero(self.found & WRONG)

    @property
    def avoidable(self) -> Array:
        """Rows of the wrong origins, but for those that only skip a surface closer than float32 resolves.

        A rule knows the surface that the ray leaves, so nothing excuses a self-hit or the wrong side of it.
        """
        excused = self.leaving.rays.unresolved & (self.found == SKIPPED)
        return self.wrong[~excused[self.wrong]]

    def counts(self) -> dict[str, int]:
        """All rays, and those of each finding."""
        of = {name: int(np.sum(self.found & (1 << i) != 0)) for i, name in enumerate(FINDINGS)}
        return {"rays": len(self.found), **of}

    def text(self) -> str:
        """Counts, such as "2512 rays: 2512 skipped surface"."""
        rays, *counts = (f"{count} {name}" for name, count in self.counts().items() if count or name == "rays")
        return f"{rays}: {', '.join(counts) or 'no error'}"

    def scene_of(self, row: int) -> Scene:
        """A scene of one pixel whose ray is the parent, with the shapes that the finding is about."""
        ray, scene = self.leaving.rays.rows(row), self.leaving.scene
        prims = [prim for prim in (int(ray.prim), int(self.between[row])) if prim >= 0]
        shapes = np.unique(self.leaving.packed.shape_of(np.array(prims))).tolist()
        return scene_of_ray(scene, ray.o, ray.d, float(ray.t_max), shapes=tuple(scene.shapes[i] for i in shapes))

    def example(self, row: int) -> str:
        """One wrong ray in words."""
        names = [name for i, name in enumerate(FINDINGS) if self.found[row] & (1 << i)]
        between, ray = self.between[row : row + 1], self.leaving.rays.rows(row)
        p, w, q = (", ".join(map(repr, each.tolist())) for each in (ray.p, ray.w, ray.q))
        ((shape, prim),) = named_prims(self.leaving.scene, self.leaving.packed, between)
        skipped = f" ({shape}, prim {prim})" if between[0] >= 0 else ""
        return f"{' and '.join(names)}{skipped}: at ({p}) towards ({w}), starts at ({q})"


def judge_origins(leaving: LeavingRays, judge: OriginJudge | None = None) -> OriginFindings:
    """Judge the origins of rays; `judge` may serve several rules of one scene."""
    judge = judge or OriginJudge(Oracle(leaving.packed))
    return OriginFindings(leaving, *judge.judge(leaving.rays))


def by_rule(leaving: LeavingRays, rule: Rule | str | None, send: SendRequest) -> LeavingRays:
    """The rays from where a rule, or one of RULES and MITSUBA, lets them start; None: as they are. Raises NoAnswer."""
    if rule is None:
        return leaving
    if rule == MITSUBA:
        return reference_rays(leaving, send)
    place = RULES[rule] if isinstance(rule, str) else rule
    rays = leaving.rays
    with np.errstate(all="ignore"):
        return leaving._replace(rays=rays._replace(q=as_float32(place(rays.p, rays.n, rays.w))))


def reference_rays(leaving: LeavingRays, send: SendRequest, timeout: float = DEFAULT_TIMEOUT) -> LeavingRays:
    """The same rays from where Mitsuba's spawn_ray puts them, of those whose parent hits the same point in Mitsuba.

    Raises NoAnswer.
    """
    rays, scene = leaving.rays, leaving.scene
    listed = SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(rays.o)), rays.t_min)
    parents = listed.for_reference()
    model = model_of(scene, parents)
    found = trace_reference(scene, model, parents, lights=False, timeout=timeout, send=send, leaving=rays.w)
    if isinstance(found, Crash):
        raise NoAnswer(found.message)
    expected = intersections_at(model, rays.prim, rays.o, rays.d, rays.t, REFERENCE_SIDE)
    with np.errstate(all="ignore"):
        near = np.abs(listed.t_of_reference(found.t) - expected.t) <= expected.t_error
    same = np.flatnonzero(near & found.hit & (found.shape_id == leaving.packed.shape_of(rays.prim)))
    return leaving._replace(rays=rays.rows(same)._replace(q=found.answer.origin[same].astype(np.float64)))


# ---- the checks of origins


@check(of=(OURS,))
def check_spawned_origins(bounce: Bounce, wrong_rays: list[AimedFailure]) -> Found:
    """No ray starts beyond another surface, on the wrong side, or where it meets its own surface again.

    The parent of a failing ray is appended to `wrong_rays` as a scene of one ray.
    """
    found = judge_origins(rays_of_bounce(bounce))
    if len(found.avoidable):
        return np.inf, _kept(found, found.avoidable, "spawned-origin", wrong_rays)
    excuse = ", all where float32 cannot resolve the surfaces" if len(found.wrong) else ""
    return 0.0, f"{found.text()}{excuse}"


@check(of=(OURS,))
def check_reference_origins(bounce: Bounce, send: SendRequest, timeout: float, wrong_rays: list[AimedFailure]) -> Found:
    """Count the errors of Mitsuba's spawn_ray at the same hits; they do not fail the scene.

    The parent of the first one is appended to `wrong_rays` as a scene of one ray.
    """
    try:
        leaving = reference_rays(rays_of_bounce(bounce), send, timeout)
    except NoAnswer as error:
        return np.inf, str(error)
    if not len(leaving.rays.q):
        return 0.0, f"{NOT_JUDGED}: Mitsuba hits no surface that rays leave"
    found = judge_origins(leaving)
    return 0.0, _kept(found, found.wrong, "spawn-ray", wrong_rays)


def _kept(found: OriginFindings, rows: Array, label: str, wrong_rays: list[AimedFailure]) -> str:
    """The counts with an example, the first of the rows, if any, which is appended to `wrong_rays`."""
    if not len(rows):
        return found.text()
    example = found.example(rows[0])
    wrong_rays.append(AimedFailure(example, found.scene_of(rows[0]), label))
    return f"{found.text()}; {example}"
