"""Panorama: Mitsuba has none, so its rays are handed over."""

import numpy as np

from caster.cameras.panorama import Panorama
from caster.scene import Film
from mitsuba_ref.camera_reference import CameraRays, CameraReference, looking, unlimited


def rays(camera: Panorama, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """A full turn across the film, half a turn from top to bottom, the view in the middle."""
    azimuth = 2.0 * np.pi * (x - film.width / 2.0) / film.width
    polar = np.pi * y / film.height
    local = np.column_stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)])
    return unlimited(camera, looking(camera, local))


REFERENCE = CameraReference(Panorama, rays)
