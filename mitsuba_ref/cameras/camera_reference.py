"""Declaration of cameras on the judge's side: rays computed a second time, and Mitsuba's sensor if there is one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.description.fields import Camera, Description
from caster.description.transform import dot_rows, row_lengths
from caster.scene.model import Film
from mitsuba_ref.error_model.intersections import stacked_columns, unit
from mitsuba_ref.scene_xml.elements import XmlElement


class CameraRays(NamedTuple):
    """Rays through points of the film, float64. t_max < 0: there is no ray."""

    o: np.ndarray  # (n, 3) the eye, or where the ray leaves the plane through it
    d: np.ndarray  # (n, 3) unit
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)


class ClipRange(NamedTuple):
    """Near and far planes that cut nothing off, for sensors that need them."""

    near: float
    far: float


def clip_planes(camera: Any, limits: ClipRange) -> dict[str, float]:
    """near_clip and far_clip of a sensor: the camera's, or where it has none, the limits; in the right order.

    A near plane beyond the limits, or a far plane before them, moves the other one: Mitsuba refuses near >= far.
    """
    ratio = limits.near / limits.far
    near = camera.near or min(limits.near, np.inf if camera.far is None else camera.far * ratio)
    far = max(limits.far, near / ratio) if camera.far is None else camera.far
    return {"near_clip": near, "far_clip": far}


def no_sensor(camera: Any, film: Film, limits: ClipRange) -> XmlElement | None:
    """For a camera that Mitsuba lacks: its rays are sent instead."""
    return None


Fields = dict[str, Any]  # of a camera, as a scene file gives them
RandomView = Callable[[], Fields]  # draws eye, direction and up


def view_only(rng: np.random.Generator, size: float, view: RandomView) -> Fields:
    """A camera that its view alone varies."""
    return view()


@dataclass(frozen=True)
class CameraReference:
    """One entry of the registry `mitsuba_ref.cameras.REFERENCES`."""

    describes: type[Description]  # of caster.cameras.CAMERAS

    # (description, film, x, y) -> rays through film positions x, y (n,), in pixels
    rays: Callable[[Any, Film, np.ndarray, np.ndarray], CameraRays]

    # (description, film, limits) -> the sensor, still without film
    to_xml: Callable[[Any, Film, ClipRange], XmlElement | None] = no_sensor

    # (description, film) -> how many roundings more than a plain direction the rays of Mitsuba's sensor suffer
    amplification: Callable[[Any, Film], float] = lambda camera, film: 1.0

    # (random generator, size of the scene's shapes, random view) -> the camera's fields, for the fuzzer
    random_fields: Callable[[np.random.Generator, float, RandomView], Fields] = view_only

    # `rays` gives a ray through every position: the image does not end at a rim
    covers_film: bool = False

    @property
    def type_name(self) -> str:
        """What a scene file calls it."""
        name: str = self.describes.model_fields["type"].default
        return name


def camera_axes(camera: Camera) -> np.ndarray:
    """(3, 3) float64, rows right, up, forward: the orthobasis of eye, view and up (Gram-Schmidt)."""
    view = np.array(camera.direction if camera.look_at is None else np.subtract(camera.look_at, camera.eye))
    forward = view / row_lengths(view[None])
    up = np.array(camera.up, np.float64)
    up = up / row_lengths(up[None])
    up = up - dot_rows(up[None], forward) * forward
    up = up / row_lengths(up[None])
    return np.stack([np.cross(forward, up), up, forward])


def to_world_directions(camera: Camera, local: np.ndarray) -> np.ndarray:
    """Local directions (n, 3) right, up, forward -> unit world directions."""
    (x, y, z), axes = local.T, camera_axes(camera).T
    return unit(stacked_columns(*(x * right + y * up + z * forward for right, up, forward in axes)))


def eye_origins(camera: Camera, count: int) -> np.ndarray:
    return np.tile(np.array(camera.eye, np.float64), (count, 1))


def rays_from_eye(camera: Camera, d: np.ndarray, defined: np.ndarray | None = None) -> CameraRays:
    """Rays from the eye without near or far; where `defined` is False there are none."""
    n = len(d)
    t_max = np.full(n, np.inf) if defined is None else np.where(defined, np.inf, -1.0)
    return CameraRays(eye_origins(camera, n), d, np.zeros(n), t_max)


def sensor_pose(camera: Camera, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """(eye, 3x3 matrix) of Mitsuba's sensors, whose x points to the left of the image."""
    right, up, forward = camera_axes(camera)
    return np.array(camera.eye), np.column_stack([-right * scale, up * scale, forward])
