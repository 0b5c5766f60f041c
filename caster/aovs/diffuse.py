"""Lambert shading: what a diffuse surface sends back of each light, with hard shadows; ambient on top."""

import numpy as np

from caster.lights import Light
from caster.view import View

NAME, CHANNELS, MISS = "diffuse", ("R", "G", "B"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64 radiance, 0 on a miss: `direct` plus `ambient`."""
    return direct(view) + ambient(view)


def direct(view: View) -> np.ndarray:
    """Radiance from point and directional lights: reflectance / pi times the irradiance that arrives.

    One-sided surfaces are dark from behind; sides are told by the shading normal.
    """
    radiance = np.zeros((len(view.hit), 3))
    for light in view.scene.lights:
        if light.type != "ambient":
            where, irradiance = _arriving(view, light)
            radiance[where] += view.reflectance[where] / np.pi * irradiance
    return radiance


def ambient(view: View) -> np.ndarray:
    """Reflectance times the ambient radiance: the same from everywhere, so it knows no shadow."""
    radiance = np.zeros((len(view.hit), 3))
    for light in view.scene.lights:
        if light.type == "ambient":
            radiance += view.reflectance * np.array(light.radiance)
    return radiance


def _arriving(view: View, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """(hits that the light reaches, irradiance there)."""
    where = np.flatnonzero(view.hit)
    towards, strength = light.towards(view.surfaces.p[where])
    cosine = np.sum(towards * view.surfaces.sh_n[where], axis=1)
    facing = -np.sum(view.rays.d[where] * view.surfaces.sh_n[where], axis=1)
    seen = np.where(view.two_sided[where], cosine * facing > 0.0, (cosine > 0.0) & (facing > 0.0))
    where, cosine, strength = where[seen], np.abs(cosine[seen]), strength[seen]
    lit = view.lit(light, where)
    return where[lit], (cosine[:, None] * strength)[lit]
