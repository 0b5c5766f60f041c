"""Cameras without a Mitsuba sensor, whose rays Mitsuba is sent: fisheye, panorama, parabolic and single ray."""

import numpy as np

from caster.cameras.fisheye import Fisheye
from caster.cameras.panorama import Panorama
from caster.cameras.parabolic import Parabolic
from caster.cameras.single_ray import Ray
from caster.scene.model import Film
from mitsuba_ref.cameras.camera_reference import (
    CameraRays,
    CameraReference,
    Fields,
    RandomView,
    rays_from_eye,
    to_world_directions,
)


def fisheye_rays(camera: Fisheye, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Equidistant fisheye: the angle from the axis is proportional to the distance from the centre of the image."""
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance = np.hypot(right, up)
    theta, phi = np.deg2rad(camera.fov) / 2.0 * distance, np.arctan2(up, right)
    sine = np.sin(theta)
    local = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)])
    return rays_from_eye(camera, to_world_directions(camera, local), distance <= 1.0)


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
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance = np.hypot(right, up)
    theta, phi = 2.0 * np.arctan(distance), np.arctan2(up, right)
    local = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return rays_from_eye(camera, to_world_directions(camera, local), distance <= 1.0)


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
