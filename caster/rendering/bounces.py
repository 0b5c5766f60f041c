"""Secondary rays: reflected, refracted and shadow rays from the exact hits of other rays, in float32 values.

Directions follow the geometric normal, so that a reflected ray leaves the surface on the side that it came from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.transform import Floats, dot_rows, row_lengths
from caster.geometry.world_space import as_float32
from caster.kernels.nearest import Rays
from caster.rendering.hits import RayHits, trace_rays
from caster.scene.model import Directional, Point

__all__ = ["RAY_KINDS", "Bounce", "bounces"]

RAY_KINDS = ("camera", "reflected", "refracted", "shadow")
"""Names of the numbers in `SecondaryRays.kind`."""
REFLECTED, REFRACTED, SHADOW = 1, 2, 3
NOWHERE = np.full(3, np.inf)  # the end of a ray without one
GRAZING, CRITICAL, TOO_FAR = "grazing their surface", "near the critical angle", "starting beyond float32"

# Unit round-offs of float32 and float64; half the spacing of the smallest float32 numbers.
U32, U64, HALF_OF_DENORMALS = 2.0**-24, 2.0**-53, 2.0**-150

# A normal of a triangle is known to half of the bits of float64 at least, that of a quadric to its point's error times
# the curvature beside (caster/kernels/triangles.py, MIN_SIN_SQUARED).
NORMAL_ERROR = 2.0**-24


class SecondaryRays(NamedTuple):
    """Rays o + t d with t_min < t <= t_max that start at hits of other rays; all numbers are float32 values."""

    o: Floats  # (n, 3), beside the surface, on the side that d leads to
    d: Floats  # (n, 3), of length 1 up to rounding
    t_min: Floats  # (n,), 0: o is off the surface
    t_max: Floats  # (n,), inf; the distance of a point light
    parent: NDArray[np.int64]  # (n,), index of the ray that it comes from, among those of the bounce before
    kind: NDArray[np.uint8]  # (n,), index into RAY_KINDS
    pixel: NDArray[np.int64]  # (n,), index of the camera ray that it comes from


@dataclass(frozen=True)
class Bounce:
    """All rays of one bounce, and what they come from."""

    number: int  # 1: from hits of camera rays
    parents: RayHits  # the rays of the bounce before, and their exact first hits
    continues: NDArray[np.bool_]  # (parents,), false of rays that end their path: shadow rays
    rays: SecondaryRays
    left_out: dict[str, int]  # reason -> count of rays that rounding leaves undecided


def spawn(points: np.ndarray, normals: np.ndarray, directions: np.ndarray, point_error: np.ndarray) -> np.ndarray:
    """Origins of rays from points of a surface: float32 values beside it, on the side that the directions lead to.

    points, normals (outwards, of length 1), directions: (n, 3) float64. point_error: (n, 3), half the sides of
    a box around the point that the surface's tangent plane crosses. Returns (n, 3) float64.
    With q the point moved by h along the normal n and then rounded, the tangent plane is passed if
    h > sum |n_i| (e_i + r_i), where r_i <= U32 |q_i| is the rounding of q. h itself adds U32 h to r at most.
    Source: "Robust Spawned Ray Origins" in Pharr, Jakob and Humphreys, Physically Based Rendering, section 6.8.6;
    there, rounding moves every coordinate away from the point, here to the nearest number.
    """
    rounding = U32 * (np.abs(points) + point_error) + HALF_OF_DENORMALS
    distance = (np.abs(normals) * (point_error + rounding)).sum(axis=1) * (1.0 + 4.0 * U32)
    side = np.where((normals * directions).sum(axis=1) < 0.0, -1.0, 1.0)
    return as_float32(points + (side * distance)[:, None] * normals)


def bounces(first: RayHits, depth: int) -> Iterator[Bounce]:
    """The secondary rays of bounces 1 to `depth`; fewer where none are left.

    first: the hits of the camera rays. A diffuse surface sends a shadow ray to each light in front of it, a mirror
    reflects, glass reflects and refracts. Shadow rays are the last of their path.
    """
    parents, pixel = first, np.arange(len(first.hit))
    continues = np.ones(len(first.hit), bool)
    for number in range(1, depth + 1):
        bounce = _bounce(number, parents, continues, pixel)
        if not len(bounce.rays.kind):
            return
        yield bounce
        rays = bounce.rays
        pixel, continues = rays.pixel, rays.kind != SHADOW
        parents = trace_rays(first.scene, first.packed, Rays(*rays[:4]), np.zeros(len(pixel)))


def _bounce(number: int, parents: RayHits, continues: np.ndarray, pixel: np.ndarray) -> Bounce:
    row = np.flatnonzero(parents.hit & continues)
    along, t = parents.rays.d[row], parents.nearest.t[row][:, None]
    p, d, n = parents.rays.o[row] + t * along, along / row_lengths(along)[:, None], parents.normal[row]
    error = np.abs(along) * parents.nearest.error[row][:, None] + 2.0 * U64 * (np.abs(t * along) + np.abs(p))
    curvature = _curvature(parents, row)
    n_error = NORMAL_ERROR + curvature * row_lengths(error)
    # Rounding moves the origin sideways, at most so far; there the surface has left its tangent plane.
    aside = row_lengths(error + U32 * np.abs(p) + HALF_OF_DENORMALS)
    error = error + (aside * (n_error + 2.0 * curvature * aside))[:, None] * np.abs(n)
    margin = n_error + 16.0 * U64  # error of a cosine with n
    cosine = dot_rows(d, n)
    side = np.where(np.abs(cosine) <= margin, 0.0, np.sign(cosine))  # 0: unknown

    materials, shape = [parents.scene.material_of(each) for each in parents.scene.shapes], parents.shape_id[row]
    material = np.array([*(each.type for each in materials), ""])[shape]
    index = as_float32(np.array([*(getattr(each, "ior", 1.0) for each in materials), 1.0]))[shape]
    refraction, squared = refracted(d, n, np.where(cosine < 0.0, 1.0 / index, index))
    uncertain = np.abs(squared) <= 2.0 * index * index * margin  # squared is 1 - eta^2 (1 - cosine^2)
    glass, diffuse = material == "glass", material == "diffuse"

    leaving = [
        (REFLECTED, ~diffuse, reflected(d, n), -side, NOWHERE),
        (REFRACTED, glass & ~uncertain & (squared > 0.0), refraction, side, NOWHERE),
    ]
    for light in parents.scene.lights:
        if isinstance(light, Point):
            leaving.append((SHADOW, diffuse, np.array(light.position) - p, -side, np.array(light.position)))
        elif isinstance(light, Directional):
            leaving.append((SHADOW, diffuse, np.zeros_like(p) - light.direction, -side, NOWHERE))

    found, left_out = [], {CRITICAL: int((glass & uncertain).sum()), GRAZING: 0, TOO_FAR: 0}
    for kind, wanted, way, to_side, target in leaving:
        k = np.flatnonzero(wanted)
        with np.errstate(over="ignore", invalid="ignore"):
            o = spawn(p[k], n[k], way[k], error[k])
            way = np.where(np.isfinite(target), target - o, way[k])
            t_max = as_float32(row_lengths(way)) if np.isfinite(target).all() else np.full(len(k), np.inf)
            way = as_float32(way / row_lengths(way)[:, None])
            away = to_side[k] * dot_rows(way, n[k])
        here = np.isfinite(o).all(axis=1)
        left_out[TOO_FAR] += int((~here).sum())
        left_out[GRAZING] += int((here & (np.abs(away) <= margin[k])).sum())
        good = here & (away > margin[k])  # the others of shadow rays lead behind their surface
        parent = row[k[good]]
        names = np.full(len(parent), kind, np.uint8)
        found.append(
            SecondaryRays(o[good], way[good], np.zeros(len(parent)), t_max[good], parent, names, pixel[parent])
        )
    rays = SecondaryRays(*map(np.concatenate, zip(*found, strict=True)))
    return Bounce(number, parents, continues, rays, {why: count for why, count in left_out.items() if count})


def _curvature(hits: RayHits, row: np.ndarray) -> np.ndarray:
    """(m,) a bound on the curvature of the surfaces that are hit; 0 of flat ones."""
    shape, prim, found = hits.shape_id[row], hits.prim_id[row], np.zeros(len(row))
    for i, part in enumerate(hits.packed.parts):
        if hasattr(part, "curvature"):
            here = shape == i
            found[here] = part.curvature[prim[here]]
    return found


def reflected(d: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Directions d (m, 3) mirrored in planes with unit normals n (m, 3): d - 2 (d . n) n."""
    return d - 2.0 * dot_rows(d, n)[:, None] * n


def refracted(d: np.ndarray, n: np.ndarray, eta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(refracted unit directions (m, 3), the squared cosine of their angle (m,), negative at total reflection).

    d: (m, 3) of length 1. n: (m, 3) unit normals, on either side. eta: (m,) refractive index on d's side over that on
    the other. Source: Snell's law, eta n x d = n x d'.
    """
    cosine = dot_rows(d, n)
    squared = 1.0 - eta * eta * (1.0 - cosine * cosine)
    along = np.copysign(np.sqrt(np.maximum(squared, 0.0)), cosine) - eta * cosine
    return eta[:, None] * d + along[:, None] * n, squared
