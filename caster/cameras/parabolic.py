"""The parabolic camera: a hemisphere reflected in a parabolic mirror."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.description.fields import Camera
from caster.jit.decorators import implement
from caster.kernels.math.vec import hypotenuse
from caster.kernels.protocol import Vec3, camera_ray, distortion_bound, project, project_bounding_sphere
from caster.kernels.raster.wide_angle import (
    film_circle,
    hull_distortion_bound,
    off_film,
    ray_along,
    sphere_in_camera_space,
    to_circle_units,
    unknown_projection,
)

__all__ = ["Parabolic"]


class ParabolicRays(NamedTuple):
    """Parameters of the parabolic camera for kernels."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    circle: Vec3  # image circle: centre x, centre y, radius, in pixels


class Parabolic(Camera):
    """The hemisphere in front of the eye, reflected in a paraboloid; pixels outside its circle have no ray.

    The image point (x, y) of the unit disk maps to (2 x, 2 y, 1 - x^2 - y^2) / (1 + x^2 + y^2) (Heidrich and
    Seidel 1998, dual paraboloid maps).
    """

    type: Literal["parabolic"] = "parabolic"
    shares_origin: ClassVar[bool] = True

    def pack(self, width: int, height: int) -> ParabolicRays:
        return ParabolicRays(self.eye, *self.frame, film_circle(width, height))


@implement(camera_ray, ParabolicRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    across, above = to_circle_units(camera.circle, x, y)
    square = across * across + above * above
    return ray_along(camera, (2.0 * across, 2.0 * above, 1.0 - square), square <= 1.0)


@implement(project_bounding_sphere, ParabolicRays)
def _project_bounding_sphere(camera: Any, center: Any, r: float) -> Any:
    """Bounding box of a circle: the stereographic projection maps circles to circles.

    At angle a from the axis it is tan(a / 2) from the centre. The tangent of the sum of two angles is
    (s + t) / (1 - s t) for their own tangents s and t.
    """
    place, distance, valid = sphere_in_camera_space(camera, center, r)
    if not valid:
        return unknown_projection(distance - r)
    if place[2] < -r:  # entirely behind the eye
        return off_film(distance - r)
    # its centre is at most 90 + 28 degrees from the axis, so divisors are bounded away from 0
    aside = hypotenuse(place[0], place[1])
    share = r / distance
    middle, wide = aside / (distance + place[2]), share / (1.0 + math.sqrt(1.0 - share * share))
    inner, outer = (middle - wide) / (1.0 + middle * wide), (middle + wide) / (1.0 - middle * wide)
    across, above = (place[0] / aside, place[1] / aside) if aside > 0.0 else (1.0, 0.0)
    x, y, pixels = camera.circle
    at, reach = 0.5 * (inner + outer) * pixels, 0.5 * (outer - inner) * pixels
    x, y = x + at * across, y - at * above
    return x - reach, y - reach, x + reach, y + reach, distance - r, True


@implement(project, ParabolicRays)
def _project(camera: Any, p: Any) -> Any:
    place, distance, valid = sphere_in_camera_space(camera, p, 0.0)
    ahead = distance + place[2]
    if not valid or place[2] < MIN_AXIS_COSINE * distance:
        return 0.0, 0.0, 0.0, distance, False
    x, y, pixels = camera.circle
    share = pixels / ahead
    return x + share * place[0], y - share * place[1], MAX_STRETCH * pixels / distance, distance, True


# The least cosine of the angle from the axis that `project` accepts, 169 degrees: at r radii from the centre it is
# (1 - r^2) / (1 + r^2), so r < 10 and a small step is stretched by (1 + r^2) / 2; eight times that for a finite step.
# Closer to straight backwards, distance + place[2] is dominated by rounding.
MIN_AXIS_COSINE, MAX_STRETCH = -0.98, 401.0


@implement(distortion_bound, ParabolicRays)
def _distortion_bound(camera: Any, extent: float) -> Any:
    """Angles are at most twice the distances in the image, in radii, since the projection shrinks by at most 2.

    Along great circles the second derivative of the projection is r (1 + r^2) / 2 at r radii from the centre, at most
    1.25 within MAX_HULL_ANGLE of the film, where r < tan(pi / 4 + MAX_HULL_ANGLE / 2); see wide_angle.BULGE_FACTOR.
    """
    return hull_distortion_bound(2.0 * extent / camera.circle[2], 1.25 * camera.circle[2])
