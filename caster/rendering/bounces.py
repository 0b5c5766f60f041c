"""Secondary rays: reflected, refracted and shadow rays from the exact hits of other rays, in float32 values.

Directions follow the geometric normal, so that a reflected ray leaves the surface on the side that it came from.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.geometry.world_space import as_float32
from caster.kernels.nearest import Rays
from caster.rendering.hits import RayHits, trace_rays
from caster.scene.model import Directional, Point

__all__ = ["RAY_KINDS", "Bounce", "SecondaryRays", "bounces", "spawn"]

RAY_KINDS = ("camera", "reflected", "refracted", "shadow")
"""Names of the numbers in `SecondaryRays.kind`."""
REFLECTED, REFRACTED, SHADOW = 1, 2, 3

# Unit round-offs of float32 and float64; half the spacing of the smallest float32 numbers.
U32, U64, HALF_OF_DENORMALS = 2.0**-24, 2.0**-53, 2.0**-150

# A normal of a triangle is known to half of the bits of float64 at least, that of a quadric to its point's error times
# the curvature beside (caster/kernels/triangles.py, MIN_SIN_SQUARED).
NORMAL_ERROR = 2.0**-24


class SecondaryRays(NamedTuple):
    """Rays o + t d with t_min < t <= t_max that start at hits of other rays; all numbers are float32 values."""

    o: NDArray[np.float64]  # (n, 3), beside the surface, on the side that d leads to
    d: NDArray[np.float64]  # (n, 3), of length 1 up to rounding
    t_min: NDArray[np.float64]  # (n,), 0: o is off the surface
    t_max: NDArray[np.float64]  # (n,), inf; the distance of a point light
    parent: NDArray[np.int64]  # (n,), index of the ray that it comes from, among those of the bounce before
    kind: NDArray[np.uint8]  # (n,), index into RAY_KINDS
    pixel: NDArray[np.int64]  # (n,), index of the camera ray that it comes from

    def rows(self, rows: np.ndarray) -> "SecondaryRays":
        """Some of them."""
        return SecondaryRays(*(a[rows] for a in self))


@dataclass(frozen=True)
class Bounce:
    """All rays of one bounce, and what they come from."""

    number: int  # 1: from hits of camera rays
    parents: RayHits  # the rays of the bounce before, and their exact first hits
    continues: NDArray[np.bool_]  # (parents,), false of rays that end their path: shadow rays
    rays: SecondaryRays
    left_out: dict[str, int]  # reason -> count of rays that rounding leaves undecided

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(n, 3), the hit that each ray starts from, rounded to float64."""
        hits = self.parents
        return (hits.rays.o + hits.nearest.t[:, None] * hits.rays.d)[self.rays.parent]

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(n, 3), the geometric normals there, outwards."""
        return self.parents.normal[self.rays.parent]


# (points, normals, directions (n, 3), point_error (n, 3)) -> origins (n, 3), rounded to float32 afterwards
Spawn = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def spawn(points: np.ndarray, normals: np.ndarray, directions: np.ndarray, point_error: np.ndarray) -> np.ndarray:
    """Origins of rays from points of a surface: float32 values beside it, on the side that the directions lead to.

    points, normals (outwards, of length 1), directions: (n, 3) float64. point_error: (n, 3), the surface's tangent
    plane passes the point within this box. Returns (n, 3) float64.
    With q the point moved by h along the normal n and then rounded, the tangent plane is passed if
    h > sum |n_i| (e_i + r_i), where r_i <= U32 |q_i| is the rounding of q. h itself adds U32 h to r at most.
    Source: "Robust Spawned Ray Origins" in Pharr, Jakob and Humphreys, Physically Based Rendering, section 6.8.6;
    there, rounding moves every coordinate away from the point, here to the nearest number.
    """
    rounding = U32 * (np.abs(points) + point_error) + HALF_OF_DENORMALS
    distance = (np.abs(normals) * (point_error + rounding)).sum(axis=1) * (1.0 + 4.0 * U32)
    side = np.where((normals * directions).sum(axis=1) < 0.0, -1.0, 1.0)
    return as_float32(points + (side * distance)[:, None] * normals)


def bounces(first: RayHits, depth: int, spawn: Spawn = spawn) -> Iterator[Bounce]:
    """The secondary rays of bounces 1 to `depth`; fewer where none are left.

    first: the hits of the camera rays. A diffuse surface sends a shadow ray to each light in front of it, a mirror
    reflects, glass reflects and refracts. Shadow rays are the last of their path.
    """
    parents, pixel = first, np.arange(len(first.hit))
    ends = np.zeros(len(first.hit), bool)
    for number in range(1, depth + 1):
        left_out: dict[str, int] = {}
        leaving = list(_leaving(parents, _hits_of(parents, ~ends), left_out))
        found = [_started(each, pixel, spawn, left_out) for each in leaving]
        rays = SecondaryRays(*map(np.concatenate, zip(*found, strict=True)))
        if not len(rays.kind):
            return
        yield Bounce(number, parents, ~ends, rays, {why: count for why, count in left_out.items() if count})
        pixel, ends = rays.pixel, rays.kind == SHADOW
        parents = trace_rays(first.scene, first.packed, Rays(*rays[:4]), np.zeros(len(ends)))


class _Hits(NamedTuple):
    """Hits that send out rays."""

    row: np.ndarray  # (m,) int64, of the ray
    d: np.ndarray  # (m, 3) direction of the ray, of length 1
    p: np.ndarray  # (m, 3)
    p_error: np.ndarray  # (m, 3), the tangent plane passes p within this box
    n: np.ndarray  # (m, 3) outwards, of length 1
    n_error: np.ndarray  # (m,)

    @property
    def cosine(self) -> np.ndarray:
        """(m,), of d and n; its error is within `margin`."""
        return _dot(self.d, self.n)

    @property
    def margin(self) -> np.ndarray:
        """(m,), error of the cosine of n and a direction that is known up to some roundings."""
        return self.n_error + 16.0 * U64

    def take(self, rows: np.ndarray) -> "_Hits":
        return _Hits(*(a[rows] for a in self))


class _Leaving(NamedTuple):
    """Directions in which rays of one kind leave hits."""

    kind: int
    hits: _Hits
    d: np.ndarray  # (m, 3)
    side: np.ndarray  # (m,) of the surface: the sign of d . n
    target: np.ndarray | None = None  # where the rays end, a point of the scene


def _hits_of(parents: RayHits, wanted: np.ndarray) -> _Hits:
    row = np.flatnonzero(parents.hit & wanted)
    o, d, t = parents.rays.o[row], parents.rays.d[row], parents.nearest.t[row][:, None]
    p, curvature = o + t * d, _curvature(parents, row)
    error = np.abs(d) * parents.nearest.error[row][:, None] + 2.0 * U64 * (np.abs(t * d) + np.abs(p))
    # Rounding moves the origin sideways, at most so far; there the surface has left its tangent plane.
    aside = np.linalg.norm(error + U32 * np.abs(p) + HALF_OF_DENORMALS, axis=1)
    n, n_error = parents.normal[row], NORMAL_ERROR + curvature * np.linalg.norm(error, axis=1)
    error = error + (aside * (n_error + 2.0 * curvature * aside))[:, None] * np.abs(n)
    return _Hits(row, d / np.linalg.norm(d, axis=1, keepdims=True), p, error, n, n_error)


def _curvature(hits: RayHits, row: np.ndarray) -> np.ndarray:
    """(m,) a bound on the curvature of the surfaces that are hit; 0 of flat ones."""
    shape, prim, found = hits.shape_id[row], hits.prim_id[row], np.zeros(len(row))
    for i, part in enumerate(hits.packed.parts):
        if hasattr(part, "curvature"):
            here = shape == i
            found[here] = part.curvature[prim[here]]
    return found


def _leaving(parents: RayHits, hits: _Hits, left_out: dict[str, int]) -> Iterator[_Leaving]:
    """All directions in which rays leave the hits. left_out: counts hits whose rays rounding leaves undecided."""
    seen_edge_on = np.abs(hits.cosine) <= hits.margin
    left_out[GRAZING] = int(seen_edge_on.sum())
    hits = hits.take(~seen_edge_on)
    materials, shape = [parents.scene.material_of(each) for each in parents.scene.shapes], parents.shape_id[hits.row]
    kind = np.array([material.type for material in materials])[shape] if len(shape) else np.zeros(0, str)

    lit = hits.take(kind == "diffuse")
    for light in parents.scene.lights:
        if isinstance(light, Point):
            target = np.array(light.position)
            yield _Leaving(SHADOW, lit, target - lit.p, -np.sign(lit.cosine), target)
        elif isinstance(light, Directional):
            yield _Leaving(SHADOW, lit, np.zeros_like(lit.p) - light.direction, -np.sign(lit.cosine))

    reflecting = hits.take(kind != "diffuse")
    yield _Leaving(REFLECTED, reflecting, reflected(reflecting.d, reflecting.n), -np.sign(reflecting.cosine))

    inside = hits.take(kind == "glass")
    ior = as_float32(np.array([getattr(material, "ior", 1.0) for material in materials]))[shape[kind == "glass"]]
    d, excess = refracted(inside.d, inside.n, np.where(inside.cosine < 0.0, 1.0 / ior, ior))
    error = 2.0 * ior * ior * inside.margin  # of the excess, which is 1 - eta^2 (1 - cosine^2)
    left_out[CRITICAL] = int((np.abs(excess) <= error).sum())
    passes = excess > error
    yield _Leaving(REFRACTED, inside.take(passes), d[passes], np.sign(inside.cosine[passes]))


GRAZING, CRITICAL, TOO_FAR = "grazing their surface", "near the critical angle", "starting beyond float32"


def reflected(d: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Directions d (m, 3) mirrored in planes with unit normals n (m, 3): d - 2 (d . n) n."""
    return d - 2.0 * _dot(d, n)[:, None] * n


