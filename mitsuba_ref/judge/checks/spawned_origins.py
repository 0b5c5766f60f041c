"""Where secondary rays start: the origins of several rules, judged in exact arithmetic (docs/method.md)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.geometry.packing import Packed
from caster.geometry.world_space import as_float32
from caster.rendering.bounces import Bounce
from caster.scene.model import Film, Scene
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.intersections import dot
from mitsuba_ref.error_model.tolerances import KU, KU_OURS, U32
from mitsuba_ref.judge.checks import NOT_JUDGED, OURS, Found, check
from mitsuba_ref.judge.checks.knife_edges import AimedFailure
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import FINDINGS, SKIPPED, Departures, Judged, OriginJudge
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.reference.shared_input import SharedRays, model_of, own_model, packed_float32

# (points, normals, directions (n, 3) float64) -> origins (n, 3)
Rule = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

PBRT_ROUNDINGS = 7  # of a point on a triangle, in units of U32: gamma(7) of its coordinates
CONSTANT_OFFSET = 1e-3  # scene units
MOST_SEARCHED = 64  # wrong rays for which a right origin is searched


def along_normal(points: np.ndarray, normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """A constant along the normal, in float32."""
    side = np.where(dot(normals, directions) < 0.0, -CONSTANT_OFFSET, CONSTANT_OFFSET)
    return as_float32(as_float32(points) + side[:, None] * normals)


def pbrt_rule(points: np.ndarray, normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """An error box of the float32 point, projected on the normal; then every coordinate moves on by one float32.

    A point does not tell the magnitude of the vertices that it was computed from: its largest coordinate stands for it.
    Source: Pharr, Jakob and Humphreys, Physically Based Rendering, 4th edition, section 6.8.6.
    """
    p, n = points.astype(np.float32), normals.astype(np.float32)
    distance = np.float32(PBRT_ROUNDINGS * U32) * np.abs(p).max(axis=1) * np.abs(n).sum(axis=1)
    step = np.where(dot(normals, directions) < 0.0, -distance, distance)[:, None].astype(np.float32) * n
    return np.where(step == 0.0, p, np.nextafter(p + step, np.copysign(np.float32(np.inf), step))).astype(np.float64)


RULES: dict[str, Rule] = {"pbrt": pbrt_rule, "constant": along_normal}


class LeavingRays(NamedTuple):
    """Rays that leave the hits of parents in a scene, packed in float32."""

    scene: Scene
    packed: Packed
    rays: Departures
    t: np.ndarray  # (n,) of the parents' hits
    normals: np.ndarray  # (n, 3) geometric, outwards

    def by(self, rule: Rule) -> "LeavingRays":
        """The rays with the origins of a rule, in float32."""
        with np.errstate(all="ignore"):
            origins = as_float32(rule(self.rays.p, self.normals, self.rays.w))
        return self.at(origins)

    def at(self, origins: np.ndarray) -> "LeavingRays":
        return self._replace(rays=self.rays._replace(q=origins))


Lines = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # o, d (n, 3), t_min, t_max (n,)


def leaving_rays(
    scene: Scene, packed: Packed, parents: Lines, hits: tuple[np.ndarray, np.ndarray], w: np.ndarray, q: np.ndarray
) -> LeavingRays:
    """Rays from q along w (n, 3) after the hits of their parents: (primitive, -1 on a miss; t), (n,) each."""
    o, d, t_min, t_max = parents
    prim, t = hits
    at = intersections_at(own_model(packed), prim, (o, d), t, KU_OURS, ours=True)
    with np.errstate(all="ignore"):
        way = at.t[:, None] * d
        p = o + way
        error = np.abs(d) * at.t_error[:, None] + KU_OURS * (np.abs(p) + np.abs(way))
    return LeavingRays(scene, packed, Departures(o, d, t_min, t_max, prim, p, error, w, q), at.t, at.n)


def rays_of_bounce(bounce: Bounce) -> LeavingRays:
    """The secondary rays with their own origins."""
    of, hits = bounce.rays.parent, bounce.parents
    o, d, t_min, t_max = (a[of] for a in hits.rays)
    nearest = hits.nearest.prim[of], hits.nearest.t[of]
    return leaving_rays(hits.scene, hits.packed, (o, d, t_min, t_max), nearest, bounce.rays.d, bounce.rays.o)


class OriginFindings(NamedTuple):
    """Findings on the origins of one rule."""

    judge: OriginJudge
    leaving: LeavingRays
    judged: Judged

    @property
    def wrong(self) -> np.ndarray:
        """Rows of the wrong origins."""
        return np.flatnonzero(self.judged.wrong)

    @property
    def avoidable(self) -> np.ndarray:
        """Rows of the wrong origins, but for those that only skip a surface closer than float32 resolves.

        A rule knows the surface that the ray leaves, so nothing excuses a self-hit or the wrong side of it.
        """
        excused = self.leaving.rays.unresolved & (self.judged.found == SKIPPED)
        return self.wrong[~excused[self.wrong]]

    def without_right_origin(self) -> int:
        """Of the first MOST_SEARCHED wrong rays, those for which no float32 point nearby is a right origin."""
        rays = (self.leaving.rays.rows(row) for row in self.wrong[:MOST_SEARCHED].tolist())
        return sum(not self.judge.right_origin_exists(ray) for ray in rays)

    def text(self) -> str:
        """Counts, such as "2512 rays: 2512 skipped surface"."""
        counts = [f"{count} {name}" for name, count in self.judged.counts().items() if count]
        return f"{len(self.leaving.rays.q)} rays: {', '.join(counts) or 'no error'}"

    def scene_of(self, row: int) -> Scene:
        """A scene of one pixel whose ray is the parent, with the shapes that the finding is about."""
        ray, scene = self.leaving.rays.rows(row), self.leaving.scene
        t_max = float(ray.t_max) if np.isfinite(ray.t_max) else None
        prims = [prim for prim in (int(ray.prim), int(self.judged.between[row])) if prim >= 0]
        shapes = np.unique(self.leaving.packed.shape_of(np.array(prims))).tolist()
        camera = Ray(origin=tuple(ray.o.tolist()), direction=tuple(ray.d.tolist()), t_max=t_max)
        chosen = {"shapes": tuple(scene.shapes[i] for i in shapes), "film": Film(width=1, height=1), "camera": camera}
        return scene.model_copy(update=chosen)

    def example(self, row: int) -> str:
        """One wrong ray in words."""
        names = [name for i, name in enumerate(FINDINGS) if self.judged.found[row] & (1 << i)]
        between, ray, packed = self.judged.between[row : row + 1], self.leaving.rays.rows(row), self.leaving.packed
        p, w, q = (", ".join(map(repr, each.tolist())) for each in (ray.p, ray.w, ray.q))
        shape, prim = (int(of(between)[0]) for of in (packed.shape_of, packed.index_in_shape))
        skipped = f" ({self.leaving.scene.shape_names()[shape]}, prim {prim})" if between[0] >= 0 else ""
        return f"{' and '.join(names)}{skipped}: at ({p}) towards ({w}), starts at ({q})"


def judge_origins(leaving: LeavingRays, judge: OriginJudge | None = None) -> OriginFindings:
    """Judge the origins of rays; `judge` may serve several rules of one scene."""
    judge = judge or OriginJudge(Oracle(leaving.packed))
    return OriginFindings(judge, leaving, judge.judge(leaving.rays))


def reference_rays(
    leaving: LeavingRays, send: SendRequest = send_stored, timeout: float = DEFAULT_TIMEOUT
) -> LeavingRays | Crash:
    """The same rays from where Mitsuba's spawn_ray puts them, of those whose parent hits the same point in Mitsuba."""
    rays, scene = leaving.rays, leaving.scene
    listed = SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(rays.o)), rays.t_min)
    parents = listed.for_reference()
    model = model_of(scene, packed_float32(scene), parents)
    found = trace_reference(scene, model, parents, lights=False, timeout=timeout, send=send, leaving=rays.w)
    if isinstance(found, Crash):
        return found
    expected = intersections_at(model, rays.prim, (rays.o, rays.d), leaving.t, KU, ours=False)
    with np.errstate(all="ignore"):
        near = np.abs(listed.t_of_reference(found.t) - expected.t) <= expected.t_error
    same = np.flatnonzero(near & found.hit & (found.shape_id == leaving.packed.shape_of(rays.prim)))
    some = rays.rows(same)._replace(q=found.answer.origin[same].astype(np.float64))
    return leaving._replace(rays=some, t=leaving.t[same], normals=leaving.normals[same])


