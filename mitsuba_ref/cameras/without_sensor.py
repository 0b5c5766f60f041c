"""Cameras without a Mitsuba sensor, whose rays Mitsuba is sent: fisheye, panorama, parabolic and single ray."""

from collections.abc import Callable

import numpy as np

from caster.cameras.fisheye import Fisheye
from caster.cameras.panorama import Panorama
from caster.cameras.parabolic import Parabolic
from caster.cameras.single_ray import Ray
from caster.description.fields import Camera
from caster.scene.model import Film
from mitsuba_ref.cameras.camera_reference import (
    CameraRays,
    CameraReference,
    Fields,
    RandomView,
    rays_from_eye,
    to_world_directions,
)


def circle_rays(
    camera: Camera, film: Film, x: np.ndarray, y: np.ndarray, theta: Callable[[np.ndarray], np.ndarray]
) -> CameraRays:
    """An image within a circle. theta: the angle from the axis at distances from the centre, in radii of the circle."""
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance, phi = np.hypot(right, up), np.arctan2(up, right)
    polar = theta(distance)
    sine = np.sin(polar)
    local = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(polar)])
    return rays_from_eye(camera, to_world_directions(camera, local), distance <= 1.0)


def fisheye_rays(camera: Fisheye, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Equidistant fisheye: the angle from the axis is proportional to the distance from the centre of the image."""
    return circle_rays(camera, film, x, y, lambda distance: np.deg2rad(camera.fov) / 2.0 * distance)


def random_fisheye(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    return {**view(), "fov": float(rng.uniform(60.0, 360.0))}


FISHEYE = CameraReference(Fisheye, fisheye_rays, random_fields=random_fisheye)


def panorama_rays(camera: Panorama, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Equirectangular: a full turn across the film, half a turn from top to bottom, the view in the middle."""
    azimuth = 2.0 * np.pi * (x - film.width / 2.0) / film.width
    polar = np.pi * y / film.height
    local = np.column_stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)])
    return rays_from_eye(camera, to_world_directions(camera, local))


PANORAMA = CameraReference(Panorama, panorama_rays, covers_film=True)


def parabolic_rays(camera: Parabolic, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Reflection in a paraboloid: tan(theta / 2) is the distance from the centre of the image, in radii."""
    return circle_rays(camera, film, x, y, lambda distance: 2.0 * np.arctan(distance))


PARABOLIC = CameraReference(Parabolic, parabolic_rays)


def ray_rays(camera: Ray, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """The same ray at every film position."""
    count = len(x)
    o, d = (np.tile(np.array(v, np.float64), (count, 1)) for v in (camera.origin, camera.direction))
    t_max = np.inf if camera.t_max is None else camera.t_max
    return CameraRays(o, d, np.zeros(count), np.full(count, t_max))


def random_ray(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    fields = view()
    return {"origin": fields["eye"], "direction": fields["direction"]}


RAY = CameraReference(Ray, ray_rays, random_fields=random_ray)
