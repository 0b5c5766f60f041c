"""Cameras for the judge: rays computed independently, and Mitsuba's sensor of those that it has."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from caster.cameras import Fisheye, Orthographic, Panorama, Parabolic, Pinhole, Ray
from caster.description.fields import Camera, Description
from caster.description.transform import dot_rows, row_lengths
from caster.scene.model import Film
from mitsuba_ref.error_model.intersections import stacked_columns, unit
from mitsuba_ref.scene_xml.elements import XmlElement, matrix_element


class CameraRays(NamedTuple):
    """Rays through n points of the film, float64. t_max < 0: no ray."""

    o: np.ndarray  # (n, 3) the eye, or points of the plane through it
    d: np.ndarray  # (n, 3) unit
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)


class ClipRange(NamedTuple):
    """Near and far planes beyond everything in the scene, for sensors that require some."""

    near: float
    far: float


def clip_planes(camera: Any, limits: ClipRange) -> dict[str, float]:
    """near_clip and far_clip of a sensor: the camera's own, or else `limits`.

    If the camera's near plane lies beyond limits.far, or its far plane before limits.near, the other plane is moved, as
    Mitsuba refuses near >= far.
    """
    ratio = limits.near / limits.far
    near = camera.near or min(limits.near, np.inf if camera.far is None else camera.far * ratio)
    far = max(limits.far, near / ratio) if camera.far is None else camera.far
    return {"near_clip": near, "far_clip": far}


def no_sensor(camera: Any, film: Film, limits: ClipRange) -> XmlElement | None:
    """No sensor: Mitsuba lacks the camera, and is sent its rays instead."""
    return None


Fields = dict[str, Any]  # of a camera, as a scene file gives them
RandomView = Callable[[], Fields]  # draws eye, direction and up


def view_only(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    """Random fields of a camera: its view alone."""
    return view()


@dataclass(frozen=True)
class CameraReference:
    """One entry of the registry `mitsuba_ref.cameras.REFERENCES`."""

    describes: type[Description]  # of caster.cameras.CAMERAS

    # (description, film, x, y) -> rays through film positions x, y (n,), in pixels
    rays: Callable[[Any, Film, np.ndarray, np.ndarray], CameraRays]

    # (description, film, limits) -> the sensor, without its film
    to_xml: Callable[[Any, Film, ClipRange], XmlElement | None] = no_sensor

    # (description, film) -> error of the rays of Mitsuba's sensor, in units of that of a plain direction
    amplification: Callable[[Any, Film], float] = lambda camera, film: 1.0

    # (random generator, size of the scene's shapes, random view) -> the camera's fields, for the fuzzer
    random_fields: Callable[[np.random.Generator, float, RandomView], Fields] = view_only

    # whether there is a ray through every film position, unlike for an image that ends at a circle
    covers_film: bool = False

    @property
    def type_name(self) -> str:
        """The `type` in scene files."""
        return self.describes.model_fields["type"].default


def camera_axes(camera: Camera) -> np.ndarray:
    """(3, 3) rows right, up, forward: orthonormal basis of view and up (Gram-Schmidt)."""
    view = np.array(camera.direction if camera.look_at is None else np.subtract(camera.look_at, camera.eye))
    forward = view / row_lengths(view[None])
    up = np.array(camera.up, np.float64)
    up = up / row_lengths(up[None])
    up = up - dot_rows(up[None], forward) * forward
    up = up / row_lengths(up[None])
    return np.stack([np.cross(forward, up), up, forward])


def to_world_directions(camera: Camera, local: np.ndarray) -> np.ndarray:
    """Unit world directions from local directions (n, 3) right, up, forward."""
    (x, y, z), axes = local.T, camera_axes(camera).T
    return unit(stacked_columns(*(x * right + y * up + z * forward for right, up, forward in axes)))


def eye_origins(camera: Camera, count: int) -> np.ndarray:
    return np.tile(np.array(camera.eye, np.float64), (count, 1))


def rays_from_eye(camera: Camera, d: np.ndarray, defined: np.ndarray | None = None) -> CameraRays:
    """Rays from the eye along d (n, 3), without near or far plane; no ray where `defined` is False."""
    n = len(d)
    t_max = np.full(n, np.inf) if defined is None else np.where(defined, np.inf, -1.0)
    return CameraRays(eye_origins(camera, n), d, np.zeros(n), t_max)


def sensor_pose(camera: Camera, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """(eye, 3x3 matrix) for Mitsuba's sensors, whose x axis points to the left of the image."""
    right, up, forward = camera_axes(camera)
    return np.array(camera.eye), np.column_stack([-right * scale, up * scale, forward])


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


