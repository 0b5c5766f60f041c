"""Every camera: pinhole and orthographic, for which Mitsuba has a sensor; the rays of all others are sent to it."""

from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from caster.cameras import Fisheye, Orthographic, Panorama, Pinhole, Ray
from caster.description.fields import Camera
from caster.scene.model import Film
from mitsuba_ref.cameras.camera_reference import (
    CameraReference,
    ClipRange,
    Fields,
    RandomView,
    Rng,
    camera_axes,
    clip_planes,
    eye_origins,
    rays_from_eye,
    to_world_directions,
)
from mitsuba_ref.error_model.intersections import Array, Rays, stacked_columns
from mitsuba_ref.scene_xml.elements import XmlElement, matrix_element


def half_extents(camera: Pinhole, film: Film) -> tuple[float, float]:
    """Half width and half height of the image plane at distance 1."""
    tangent = float(np.tan(np.deg2rad(camera.fov / 2.0)))
    width, height = float(film.width), float(film.height)
    side = {
        "x": width,
        "y": height,
        "smaller": min(width, height),
        "larger": max(width, height),
        "diagonal": float(np.hypot(width, height)),
    }[camera.fov_axis]
    return tangent * width / side, tangent * height / side


def pinhole_rays(camera: Pinhole, film: Film, x: Array, y: Array) -> Rays:
    """Rays from the eye through the image plane; near and far are planes, so limits of t vary with the direction."""
    across, above = half_extents(camera, film)
    px, py = camera.principal_point
    right = (2.0 * (x / film.width + px) - 1.0) * across
    up = (1.0 - 2.0 * (y / film.height + py)) * above
    local = stacked_columns(right, up, np.ones(len(x)))
    length = np.sqrt(right * right + up * up + 1.0)
    far = np.inf if camera.far is None else camera.far
    return Rays(eye_origins(camera, len(x)), to_world_directions(camera, local), camera.near * length, far * length)


def sensor_xml(kind: str, camera: Camera, numbers: Mapping[str, float], scale: float = 1.0) -> XmlElement:
    """A sensor of Mitsuba, whose x axis points to the left of the image. scale: of the image plane."""
    right, up, forward = camera_axes(camera)
    sensor = Element("sensor", type=kind)
    for name, value in numbers.items():
        SubElement(sensor, "float", name=name, value=repr(float(value)))
    sensor.append(matrix_element(np.array(camera.eye), np.column_stack([-right * scale, up * scale, forward])))
    return sensor


def pinhole_to_xml(camera: Pinhole, film: Film, limits: ClipRange) -> XmlElement:
    px, py = camera.principal_point
    numbers = {
        "fov": float(np.rad2deg(2.0 * np.arctan(half_extents(camera, film)[0]))),
        **clip_planes(camera, limits),
        "principal_point_offset_x": px,
        "principal_point_offset_y": py,
    }
    sensor = sensor_xml("perspective", camera, numbers)
    sensor.insert(0, Element("string", name="fov_axis", value="x"))
    return sensor


def pinhole_random_fields(rng: Rng, size: float, view: RandomView) -> Fields:
    planes = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.3 else {}
    if rng.random() < 0.2:
        planes["far"] = float(size * rng.uniform(2.0, 9.0))
    fov = float(rng.choice([90.0, rng.uniform(5.0, 150.0)]))
    return {**view(), "fov": fov, **planes}


PINHOLE = CameraReference(
    Pinhole,
    pinhole_rays,
    pinhole_to_xml,
    # film positions are rounded when multiplied by the tangent, and offsets when added
    lambda camera, film: 1.0 + max(half_extents(camera, film)) * sum(map(abs, camera.principal_point), 1.0),
    pinhole_random_fields,
)


def orthographic_rays(camera: Orthographic, film: Film, x: Array, y: Array) -> Rays:
    """Parallel rays from a window of the camera's width, with square pixels."""
    pixel = camera.width / film.width
    right, up, forward = camera_axes(camera)
    o = eye_origins(camera, len(x))
    o += np.outer((x - film.width / 2.0) * pixel, right) + np.outer((film.height / 2.0 - y) * pixel, up)
    n, far = len(x), np.inf if camera.far is None else camera.far
    return Rays(o, np.tile(forward, (n, 1)), np.full(n, camera.near), np.full(n, far))


def orthographic_random_fields(rng: Rng, size: float, view: RandomView) -> Fields:
    """Widths such that a pixel is 1/8 to 1/2 of a shape, so that many rays hit edges of lattice shapes exactly."""
    width = size * float(2.0 ** rng.integers(-1, 3))
    near = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.2 else {}
    return {**view(), "width": width, **near}


ORTHOGRAPHIC = CameraReference(
    Orthographic,
    orthographic_rays,
    lambda camera, film, limits: sensor_xml("orthographic", camera, clip_planes(camera, limits), camera.width / 2.0),
    random_fields=orthographic_random_fields,
)


def fisheye_rays(camera: Fisheye, film: Film, x: Array, y: Array) -> Rays:
    """Equidistant fisheye: the angle from the axis is proportional to the distance from the centre of the image."""
    radius = min(film.width, film.height) / 2.0
    right, up = (x - film.width / 2.0) / radius, (film.height / 2.0 - y) / radius
    distance, phi = np.hypot(right, up), np.arctan2(up, right)
    polar = np.deg2rad(camera.fov) / 2.0 * distance
    sine = np.sin(polar)
    local = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(polar)])
    return rays_from_eye(camera, to_world_directions(camera, local), distance <= 1.0)


FISHEYE = CameraReference(
    Fisheye, fisheye_rays, random_fields=lambda rng, size, view: {**view(), "fov": float(rng.uniform(60.0, 360.0))}
)


def panorama_rays(camera: Panorama, film: Film, x: Array, y: Array) -> Rays:
    """Equirectangular: a full turn across the film, half a turn from top to bottom, the view in the middle."""
    azimuth = 2.0 * np.pi * (x - film.width / 2.0) / film.width
    polar = np.pi * y / film.height
    local = np.column_stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)])
    return rays_from_eye(camera, to_world_directions(camera, local), np.ones(len(x), bool))


PANORAMA = CameraReference(Panorama, panorama_rays)


def ray_rays(camera: Ray, film: Film, x: Array, y: Array) -> Rays:
    """The same ray at every film position."""
    count = len(x)
    o, d = (np.tile(np.array(v, np.float64), (count, 1)) for v in (camera.origin, camera.direction))
    return Rays(o, d, np.zeros(count), np.full(count, np.inf if camera.t_max is None else camera.t_max))


def random_ray(rng: Rng, size: float, view: RandomView) -> Fields:
    fields = view()
    return {"origin": fields["eye"], "direction": fields["direction"]}


RAY = CameraReference(Ray, ray_rays, random_fields=random_ray)
