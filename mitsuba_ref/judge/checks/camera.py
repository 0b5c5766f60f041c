"""Checks of the camera: our rays against independent formulas, and against Mitsuba's own sensor."""

import numpy as np

from caster.rendering.images import camera_rays
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes, no_sensor
from mitsuba_ref.error_model.intersections import Array, dot, norm, without_float_warnings, without_overflow_warnings
from mitsuba_ref.error_model.tolerances import CAMERA_ROUNDINGS, KU, KU_OURS
from mitsuba_ref.judge.checks import Found, check, worst_pixel
from mitsuba_ref.reference.rendering import ReferenceResult
from mitsuba_ref.reference.shared_input import pixel_centers


@check(scope="window", camera=True)
def check_camera(scene: Scene) -> Found:
    """Compare our float64 rays with an independent implementation of the camera's formula."""
    ours, (x, y) = camera_rays(scene), pixel_centers(scene)
    expected = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)
    size = float(np.abs(expected.o).max(initial=np.finfo(np.float64).tiny))
    forward, up = camera_axes(scene.camera)[2], np.array(scene.camera.up, np.float64)
    sine = np.linalg.norm(np.cross(forward, up)) / np.linalg.norm(up)  # rounding of the axes grows by its inverse
    rounding = CAMERA_ROUNDINGS * KU_OURS / float(sine)
    seen = expected.t_max >= 0.0
    shares = {
        "rays there are": np.where(seen == (ours.t_max >= 0.0), 0.0, np.inf),
        "origin": norm(ours.o - expected.o) / (rounding * size),
        "direction": norm(ours.d - expected.d) / rounding,
        "near": _relative(ours.t_min, expected.t_min) / rounding,
        "far": _relative(ours.t_max, expected.t_max) / rounding,
    }
    return worst_pixel(shares, scene, (seen | (ours.t_max >= 0.0)) & ~_on_rim(scene, x, y))


def _on_rim(scene: Scene, x: Array, y: Array) -> Array:
    """(n,) bool: pixels so near the edge of an image circle that rounding decides whether they have a ray."""
    film, reference = scene.film, reference_of_camera(scene.camera)
    middle_x, middle_y = film.width / 2.0, film.height / 2.0
    inner, outer = (
        reference.rays(scene.camera, film, middle_x + scale * (x - middle_x), middle_y + scale * (y - middle_y)).t_max
        for scale in (1.0 - KU_OURS, 1.0 + KU_OURS)
    )
    return (inner >= 0.0) != (outer >= 0.0)


@check(scope="window", camera=True)
@without_overflow_warnings
def check_sensor(scene: Scene, result: ReferenceResult) -> Found:
    """Compare our rays with those of Mitsuba's own sensor: the same line, and depth that starts on the near plane."""
    sensor = result.answer.sensor.astype(np.float64)
    if not len(sensor):
        expected = reference_of_camera(scene.camera).to_xml is not no_sensor
        what = "the answer lacks its rays" if expected else f"Mitsuba has no {scene.camera.type} camera"
        return np.inf if expected else 0.0, what
    ours, reference = camera_rays(scene), reference_of_camera(scene.camera)
    o, d, t_max = sensor[:, :3], sensor[:, 3:6], sensor[:, 6]
    bound = KU * reference.amplification(scene.camera, scene.film)
    along = dot(o - ours.o, ours.d)
    aside = norm(o - ours.o - along[:, None] * ours.d)
    size = norm(ours.o) + np.abs(along) + np.abs(scene.camera.eye).max() + getattr(scene.camera, "width", 0.0)
    shares = {"direction": norm(d - ours.d) / bound, "origin": aside / (bound * size)}
    if getattr(scene.camera, "near", 0.0) > 0.0:
        shares["near"] = np.abs(along - ours.t_min) / (bound * (size + ours.t_min))
    if getattr(scene.camera, "far", None) is not None:
        end = along + t_max
        shares["far"] = np.abs(end - ours.t_max) / (bound * (size + ours.t_max))
    return worst_pixel(shares, scene)


@without_float_warnings
def _relative(ours: Array, expected: Array) -> Array:
    error = np.abs(ours - expected) / np.maximum(np.abs(expected), np.finfo(np.float64).tiny)
    return np.where(ours == expected, 0.0, error)
