"""The laws of reflection and refraction, and which secondary rays there have to be, from the judge's own normals."""

from collections.abc import Iterator

import numpy as np

from caster.rendering.bounces import RAY_KINDS, Bounce
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.intersections import Array, Intersections, cross, dot, norm, unit
from mitsuba_ref.error_model.lambert import direction_to_light
from mitsuba_ref.error_model.tolerances import KU_OURS, U32
from mitsuba_ref.judge.checks import OURS, Found, check, worst_share
from mitsuba_ref.reference.shared_input import own_model

# A ray may be left out whose cosine with the normal is within two roundings, of the direction before it and of its own,
# and within the error of a normal that is known to half of float64's bits.
LEFT_OUT = 4.0 * U32


@check(of=(OURS,))
def check_secondary_rays(bounce: Bounce, scene: Scene) -> Found:
    """Each ray follows the law of its kind within the rounding of float32, and none is missing or too many."""
    rays, prim = bounce.parents.rays, np.where(bounce.continues, bounce.parents.nearest.prim, -1)
    at = intersections_at(
        own_model(bounce.parents.packed), prim, (rays.o, rays.d), bounce.parents.nearest.t, KU_OURS, ours=True
    )
    return worst_share(_shares(bounce, scene, at, prim >= 0))


def _shares(bounce: Bounce, scene: Scene, at: Intersections, hit: Array) -> Iterator[tuple[float, str]]:
    """Shares of bounds, with what they are about. at: where the parents hit, if `hit`."""
    rays, parents = bounce.rays, bounce.parents
    materials = [scene.material_of(shape) for shape in scene.shapes]
    material = np.array([*(each.type for each in materials), ""])[np.where(hit, parents.shape_id, -1)]
    ior = np.array([*(getattr(each, "ior", 1.0) for each in materials), 1.0])[parents.shape_id]
    ior = ior.astype(np.float32).astype(np.float64)
    d, n, n_error = unit(parents.rays.d), np.where(hit[:, None], at.n, 0.0), np.where(hit, at.n_error, 0.0) + KU_OURS
    cosine = dot(d, n)
    seen = np.abs(cosine) > n_error + LEFT_OUT
    eta = np.where(cosine < 0.0, 1.0 / ior, ior)
    squared = 1.0 - eta * eta * (1.0 - cosine * cosine)
    error = 4.0 * ior * ior * n_error + KU_OURS
    passes = np.sqrt(np.maximum(squared - error - 4.0 * ior * ior * LEFT_OUT, 0.0)) > n_error + LEFT_OUT

    def counted(kind: str, may: Array, must: Array) -> tuple[float, str]:
        count = np.bincount(rays.parent[rays.kind == RAY_KINDS.index(kind)], minlength=len(hit))
        return _worst(np.where((count > may) | (count < must), np.inf, 0.0), f"hits with missing or extra {kind} rays")

    shiny, glass = np.isin(material, ("mirror", "glass")), material == "glass"
    for kind, side, index, may, must in (
        ("reflected", -1.0, np.ones(len(hit)), shiny, shiny & seen),
        ("refracted", 1.0, eta, glass & (squared > -error), glass & seen & passes),
    ):
        yield counted(kind, may, must)
        mine = rays.kind == RAY_KINDS.index(kind)
        of, leaving = rays.parent[mine], rays.d[mine]
        # The law: index n x d = n x d', where d' has been rounded to float32, on the side that the kind goes to.
        off = norm(cross(n[of], index[of, None] * d[of] - leaving))
        away = side * np.sign(cosine[of]) * dot(n[of], leaving)
        bound = U32 + (1.0 + index[of]) * n_error[of] + 4.0 * KU_OURS
        yield _worst(np.where(away > -bound, off / bound, np.inf), f"the law of {kind} rays")

    lights, mine = [light for light in scene.lights if light.type != "ambient"], rays.kind == RAY_KINDS.index("shadow")
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


def _worst(shares: Array, what: str) -> tuple[float, str]:
    wrong = int((~(shares <= 1.0)).sum())
    return float(shares.max(initial=0.0)), f"{what}: {wrong} of {len(shares)}" if wrong else what
