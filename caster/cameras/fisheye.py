"""The equidistant fisheye: the angle from the axis is proportional to the distance from the image centre."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.description.fields import Camera, WideFieldOfView
from caster.jit.decorators import implement, inlined
from caster.kernels.math.angles import arcsine, arctangent, sinc_and_cos, sine_and_cosine_of
from caster.kernels.math.vec import hypotenuse
from caster.kernels.protocol import Vec3, camera_ray, distortion_bound, project, project_bounding_sphere
from caster.kernels.raster.wide_angle import (
    ANGLE_ROUNDING,
    MAX_HULL_ANGLE,
    hull_distortion_bound,
    ray_along,
    sphere_in_camera_space,
)


class FisheyeRays(NamedTuple):
    """Parameters of the fisheye camera for kernels."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    circle: Vec3  # image circle: centre x, centre y, radius, in pixels
    half_angle: float  # radians from the axis to the rim
    bend: float  # bound of second derivatives of the projection within MAX_HULL_ANGLE of the film


class Fisheye(Camera):
    """`fov` degrees across the circle inscribed in the film; pixels outside the circle have no ray."""

    type: Literal["fisheye"] = "fisheye"
    shares_origin: ClassVar[bool] = True
    fov: WideFieldOfView = 180.0

    def pack(self, width: int, height: int) -> FisheyeRays:
        circle = 0.5 * width, 0.5 * height, 0.5 * min(width, height)
        half = math.radians(self.fov) / 2.0
        most = curvature_bound(half + MAX_HULL_ANGLE) if half + MAX_HULL_ANGLE < MAX_PROJECTED_ANGLE else math.inf
        return FisheyeRays(self.eye, *self.frame, circle, half, most)


@implement(camera_ray, FisheyeRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    middle_x, middle_y, radius = camera.circle
    across, above = (x - middle_x) / radius, (middle_y - y) / radius
    square, half = across * across + above * above, 0.5 * camera.half_angle
    inside = square <= 1.0
    # h = half * distance is half the angle from the axis: sin 2h = 2 sin h cos h, cos 2h = 1 - 2 sin^2 h
    h_square = half * half * (square if inside else 0.0)
    sine, cosine = sinc_and_cos(h_square)
    sideways = 2.0 * half * sine * cosine
    return ray_along(camera, (sideways * across, sideways * above, 1.0 - 2.0 * h_square * sine * sine), inside)


# Closer to straight backwards, which projects to a whole circle, `project_bounding_sphere` returns no bounds.
MAX_PROJECTED_ANGLE = 3.1  # radians from the axis


@implement(project_bounding_sphere, FisheyeRays)
def _project_bounding_sphere(camera: Any, center: Any, r: float) -> Any:
    """Bounding box of an ellipse around the projected centre, widened by a bound of the distortion.

    F is the projection and p a direction; p may be `reach` from the centre c. Along the great circle from c to p,
    F(p) = F(c) + dF(v) + R with |v| <= reach, where dF stretches v by 1 away from the axis and by angle / sin(angle)
    across that, and |R| <= bend reach^2 / 2.
    """
    place, distance, valid = sphere_in_camera_space(camera, center, r)
    aside = hypotenuse(place[0], place[1])
    angle, reach = arctangent(aside, place[2]), arcsine(r / distance if valid else 0.0)
    if valid and angle - reach > camera.half_angle + ANGLE_ERROR:
        return math.inf, math.inf, -math.inf, -math.inf, distance - r, True  # off the film
    if not valid or angle + reach > MAX_PROJECTED_ANGLE:
        return 0.0, 0.0, 0.0, 0.0, distance - r, False
    off_axis = aside > MIN_AXIS_SINE * distance
    across, above = (place[0] / aside, place[1] / aside) if off_axis else (1.0, 0.0)
    around = reach * max(angle * distance / aside, 1.0) if off_axis else reach
    x, y, radius = camera.circle
    pixels = radius / camera.half_angle
    more = 0.5 * reach * reach * curvature_bound(angle + reach) + ANGLE_ROUNDING
    wide = pixels * (hypotenuse(reach * across, around * above) + more)
    high = pixels * (hypotenuse(reach * above, around * across) + more)
    x, y = x + pixels * angle * across, y - pixels * angle * above
    return x - wide, y - high, x + wide, y + high, distance - r, True


ANGLE_ERROR = 2.0**-40  # radians; roundings of angles are below 2^-48
MIN_AXIS_SINE = 2.0**-100  # sine of an angle below all rounding of the projection; squares of less may underflow
MIN_CURVATURE_ANGLE = 0.5  # radians; the bound is monotonic and 0 / 0 at 0, so smaller angles use this one


@inlined
def curvature_bound(angle: float) -> float:
    """Bound of the second derivative of the projection along great circles, up to an angle from the axis.

    In polar coordinates, a for the angle from the axis and w for the azimuth, a great circle at speed 1 has
    a'' = sin a cos a w'^2 and w'' = -2 cot a a' w'. The second derivative of a (cos w, sin w) is then
    w'^2 (sin a cos a - a) outwards and 2 a' w' (1 - a cot a) around, with |w'| <= 1 / sin a and |a' w'| <= 1 / 2 sin a.
    """
    a = max(angle, MIN_CURVATURE_ANGLE)
    sine, cosine = sine_and_cosine_of(a)
    return (a - sine * cosine) / (sine * sine) + (1.0 - a * cosine / sine) / sine


@implement(project, FisheyeRays)
def _project(camera: Any, p: Any) -> Any:
    place, distance, valid = sphere_in_camera_space(camera, p, 0.0)
    aside = hypotenuse(place[0], place[1])
    angle = arctangent(aside, place[2])
    if not valid or angle > MAX_PROJECTED_ANGLE:
        return 0.0, 0.0, 0.0, distance, False
    x, y, radius = camera.circle
    pixels = radius / camera.half_angle
    share = pixels * angle / aside if aside > 0.0 else 0.0
    return x + share * place[0], y - share * place[1], MAX_STRETCH * pixels / distance, distance, True


# Around the axis, a small step is stretched by angle / sin(angle), 75 at MAX_PROJECTED_ANGLE; twice that for a
# finite step.
MAX_STRETCH = 150.0


@implement(distortion_bound, FisheyeRays)
def _distortion_bound(camera: Any, extent: float) -> Any:
    """Angles are at most the distances in the image over pixels per radian; see wide_angle.BULGE_FACTOR."""
    pixels = camera.circle[2] / camera.half_angle
    return hull_distortion_bound(extent / pixels, camera.bend * pixels)
