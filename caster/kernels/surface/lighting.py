"""Lambert shading: irradiance from lights, shadow rays, reflected radiance."""

import math
from typing import Any, NamedTuple

from caster.jit.decorators import generic_inlined, implement, inlined, jit
from caster.kernels.math.vec import add, dot, max_norm, point_at, row, scaled, select, sub
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import (
    ONE,
    PRIM,
    T_MAX,
    T_MIN,
    UNCERTAIN,
    WIDTH,
    Box,
    T,
    clear_rays,
    get,
    lane,
    put,
    start_ray,
)
from caster.kernels.surface.per_hit import ALBEDO, FLUX, RADIANCE, SH_N, SIDES, N, P, ray_of

# A computed hit lies within 16 u (|o| + t + |p|) of the surface (caster/kernels/math/quadric_roots.py, triangles.py)
# or, since it is computed from the shape's numbers as well, within 16 u of its largest coordinate, which is more for a
# sphere as large as the Earth. Shadow rays start four times as far out along the normal, so that no surface shadows
# itself. u = 2^-53.
SHADOW_OFFSET = 4 * 16.0 * 2.0**-53


class PointLight(NamedTuple):
    """A light that shines from one point."""

    position: Vec3  # float64
    intensity: Vec3  # W/sr, for each colour


class DirectionalLight(NamedTuple):
    """A light that is infinitely far."""

    back: Vec3  # unit, against the light
    irradiance: Vec3  # W/m^2


NOWHERE = (0.0, 0.0, 0.0)


@generic_inlined
def light_at(light: Any, p: Vec3) -> Any:
    """(d, reach, unit, irradiance): d from p to the light, whose distance is `reach` lengths of d; d at length 1, and
    the irradiance across it.
    """


@implement(light_at, PointLight)
def _point_light_at(light: Any, p: Vec3) -> tuple[Vec3, float, Vec3, Vec3]:
    """Intensity over squared distance; 0 at the light itself."""
    d = sub(light.position, p)
    square = dot(d, d)
    apart = square > 0.0
    safe = square if apart else 1.0
    r, g, b = light.intensity
    return d, 1.0, scaled(1.0 / math.sqrt(safe), d), select(apart, (r / safe, g / safe, b / safe), NOWHERE)


@implement(light_at, DirectionalLight)
def _directional_light_at(light: Any, p: Vec3) -> tuple[Vec3, float, Vec3, Vec3]:
    return light.back, math.inf, light.back, light.irradiance


@inlined
def received_irradiance(light: Any, p: Vec3, sh_n: Vec3, d: Vec3, two_sided: bool) -> tuple[bool, Vec3]:
    """(whether the side of the surface that faces ray d is lit, the irradiance there).

    The shading normal decides about sides. One-sided surfaces are dark from behind.
    """
    _, _, towards, irradiance = light_at(light, p)
    cosine, facing = dot(towards, sh_n), -dot(d, sh_n)
    faces = cosine * facing > 0.0 if two_sided else (cosine > 0.0) & (facing > 0.0)
    return faces, scaled(abs(cosine), irradiance)


@inlined
def shadow_ray(
    light: Any, p: Vec3, n: Vec3, o: Vec3, d: Vec3, t: float, extent: float
) -> tuple[Vec3, Vec3, float, float]:
    """(o, d, t_min, t_max) from the hit p of ray (o, d) at t to the light. extent: largest |coordinate| of the shape.

    It starts off the surface, on the side of the light. Hits nearer than the offset do not count, since rounding may
    put a hit in the crease of two faces behind the other one.
    """
    lean = dot(n, light_at(light, p)[2])
    side = 1.0 if lean > 0.0 else (-1.0 if lean < 0.0 else 0.0)
    offset = SHADOW_OFFSET * max(max_norm(o) + t * math.sqrt(dot(d, d)) + max_norm(p), extent)
    start = point_at(p, side * offset, n)
    way, reach, _, _ = light_at(light, start)
    away = math.sqrt(dot(way, way))
    return start, way, offset / away if away > 0.0 else 0.0, reach


