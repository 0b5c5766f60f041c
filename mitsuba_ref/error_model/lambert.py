"""Lambertian radiance with error bounds, and which shadow rays may be blocked (docs/method.md, "Diffuse", "Shadows").

An independent implementation of L = reflectance / pi * cosine * irradiance.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import (
    Array,
    Intersections,
    Rays,
    dot,
    largest_of_columns,
    norm,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.tolerances import KU_OURS, U32

# If the direction to a light is no better known than this, the light's value has no bound.
LARGEST_DIRECTION_ERROR = 0.5


class ShadingPoints(NamedTuple):
    """Positions of m hits, directions of their rays, the error bounds there, and their materials."""

    p: Array  # (m, 3)
    d: Array  # (m, 3)
    at: Intersections
    reflectance: Array  # (m, 3)
    two_sided: Array  # (m,) bool


class LightContribution(NamedTuple):
    """Radiance from one light at m pixels, without shadows."""

    radiance: Array  # (m, 3); where either face may be lit, that of the one that faces the ray
    error: Array  # (m, 3)
    to_light: Array  # (m, 3) from p; of unit length for a directional light
    reach: Array  # (m,) distance of the light in lengths of to_light: 1 or inf
    doubtful: Array  # (m,) bool: so near grazing that either face may be the visible one


@without_overflow_warnings
def light_contribution(light: Any, hit: ShadingPoints, ku: float) -> LightContribution:
    """Radiance from `light`, with the error that follows from errors of the position and of the shading normal."""
    to_light, reach = direction_to_light(light, hit.p)
    distance = norm(to_light)
    turn = np.where(np.isinf(reach), 0.0, 2.0 * hit.at.p_error / distance)
    turn = np.where(turn < LARGEST_DIRECTION_ERROR, turn, np.inf)
    cosine = dot(to_light, hit.at.sh_n) / distance
    facing = -dot(hit.d, hit.at.sh_n) / norm(hit.d)
    seen = np.where(hit.two_sided, cosine * facing > 0.0, (cosine > 0.0) & (facing > 0.0))
    doubtful = np.abs(facing) <= hit.at.sh_error + ku
    cosine = np.abs(cosine)
    if light.type == "point":
        irradiance = np.array(light.intensity) / (distance * distance)[:, None]
    else:
        irradiance = np.array(light.irradiance)
    flux = irradiance * hit.reflectance / np.pi
    spread = 1.0 / np.maximum(1.0 - turn, 0.0) ** 2  # of 1 / distance^2, when p moves by its error
    cosine_error = hit.at.sh_error + turn + ku
    most = flux * (spread * (cosine + cosine_error))[:, None]
    radiance = np.where(seen[:, None], flux * cosine[:, None], 0.0)
    error = np.where(seen[:, None], most - radiance, flux * (cosine_error * spread)[:, None]) + ku * radiance
    error[~seen & (cosine > cosine_error) & ~doubtful] = 0.0
    radiance = np.where(doubtful[:, None], flux * cosine[:, None], radiance)
    return LightContribution(radiance, error, to_light, reach, doubtful)


def ambient_radiance(lights: Sequence[Any]) -> Array:
    """(3,) total radiance of the ambient lights."""
    return sum((np.array(light.radiance) for light in lights if light.type == "ambient"), np.zeros(3))


def direction_to_light(light: Any, p: Array) -> tuple[Array, Array]:
    """Directions (m, 3) from p (m, 3) to the light, and its distance (m,) in lengths of them."""
    if light.type == "point":
        return np.array(light.position) - p, np.ones(len(p))
    direction = np.array(light.direction)
    return np.tile(-direction / np.linalg.norm(direction), (len(p), 1)), np.full(len(p), np.inf)


# ---- sums of lights, some of which may be lit or shadowed: the allowed combination that fits best


# Up to so many doubtful lights at one pixel are tried in all 2^8 combinations. Further ones keep their first value,
# which only makes the verdict stricter.
MAX_UNCERTAIN_LIGHTS = 8


class LightChoices(NamedTuple):
    """Radiance of each light at m pixels: the first value or, where the light is in doubt, either of two."""

    first: Array  # (lights, m, 3)
    first_error: Array  # (lights, m, 3)
    second: Array  # (lights, m, 3)
    second_error: Array  # (lights, m, 3)
    doubt: Array  # (lights, m) bool


def smallest_error_ratio(ours: Array, fixed: Array, choices: LightChoices, ku: float) -> Array:
    """(m,) smallest ratio of error to bound of ours (m, 3) against `fixed` plus lights, over the choices of lights.

    Of each pixel, MAX_UNCERTAIN_LIGHTS lights in doubt at most are tried both ways; the others keep their first value.
    """
    count = min(int(choices.doubt.sum(axis=0).max(initial=0)), MAX_UNCERTAIN_LIGHTS)
    best = np.full(len(ours), np.inf)
    order = np.argsort(~choices.doubt, axis=0, kind="stable")[..., None]  # the lights of each pixel in doubt first
    first, first_error, second, second_error, doubt = (
        np.take_along_axis(a, order, axis=0) for a in (*choices[:4], choices.doubt[..., None])
    )
    for flips in itertools.product((False, True), repeat=count):
        switched = np.zeros_like(doubt)
        switched[:count] = np.array(flips, bool)[:, None, None] & doubt[:count]
        total = fixed + np.where(switched, second, first).sum(axis=0)
        rounded = ku * (fixed + total)  # the ambient light's own product, and the sum
        bound = np.where(switched, second_error, first_error).sum(axis=0) + rounded
        best = np.minimum(best, largest_of_columns(error_over_bound(np.abs(ours - total), bound)))
    return best


# ---- shadows: whether each side may answer "lit", "in shadow" or both (docs/method.md, "Shadows")
#
# Mitsuba starts shadow rays off the surface and ends them short of the light, so it misses blockers closer than that.
# It is therefore judged along the ray that its source code traces, and ours along the segment to the light.


# Mitsuba 3.9.1, math.h: distance of a ray's start from the surface, in units of 1 + max |p|, and the fraction of its
# length by which a shadow ray ends short of the light.
RAY_EPSILON = 1500 * U32
SHADOW_EPSILON = 10 * RAY_EPSILON


def reference_shadow_rays(hit: ShadingPoints, lit: LightContribution, p: Array, n: Array) -> Rays:
    """Mitsuba's shadow rays: from its p (m, 3), moved along its n (m, 3) to the lit side, to just before the light."""
    near = np.isfinite(lit.reach)
    way = np.where(near[:, None], hit.p + lit.to_light - p, lit.to_light)
    offset = (1.0 + largest_of_columns(np.abs(p))) * RAY_EPSILON
    o = p + (np.copysign(offset, dot(n, way)))[:, None] * n
    d = np.where(near[:, None], p + way - o, way)
    return Rays(o, d, np.zeros(len(o)), np.where(near, 1.0 - SHADOW_EPSILON, np.inf))


def our_shadows(bracket: Bracket, hit: ShadingPoints, lit: LightContribution, prim: Array) -> tuple[Array, Array]:
    """(possibly, certainly) in shadow for ours, from the hit; prim (m,) does not shadow itself at the ray's start.

    Rounding of o + t d may move the hit point off the surface.
    """
    off = KU_OURS * (norm(hit.p) + norm(hit.d) * np.abs(hit.at.t))
    return bracket.blocked(Rays(hit.p, lit.to_light, np.zeros(len(off)), lit.reach), leaving=(prim, off))
