"""What a diffuse surface sends back of one light, and how far float32 may be off in it (docs/method.md, "Diffuse").

Written from the lights' definitions a second time: L = reflectance / pi * cosine * irradiance.
"""

from typing import Any, NamedTuple

import numpy as np

from caster.scene import Scene
from mitsuba_ref.meeting import Meetings, dot, norm

# Where the direction to a light is known to no better than this, the light's value is not known at all.
UNRESOLVABLE = 0.5


class Hit(NamedTuple):
    """Pixels that hit: positions, directions of their rays, and the bounds there."""

    p: np.ndarray  # (m, 3)
    d: np.ndarray  # (m, 3)
    shape: np.ndarray  # (m,)
    at: Meetings


class Lit(NamedTuple):
    """One light at m pixels, unshadowed."""

    radiance: np.ndarray  # (m, 3)
    error: np.ndarray  # (m, 3)
    either_side: np.ndarray  # (m, 3) radiance if the side that faces the light is the one that is seen
    to_light: np.ndarray  # (m, 3) from p; of unit length for a light without a place
    reach: np.ndarray  # (m,) 1 or inf: how far the light is, in lengths of to_light
    doubtful: np.ndarray  # (m,) bool: seen so nearly from the side that either face may be the one


def lit(scene: Scene, light: Any, hit: Hit, ku: float) -> Lit:
    """Radiance from `light`, with the error that errors of position and shading normal bring about."""
    reflectance, two_sided = _materials(scene, hit.shape)
    to_light, reach = way(light, hit.p)
    distance = norm(to_light)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(np.isinf(reach), 0.0, 2.0 * hit.at.p_error / distance)
        turn = np.where(turn < UNRESOLVABLE, turn, np.inf)
        cosine = dot(to_light, hit.at.sh_n) / distance
        facing = -dot(hit.d, hit.at.sh_n) / norm(hit.d)
        seen = np.where(two_sided, cosine * facing > 0.0, (cosine > 0.0) & (facing > 0.0))
        cosine = np.abs(cosine)
        flux = _flux(light, distance) * reflectance / np.pi
        spread = 1.0 / np.maximum(1.0 - turn, 0.0) ** 2  # of 1 / distance^2, when p moves by its error
        cosine_error = hit.at.sh_error + turn + ku
        most = flux * (spread * (cosine + cosine_error))[:, None]
        radiance = np.where(seen[:, None], flux * cosine[:, None], 0.0)
    error = np.where(seen[:, None], most - radiance, flux * (cosine_error * spread)[:, None]) + ku * radiance
    dark = ~seen & (cosine > cosine_error) & (np.abs(facing) > hit.at.sh_error + ku)
    error[dark] = 0.0
    return Lit(
        radiance, error, flux * cosine[:, None], to_light, reach, np.abs(facing) <= hit.at.sh_error + ku
    )


def ambient(scene: Scene, shape: np.ndarray) -> np.ndarray:
    """(m, 3) reflectance times the radiance of all ambient lights."""
    total = np.zeros(3)
    for light in scene.lights:
        if light.type == "ambient":
            total = total + np.array(light.radiance)
    return _materials(scene, shape)[0] * total


def way(light: Any, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From points p (m, 3): directions to the light (m, 3), and how far it is in lengths of them (m,)."""
    if light.type == "point":
        return np.array(light.position) - p, np.ones(len(p))
    direction = np.array(light.direction)
    return np.tile(-direction / np.linalg.norm(direction), (len(p), 1)), np.full(len(p), np.inf)


def _flux(light: Any, distance: np.ndarray) -> np.ndarray:
    if light.type == "point":
        return np.array(light.intensity) / (distance * distance)[:, None]
    return np.tile(np.array(light.irradiance), (len(distance), 1))


def _materials(scene: Scene, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    materials = [scene.material_of(each) for each in scene.shapes]
    reflectance = np.array([material.reflectance for material in materials]).reshape(-1, 3)
    two_sided = np.array([material.two_sided for material in materials], bool)
    return reflectance[shape], two_sided[shape]