@jit
def materials_in_tile(tile: Any, box: Box, shapes: Any, reflectance: Any, two_sided: Any, buffer: Any) -> None:
    """Write ALBEDO and SIDES of the hits from tables by shape, and RADIANCE 0; shapes[prim]: that of a primitive."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            prim = tile[PRIM + i]
            number = lane(shapes[lane(prim if prim >= 0.0 else 0.0)])
            put(buffer, ALBEDO + i, row(reflectance, number))
            buffer[SIDES + i] = 1.0 if two_sided[number] else 0.0
            put(buffer, RADIANCE + i, NOWHERE)


@jit
def shadow_rays_in_tile(
    light: Any, tile: Any, box: Box, shapes: Any, extents: Any, buffer: Any, shadow_tile: Any, total: Any
) -> int:
    """Fill the tile `shadow_tile` with a ray to the light from each hit that faces it; add their number to total[0].

    shapes[prim]: the shape of a primitive; extents[shape]: its largest |coordinate|. FLUX: the irradiance without
    shadows. Returns the number of rays.
    """
    width, count = box[2] - box[0], 0
    for y in range(box[3] - box[1]):
        first, stop = lane(y * WIDTH), lane(y * WIDTH + width)
        for i in range(first, stop):
            prim = tile[PRIM + i]
            shadow_tile[T_MIN + i] = extents[shapes[lane(prim if prim >= 0.0 else 0.0)]]
        # without a branch, so that several pixels are done at once; results of misses are not used
        for i in range(first, stop):
            (o, d), hit = ray_of(tile, i), tile[PRIM + i] >= 0.0
            p, n = select(hit, get(buffer, P + i), NOWHERE), select(hit, get(buffer, N + i), NOWHERE)
            sh_n = select(hit, get(buffer, SH_N + i), NOWHERE)
            t, extent = tile[T + i] if hit else 0.0, shadow_tile[T_MIN + i]
            lit, flux = received_irradiance(light, p, sh_n, d, buffer[SIDES + i] != 0.0)
            put(buffer, FLUX + i, flux)
            start, way, near, reach = shadow_ray(light, p, n, o, d, t, extent)
            there = lit & hit
            aim = (
                select(there, start, NOWHERE),
                select(there, way, (0.0, 0.0, 1.0)),
                near if there else 0.0,
                reach if there else -1.0,
            )
            start_ray(shadow_tile, i, aim)
            count += 1 if there else 0
        clear_rays(shadow_tile, y * WIDTH + width, (y + 1) * WIDTH)
    total[0] += count
    return count


@jit
def add_light(tile: Any, box: Box, buffer: Any, shadow_tile: Any) -> None:
    """Add the light to RADIANCE after the shadow rays have been cast; UNCERTAIN where a shadow is uncertain."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            lit = (shadow_tile[T_MAX + i] >= 0.0) & (shadow_tile[T + i] == math.inf)
            reflected = reflected_radiance(get(buffer, ALBEDO + i), get(buffer, FLUX + i))
            put(buffer, RADIANCE + i, add(get(buffer, RADIANCE + i), select(lit, reflected, NOWHERE)))
            open_ = lit & (shadow_tile[UNCERTAIN + i] != 0.0)
            tile[UNCERTAIN + i] = 1.0 if open_ else tile[UNCERTAIN + i]


@inlined
def reflected_radiance(albedo: Vec3, irradiance: Vec3) -> Vec3:
    """The radiance that a Lambertian surface reflects."""
    r, g, b = irradiance
    return albedo[0] / math.pi * r, albedo[1] / math.pi * g, albedo[2] / math.pi * b


@jit
def add_ambient(tile: Any, box: Box, buffer: Any, ambient: Any) -> None:
    """Add ambient lights to RADIANCE; ambient: (k, 3) radiances."""
    for y in range(box[3] - box[1]):
        for i in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0])):
            if tile[PRIM + i] >= 0.0:
                for c in range(3):
                    field, sum_ = lane(c) * ONE + i, 0.0
                    for k in range(len(ambient)):
                        sum_ += buffer[ALBEDO + field] * ambient[k, c]
                    buffer[RADIANCE + field] += sum_
