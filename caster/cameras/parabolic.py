"""The parabolic camera: a hemisphere seen in a parabolic mirror."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.fields import Camera
from caster.kernels.camera_circle import film_circle, mixed, on_circle
from caster.kernels.jit import implement
from caster.kernels.protocol import Vec3, ray
from caster.kernels.vec import unit


class ParabolicRays(NamedTuple):
    """The parabolic camera as its kernel reads it."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    circle: Vec3  # image circle: centre x, centre y, radius, in pixels


class Parabolic(Camera):
    """The hemisphere in front of the eye as a paraboloid mirror shows it; outside its circle there is no ray.

    The image point (x, y) of the unit disk sees (2 x, 2 y, 1 - x^2 - y^2) / (1 + x^2 + y^2) (Heidrich and
    Seidel 1998, dual paraboloid maps).
    """

    type: Literal["parabolic"] = "parabolic"
    shares_origin: ClassVar[bool] = True

    def pack(self, width: int, height: int) -> ParabolicRays:
        right, up, forward = self.frame
        return ParabolicRays(self.eye, right, up, forward, film_circle(width, height))


@implement(ray, ParabolicRays)
def _ray(camera: Any, x: float, y: float) -> Any:
    across, above = on_circle(camera.circle, x, y)
    square = across * across + above * above
    d = unit(mixed(camera, 2.0 * across, 2.0 * above, 1.0 - square))
    if square > 1.0:
        return camera.eye, camera.forward, 0.0, -1.0
    return camera.eye, d, 0.0, math.inf
