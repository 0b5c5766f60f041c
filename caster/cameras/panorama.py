"""The equirectangular panorama: longitude across, latitude up."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.fields import Camera
from caster.kernels.camera_circle import mixed
from caster.kernels.jit import implement
from caster.kernels.protocol import Vec3, ray
from caster.kernels.vec import unit


class PanoramaRays(NamedTuple):
    """The panorama camera as its kernel reads it."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    size: tuple[float, float]  # film width and height in pixels


class Panorama(Camera):
    """All directions: the centre of the film looks forward, its side borders meet behind, up is on top."""

    type: Literal["panorama"] = "panorama"
    shares_origin: ClassVar[bool] = True

    def pack(self, width: int, height: int) -> PanoramaRays:
        right, up, forward = self.frame
        return PanoramaRays(self.eye, right, up, forward, (float(width), float(height)))


@implement(ray, PanoramaRays)
def _ray(camera: Any, x: float, y: float) -> Any:
    longitude = (2.0 * (x / camera.size[0]) - 1.0) * math.pi
    latitude = (0.5 - y / camera.size[1]) * math.pi
    level = math.cos(latitude)
    d = unit(mixed(camera, level * math.sin(longitude), math.sin(latitude), level * math.cos(longitude)))
    return camera.eye, d, 0.0, math.inf
