"""What a light gives a point of a surface (Lambert), and the ray from there to the light."""

import math
from typing import Any, NamedTuple

from caster.kernels.jit import generic_inlined, implement, inlined, jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import along, dot, largest, row, scaled, sub

# A computed hit lies within 16 u (|o| + t + |p|) of the surface (kernels/roots.py, triangles.py); shadow rays start
# four times as far out, along the normal, so that no surface shadows itself. u = 2^-53.
SHADOW_OFFSET = 4 * 16.0 * 2.0**-53


class PointLight(NamedTuple):
    """A light that shines from one point."""

    position: Vec3  # float64
    intensity: Vec3  # W/sr, for each colour


class DirectionalLight(NamedTuple):
    """A light that is infinitely far."""

    back: Vec3  # unit, against the light
    irradiance: Vec3  # W/m^2


# The parameters of the stubs below are read by their bodies alone.


@generic_inlined
def way_to(light: Any, p: Vec3) -> Any:
    """(d, reach): the direction from p to the light, and how far that is in lengths of d."""


@generic_inlined
def incoming(light: Any, p: Vec3) -> Any:
    """(unit vector from p to the light, irradiance across it)."""


@implement(way_to, PointLight)
def _way_to_point(light: Any, p: Vec3) -> tuple[Vec3, float]:
    return sub(light.position, p), 1.0


@implement(incoming, PointLight)
def _incoming_from_point(light: Any, p: Vec3) -> tuple[Vec3, Vec3]:
    """Intensity over squared distance; nothing in the light itself."""
    d = sub(light.position, p)
    square = dot(d, d)
    apart = square > 0.0
    safe = square if apart else 1.0
    r, g, b = light.intensity
    near = r / safe if apart else 0.0, g / safe if apart else 0.0, b / safe if apart else 0.0
    return scaled(1.0 / math.sqrt(safe), d), near


@implement(way_to, DirectionalLight)
def _way_to_sun(light: Any, p: Vec3) -> tuple[Vec3, float]:
    return light.back, math.inf


@implement(incoming, DirectionalLight)
def _incoming_from_sun(light: Any, p: Vec3) -> tuple[Vec3, Vec3]:
    return light.back, light.irradiance


@inlined
def arriving(light: Any, p: Vec3, sh_n: Vec3, d: Vec3, two_sided: bool) -> tuple[bool, Vec3]:
    """(whether the side of the surface that ray d sees is lit, the irradiance there). Sides go by the shading normal.

    One-sided surfaces are dark from behind.
    """
    towards, irradiance = incoming(light, p)
    cosine, facing = dot(towards, sh_n), -dot(d, sh_n)
    seen = cosine * facing > 0.0 if two_sided else (cosine > 0.0) & (facing > 0.0)
    return seen, scaled(abs(cosine), irradiance)


@inlined
def shadow_ray(light: Any, p: Vec3, n: Vec3, o: Vec3, d: Vec3, t: float) -> tuple[Vec3, Vec3, float, float]:
    """(o, d, t_min, t_max) from the hit p of ray (o, d) at t to the light.

    It starts off the surface, on the side that the light is on. What lies nearer than the offset does not count:
    a hit in the crease of two faces may be a rounding behind the other one.
    """
    lean = dot(n, incoming(light, p)[0])
    side = 1.0 if lean > 0.0 else (-1.0 if lean < 0.0 else 0.0)
    offset = SHADOW_OFFSET * (largest(o) + t * math.sqrt(dot(d, d)) + largest(p))
    start = along(p, side * offset, n)
    way, reach = way_to(light, start)
    away = math.sqrt(dot(way, way))
    return start, way, offset / away if away > 0.0 else 0.0, reach


@jit
def find_arriving(
    light: Any, surfaces: Any, rays: Any, hit: Any, two_sided: Any, seen: Any, flux: Any
) -> None:
    """`arriving` for all rays that hit; seen (n,) bool and flux (n, 3) are false and zero elsewhere."""
    for i in range(len(hit)):
        if hit[i]:
            p, sh_n = row(surfaces.p, i), row(surfaces.sh_n, i)
            seen[i], irradiance = arriving(light, p, sh_n, row(rays.d, i), two_sided[i])
            flux[i, 0], flux[i, 1], flux[i, 2] = irradiance


@jit
def find_shadow_rays(light: Any, surfaces: Any, rays: Any, t: Any, where: Any, out: Any) -> None:
    """`shadow_ray` for the rays `where`, written to rays 0.. of out."""
    for j in range(len(where)):
        i = where[j]
        o, d = row(rays.o, i), row(rays.d, i)
        start, way, near, reach = shadow_ray(light, row(surfaces.p, i), row(surfaces.n, i), o, d, t[i])
        for c in range(3):
            out.o[j, c], out.d[j, c] = start[c], way[c]
        out.t_min[j], out.t_max[j] = near, reach
