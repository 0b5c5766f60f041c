"""Parabolic: Mitsuba has none, so its rays are handed over."""

import numpy as np

from caster.cameras.parabolic import Parabolic
from caster.scene import Film
from mitsuba_ref.camera_reference import CameraRays, CameraReference, looking, unlimited


def rays(camera: Parabolic, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """A ray from the side of the view, reflected by a paraboloid: tan(theta / 2) is the distance from the centre."""
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance = np.hypot(right, up)
    theta, phi = 2.0 * np.arctan(distance), np.arctan2(up, right)
    local = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return unlimited(camera, looking(camera, local), distance <= 1.0)


REFERENCE = CameraReference(Parabolic, rays)
