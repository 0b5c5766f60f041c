"""The equidistant fisheye: the angle from the axis grows evenly with the distance from the image centre."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.fields import Camera, WideFieldOfView
from caster.kernels.camera_circle import film_circle, mixed, on_circle
from caster.kernels.jit import implement
from caster.kernels.protocol import Vec3, ray
from caster.kernels.vec import unit


class FisheyeRays(NamedTuple):
    """The fisheye camera as its kernel reads it."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    circle: Vec3  # image circle: centre x, centre y, radius, in pixels
    half_angle: float  # radians from the axis to the rim


class Fisheye(Camera):
    """`fov` degrees across the circle inscribed in the film; pixels outside the circle have no ray."""

    type: Literal["fisheye"] = "fisheye"
    shares_origin: ClassVar[bool] = True
    fov: WideFieldOfView = 180.0

    def pack(self, width: int, height: int) -> FisheyeRays:
        right, up, forward = self.frame
        circle = film_circle(width, height)
        return FisheyeRays(self.eye, right, up, forward, circle, math.radians(self.fov) / 2.0)


@implement(ray, FisheyeRays)
def _ray(camera: Any, x: float, y: float) -> Any:
    across, above = on_circle(camera.circle, x, y)
    distance = math.sqrt(across * across + above * above)
    if distance == 0.0 or distance > 1.0:
        return camera.eye, camera.forward, 0.0, math.inf if distance == 0.0 else -1.0
    angle = distance * camera.half_angle
    sideways = math.sin(angle) / distance
    d = unit(mixed(camera, sideways * across, sideways * above, math.cos(angle)))
    return camera.eye, d, 0.0, math.inf