def pinhole_rays(camera: Pinhole, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Rays from the eye through the image plane; near and far are planes, so limits of t vary with the direction."""
    across, above = half_extents(camera, film)
    px, py = camera.principal_point
    right = (2.0 * (x / film.width + px) - 1.0) * across
    up = (1.0 - 2.0 * (y / film.height + py)) * above
    local = stacked_columns(right, up, np.ones(len(x)))
    length = np.sqrt(right * right + up * up + 1.0)
    far = np.inf if camera.far is None else camera.far
    return CameraRays(
        eye_origins(camera, len(x)), to_world_directions(camera, local), camera.near * length, far * length
    )


def sensor_xml(kind: str, numbers: Mapping[str, float], pose: tuple[np.ndarray, np.ndarray]) -> XmlElement:
    sensor = Element("sensor", type=kind)
    for name, value in numbers.items():
        SubElement(sensor, "float", name=name, value=repr(float(value)))
    sensor.append(matrix_element(*pose))
    return sensor


def pinhole_to_xml(camera: Pinhole, film: Film, limits: ClipRange) -> XmlElement:
    px, py = camera.principal_point
    numbers = {
        "fov": float(np.rad2deg(2.0 * np.arctan(half_extents(camera, film)[0]))),
        **clip_planes(camera, limits),
        "principal_point_offset_x": px,
        "principal_point_offset_y": py,
    }
    sensor = sensor_xml("perspective", numbers, sensor_pose(camera))
    sensor.insert(0, Element("string", name="fov_axis", value="x"))
    return sensor


def pinhole_amplification(camera: Pinhole, film: Film) -> float:
    """Film positions are rounded when multiplied by the tangent, and offsets when added."""
    px, py = camera.principal_point
    return 1.0 + max(half_extents(camera, film)) * (1.0 + abs(px) + abs(py))


def pinhole_random_fields(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    planes = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.3 else {}
    if rng.random() < 0.2:
        planes["far"] = float(size * rng.uniform(2.0, 9.0))
    fov = float(rng.choice([90.0, rng.uniform(5.0, 150.0)]))
    return {**view(), "fov": fov, **planes}


PINHOLE = CameraReference(
    Pinhole, pinhole_rays, pinhole_to_xml, pinhole_amplification, pinhole_random_fields, covers_film=True
)


def orthographic_rays(camera: Orthographic, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Parallel rays from a window of the camera's width, with square pixels."""
    pixel = camera.width / film.width
    right, up, forward = camera_axes(camera)
    o = eye_origins(camera, len(x))
    o += np.outer((x - film.width / 2.0) * pixel, right) + np.outer((film.height / 2.0 - y) * pixel, up)
    n, far = len(x), np.inf if camera.far is None else camera.far
    return CameraRays(o, np.tile(forward, (n, 1)), np.full(n, camera.near), np.full(n, far))


def orthographic_to_xml(camera: Orthographic, film: Film, limits: ClipRange) -> XmlElement:
    return sensor_xml("orthographic", clip_planes(camera, limits), sensor_pose(camera, camera.width / 2.0))


def orthographic_random_fields(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    """Widths such that a pixel is 1/8 to 1/2 of a shape, so that many rays hit edges of lattice shapes exactly."""
    width = size * float(2.0 ** rng.integers(-1, 3))
    near = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.2 else {}
    return {**view(), "width": width, **near}


ORTHOGRAPHIC = CameraReference(
    Orthographic, orthographic_rays, orthographic_to_xml, random_fields=orthographic_random_fields, covers_film=True
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