# ---- the checks of a bounce

WhyWrong = list[AimedFailure]


@check(of=(OURS,))
def check_spawned_origins(bounce: Bounce, wrong_rays: WhyWrong) -> Found:
    """No ray starts beyond another surface, on the wrong side, or where it meets its own surface again.

    The parent of a failing ray is appended to `wrong_rays` as a scene of one ray.
    """
    found = judge_origins(rays_of_bounce(bounce))
    if not len(found.wrong):
        return 0.0, found.text()
    if not len(found.avoidable):
        return 0.0, f"{found.text()}, all where float32 cannot resolve the surfaces"
    return np.inf, f"{found.text()}; {_kept(found, int(found.avoidable[0]), 'spawned-origin', wrong_rays)}"


@check(of=(OURS,))
def check_reference_origins(bounce: Bounce, send: SendRequest, timeout: float, wrong_rays: WhyWrong) -> Found:
    """Count the errors of Mitsuba's spawn_ray at the same hits; they do not fail the scene.

    The parent of the first one is appended to `wrong_rays` as a scene of one ray.
    """
    leaving = reference_rays(rays_of_bounce(bounce), send, timeout)
    if isinstance(leaving, Crash):
        return np.inf, leaving.message
    if not len(leaving.rays.q):
        return 0.0, f"{NOT_JUDGED}: Mitsuba hits no surface that rays leave"
    found = judge_origins(leaving)
    if not len(found.wrong):
        return 0.0, found.text()
    return 0.0, f"{found.text()}; {_kept(found, int(found.wrong[0]), 'spawn-ray', wrong_rays)}"


def _kept(found: OriginFindings, row: int, label: str, wrong_rays: WhyWrong) -> str:
    """The example at a row, which is appended to `wrong_rays`."""
    wrong_rays.append(AimedFailure(found.example(row), found.scene_of(row), label))
    return wrong_rays[-1].what
