"""Declaration of cameras for the judge: rays computed independently, and Mitsuba's sensor if there is one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.description.fields import Camera, Description
from caster.description.transform import dot_rows, row_lengths
from caster.scene.model import Film
from mitsuba_ref.error_model.intersections import Array, Rays, stacked_columns, unit
from mitsuba_ref.scene_xml.elements import XmlElement


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
Rng = np.random.Generator
RandomView = Callable[[], Fields]  # draws eye, direction and up


@dataclass(frozen=True)
class CameraReference:
    """One entry of the registry `mitsuba_ref.cameras.REFERENCES`."""

    describes: type[Description]  # of caster.cameras.CAMERAS

    # (description, film, x, y) -> rays through film positions x, y (n,), in pixels; d of length 1, t_max < 0: no ray
    rays: Callable[[Any, Film, Array, Array], Rays]

    # (description, film, limits) -> the sensor, without its film
    to_xml: Callable[[Any, Film, ClipRange], XmlElement | None] = no_sensor

    # (description, film) -> error of the rays of Mitsuba's sensor, in units of that of a plain direction
    amplification: Callable[[Any, Film], float] = lambda camera, film: 1.0

    # (random generator, size of the scene's shapes, random view) -> the camera's fields, for the fuzzer
    random_fields: Callable[[Rng, float, RandomView], Fields] = lambda rng, size, view: view()

    @property
    def type_name(self) -> str:
        """The `type` in scene files."""
        return self.describes.model_fields["type"].default


def camera_axes(camera: Camera) -> Array:
    """(3, 3) rows right, up, forward: orthonormal basis of view and up (Gram-Schmidt)."""
    view = np.array(camera.direction if camera.look_at is None else np.subtract(camera.look_at, camera.eye))
    forward = view / row_lengths(view[None])
    up = np.array(camera.up, np.float64)
    up = up / row_lengths(up[None])
    up = up - dot_rows(up[None], forward) * forward
    up = up / row_lengths(up[None])
    return np.stack([np.cross(forward, up), up, forward])


def to_world_directions(camera: Camera, local: Array) -> Array:
    """Unit world directions from local directions (n, 3) right, up, forward."""
    (x, y, z), axes = local.T, camera_axes(camera).T
    return unit(stacked_columns(*(x * right + y * up + z * forward for right, up, forward in axes)))


def eye_origins(camera: Camera, count: int) -> Array:
    return np.tile(np.array(camera.eye, np.float64), (count, 1))


def rays_from_eye(camera: Camera, d: Array, defined: Array) -> Rays:
    """Rays from the eye along d (n, 3), without near or far plane; no ray where `defined` (n,) is False."""
    return Rays(eye_origins(camera, len(d)), d, np.zeros(len(d)), np.where(defined, np.inf, -1.0))
