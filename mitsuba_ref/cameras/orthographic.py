"""Orthographic: Mitsuba's sensor of that name, whose window is [-1, 1] wide until it is scaled."""

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from caster.cameras.orthographic import Orthographic
from caster.scene.model import Film
from mitsuba_ref.cameras.camera_reference import (
    CameraRays,
    CameraReference,
    ClipRange,
    Fields,
    RandomView,
    camera_axes,
    clip_planes,
    eye_origins,
    sensor_pose,
)
from mitsuba_ref.scene_xml.elements import XmlElement, matrix_element


def rays(camera: Orthographic, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """Parallel rays, from a window of the camera's width whose pixels are square."""
    pixel = camera.width / film.width
    right, up, forward = camera_axes(camera)
    o = eye_origins(camera, len(x))
    o += np.outer((x - film.width / 2.0) * pixel, right) + np.outer((film.height / 2.0 - y) * pixel, up)
    n, far = len(x), np.inf if camera.far is None else camera.far
    return CameraRays(o, np.tile(forward, (n, 1)), np.full(n, camera.near), np.full(n, far))


def to_xml(camera: Orthographic, film: Film, limits: ClipRange) -> XmlElement:
    sensor = Element("sensor", type="orthographic")
    for name, value in clip_planes(camera, limits).items():
        SubElement(sensor, "float", name=name, value=repr(float(value)))
    sensor.append(matrix_element(*sensor_pose(camera, camera.width / 2.0)))
    return sensor


def random_fields(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    """On the fuzzer's lattice a pixel is an eighth to a half of a shape wide, so that many rays hit edges exactly."""
    width = size * float(2.0 ** rng.integers(-1, 3))
    near = {"near": float(size * rng.uniform(0.0, 1.5))} if rng.random() < 0.2 else {}
    return {**view(), "width": width, **near}


REFERENCE = CameraReference(Orthographic, rays, to_xml, random_fields=random_fields)
