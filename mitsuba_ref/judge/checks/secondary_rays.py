"""The laws of reflection and refraction, and which secondary rays there have to be, from the judge's own normals."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from caster.rendering.bounces import RAY_KINDS, Bounce
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.intersections import cross, dot, norm, unit
from mitsuba_ref.error_model.lambert import direction_to_light
from mitsuba_ref.error_model.tolerances import KU_OURS, U32
from mitsuba_ref.judge.checks import OURS, Found, check, worst_share
from mitsuba_ref.reference.shared_input import own_model


class _Surface(NamedTuple):
    """Hits that rays leave, as the judge computes them."""

    d: np.ndarray  # (m, 3) direction of the ray, of length 1
    p: np.ndarray  # (m, 3)
    p_error: np.ndarray  # (m,)
    n: np.ndarray  # (m, 3) geometric normal, outwards
    n_error: np.ndarray  # (m,) also of cosines with n
    cosine: np.ndarray  # (m,) of d and n
    material: np.ndarray  # (m,) type
    ior: np.ndarray  # (m,) refractive index behind the surface, as float32

    def take(self, rows: np.ndarray) -> "_Surface":
        return _Surface(*(a[rows] for a in self))


@check(of=(OURS,))
def check_secondary_rays(bounce: Bounce, scene: Scene) -> Found:
    """Each ray follows the law of its kind within the rounding of float32, and none is missing or too many."""
    rows, at = _surfaces(bounce, scene)
    place = np.full(len(bounce.continues), -1)
    place[rows] = np.arange(len(rows))
    return worst_share(_shares(bounce, scene, at, place[bounce.rays.parent]), "no rays")


def _surfaces(bounce: Bounce, scene: Scene) -> tuple[np.ndarray, _Surface]:
    """(the parents that hit something and send out rays (m,), their hits)."""
    parents = bounce.parents
    rows = np.flatnonzero(parents.hit & bounce.continues)
    prim, t, line = parents.nearest.prim[rows], parents.nearest.t[rows], (parents.rays.o[rows], parents.rays.d[rows])
    at = intersections_at(own_model(parents.packed), prim, line, t, KU_OURS, ours=True)
    materials = [scene.material_of(shape) for shape in scene.shapes]
    shape = parents.packed.shape_of(prim)
    ior = np.array([getattr(material, "ior", 1.0) for material in materials]).astype(np.float32).astype(np.float64)
    d = unit(line[1])
    return rows, _Surface(
        d,
        line[0] + at.t[:, None] * line[1],
        at.p_error,
        at.n,
        at.n_error + KU_OURS,
        dot(d, at.n),
        np.array([material.type for material in materials])[shape] if len(shape) else np.zeros(0, str),
        ior[shape] if len(shape) else np.zeros(0),
    )


def _shares(bounce: Bounce, scene: Scene, at: _Surface, place: np.ndarray) -> Iterator[tuple[float, str]]:
    """Shares of bounds, with what they are about. place: (rays,) row in `at` of the hit that each ray leaves."""
    rays = bounce.rays
    yield np.inf if (place < 0).any() else 0.0, "rays that leave no surface"
    lit = at.material == "diffuse"
    eta = np.where(at.cosine < 0.0, 1.0 / at.ior, at.ior)
    squared = 1.0 - eta * eta * (1.0 - at.cosine * at.cosine)
    error = 4.0 * at.ior * at.ior * at.n_error + KU_OURS
    seen = np.abs(at.cosine) > at.n_error
    for kind, from_here, certain in (
        ("reflected", ~lit, seen & ~lit),
        (
            "refracted",
            (at.material == "glass") & (squared > -error),
            seen & (at.material == "glass") & (squared > error),
        ),
    ):
        mine = np.flatnonzero(rays.kind == RAY_KINDS.index(kind))
        leaves = place[mine]
        hit, d = at.take(leaves), rays.d[mine]
        factor = eta[leaves] if kind == "refracted" else np.ones(len(mine))
        # eta n x d = n x d' on the side that the kind goes to; d' was rounded to float32.
        off = norm(cross(hit.n, factor[:, None] * hit.d - d))
        side = np.where(kind == "refracted", 1.0, -1.0) * np.sign(hit.cosine) * dot(hit.n, d)
        bound = U32 + (1.0 + factor) * hit.n_error + 4.0 * KU_OURS
        yield _worst(off / bound, f"the law of {kind} rays")
        yield _worst(np.where(side > -bound, 0.0, np.inf), f"the side of {kind} rays")
        count = np.bincount(leaves, minlength=len(lit))
        yield _worst(np.where((count > 1) | ((count > 0) & ~from_here), np.inf, 0.0), f"{kind} rays that are none")
        grazing = np.abs(np.where(kind == "refracted", np.maximum(squared, 0.0), at.cosine**2)) <= (2.0 * U32) ** 2
        missing = certain & ~grazing & (count == 0)
        yield _worst(np.where(missing, np.inf, 0.0), f"{kind} rays that are missing")
    yield from _shadow_shares(bounce, scene, at, place, lit)


def _shadow_shares(
    bounce: Bounce, scene: Scene, at: _Surface, place: np.ndarray, lit: np.ndarray
) -> Iterator[tuple[float, str]]:
    """Shadow rays: each leads to one of the lights, which none misses that is surely in front of its surface."""
    mine = np.flatnonzero(bounce.rays.kind == RAY_KINDS.index("shadow"))
    leaves, rays = place[mine], bounce.rays.rows(mine)
    nearest = np.full(len(mine), np.inf)
    expected = np.zeros(len(lit), int)
    for light in scene.lights:
        if light.type == "ambient":
            continue
        way, reach = direction_to_light(light, rays.o)
        distance = norm(way) * reach
        off = norm(cross(unit(way), rays.d)) + np.where(dot(way, rays.d) > 0.0, 0.0, np.inf)
        same = np.isclose(rays.t_max, distance, rtol=2.0 * U32, atol=0.0)
        nearest = np.fmin(nearest, np.where(same, off, np.inf))
        to_light, _ = direction_to_light(light, at.p)
        margin = at.n_error + 2.0 * U32 + 4.0 * (at.p_error + U32 * norm(at.p)) / norm(to_light)
        expected += lit & (np.abs(at.cosine) > at.n_error) & (-np.sign(at.cosine) * dot(unit(to_light), at.n) > margin)
    yield _worst(nearest / (U32 + 8.0 * KU_OURS), "the direction of shadow rays")
    count = np.bincount(leaves, minlength=len(lit))
    yield _worst(np.where((count < expected) | ((count > 0) & ~lit), np.inf, 0.0), "shadow rays that are missing")


def _worst(shares: np.ndarray, what: str) -> tuple[float, str]:
    wrong = int((~(shares <= 1.0)).sum())
    return float(shares.max(initial=0.0)), f"{what}: {wrong} of {len(shares)}" if wrong else what