def refracted(d: np.ndarray, n: np.ndarray, eta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(refracted unit directions (m, 3), the squared cosine of their angle (m,), negative at total reflection).

    d: (m, 3) of length 1. n: (m, 3) unit normals, on either side. eta: (m,) refractive index on d's side over that on
    the other. Source: Snell's law, eta n x d = n x d'.
    """
    cosine = _dot(d, n)
    squared = 1.0 - eta * eta * (1.0 - cosine * cosine)
    along = np.copysign(np.sqrt(np.maximum(squared, 0.0)), cosine) - eta * cosine
    return eta[:, None] * d + along[:, None] * n, squared


def _started(leaving: _Leaving, pixel: np.ndarray, spawn: Spawn, left_out: dict[str, int]) -> SecondaryRays:
    """The rays in float32 values that leave their surface on the right side. left_out: counts others."""
    kind, hits, d, side, target = leaving
    with np.errstate(over="ignore"):
        o = as_float32(spawn(hits.p, hits.n, d, hits.p_error))
    finite = np.isfinite(o).all(axis=1)
    left_out[TOO_FAR] = left_out.get(TOO_FAR, 0) + int((~finite).sum())
    if target is not None:
        d = target - o
    length = np.linalg.norm(d, axis=1)
    d = as_float32(d / length[:, None])
    away = side * _dot(d, hits.n)
    if kind != SHADOW:  # of shadow rays, those to lights behind the surface are none
        left_out[GRAZING] += int((finite & (away <= hits.margin)).sum())
    row = np.flatnonzero(finite & (away > hits.margin))
    t_max = np.full(len(length), np.inf) if target is None else as_float32(length)
    parent = hits.row[row]
    return SecondaryRays(
        o[row], d[row], np.zeros(len(row)), t_max[row], parent, np.full(len(row), kind, np.uint8), pixel[parent]
    )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
