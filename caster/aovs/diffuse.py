"""Lambert shading: what a diffuse surface sends back of each light, with hard shadows; ambient on top."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "diffuse", ("R", "G", "B"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64 radiance, 0 on a miss: `direct` plus `ambient`."""
    return direct(view) + ambient(view)


def direct(view: View) -> np.ndarray:
    """Radiance from point and directional lights: reflectance / pi times the irradiance that arrives."""
    radiance = np.zeros((len(view.hit), 3))
    for light in view.scene.lights:
        if light.type != "ambient":
            where, irradiance = view.arriving(light)
            radiance[where] += view.reflectance[where] / np.pi * irradiance
    return radiance


def ambient(view: View) -> np.ndarray:
    """Reflectance times the ambient radiance: the same from everywhere, so it knows no shadow."""
    radiance = np.zeros((len(view.hit), 3))
    for light in view.scene.lights:
        if light.type == "ambient":
            radiance += view.reflectance * np.array(light.radiance)
    return radiance
