"""Fisheye: Mitsuba has none, so its rays are handed over."""

import numpy as np

from caster.cameras.fisheye import Fisheye
from caster.scene import Film
from mitsuba_ref.camera_reference import CameraRays, CameraReference, looking, unlimited


def rays(camera: Fisheye, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """The angle from the axis is fov / 2 times the distance from the centre over the circle's radius."""
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance = np.hypot(right, up)
    theta, phi = np.deg2rad(camera.fov) / 2.0 * distance, np.arctan2(up, right)
    sine = np.sin(theta)
    local = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)])
    return unlimited(camera, looking(camera, local), distance <= 1.0)


REFERENCE = CameraReference(Fisheye, rays)
