"""Pinhole: Mitsuba's perspective sensor."""

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from caster.cameras.pinhole import Pinhole
from caster.scene.model import Film
from mitsuba_ref.cameras.camera_reference import (
    CameraRays,
    CameraReference,
    ClipRange,
    Fields,
    RandomView,
    clip_planes,
    eye_origins,
    sensor_pose,
    to_world_directions,
)
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


def rays(camera: Pinhole, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Rays through points (2 s - 1) tan of the image plane, s the fraction of the film; near and far are planes."""
    across, above = half_extents(camera, film)
    px, py = camera.principal_point
    right = (2.0 * (x / film.width + px) - 1.0) * across
    up = (1.0 - 2.0 * (y / film.height + py)) * above
    local = np.column_stack([right, up, np.ones(len(x))])
    length = np.sqrt(right * right + up * up + 1.0)
    far = np.inf if camera.far is None else camera.far
    return CameraRays(
        eye_origins(camera, len(x)), to_world_directions(camera, local), camera.near * length, far * length
    )


def to_xml(camera: Pinhole, film: Film, limits: ClipRange) -> XmlElement:
    across, _ = half_extents(camera, film)
    sensor = Element("sensor", type="perspective")
    px, py = camera.principal_point
    numbers = {
        "fov": float(np.rad2deg(2.0 * np.arctan(across))),
        **clip_planes(camera, limits),
        "principal_point_offset_x": px,
        "principal_point_offset_y": py,
    }
    SubElement(sensor, "string", name="fov_axis", value="x")
    for name, value in numbers.items():
        SubElement(sensor, "float", name=name, value=repr(float(value)))
    sensor.append(matrix_element(*sensor_pose(camera)))
    return sensor


def amplification(camera: Pinhole, film: Film) -> float:
    """Film positions are rounded where they are multiplied with the tangent, and offsets where they are added."""
    px, py = camera.principal_point
    return 1.0 + max(half_extents(camera, film)) * (1.0 + abs(px) + abs(py))


def random_fields(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    planes = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.3 else {}
    if rng.random() < 0.2:
        planes["far"] = float(size * rng.uniform(2.0, 9.0))
    fov = float(rng.choice([90.0, rng.uniform(5.0, 150.0)]))
    return {**view(), "fov": fov, **planes}


REFERENCE = CameraReference(Pinhole, rays, to_xml, amplification, random_fields)
