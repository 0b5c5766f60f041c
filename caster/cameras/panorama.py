"""The equirectangular panorama."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.description.fields import Camera
from caster.jit.decorators import implement
from caster.kernels.math.angles import arcsine, arctangent, sinc_and_cos
from caster.kernels.math.vec import hypotenuse
from caster.kernels.protocol import Vec3, camera_ray, distortion_bound, project, project_bounding_sphere
from caster.kernels.raster.wide_angle import hull_distortion_bound, ray_along, sphere_in_camera_space

# The sine of half the range of longitudes of a sphere is its radius over the horizontal distance of its centre. Near 1,
# the angle is far more sensitive than the quotient, whose error is a few u: the quotient is widened by this factor.
ASIN_SENSITIVITY = 1.0 + 2.0**-40


class PanoramaRays(NamedTuple):
    """Parameters of the panorama camera for kernels."""

    eye: Vec3  # float64
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    size: tuple[float, float]  # film width and height in pixels


class Panorama(Camera):
    """All directions: the centre of the film looks forward, its side borders backwards, the upper border up."""

    type: Literal["panorama"] = "panorama"
    shares_origin: ClassVar[bool] = True

    def pack(self, width: int, height: int) -> PanoramaRays:
        return PanoramaRays(self.eye, *self.frame, (float(width), float(height)))


@implement(camera_ray, PanoramaRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    # h is half of the longitude: sin 2h = 2 sin h cos h, cos 2h = 1 - 2 sin^2 h
    half = (x / camera.size[0] - 0.5) * math.pi
    latitude = (0.5 - y / camera.size[1]) * math.pi
    sine, cosine = sinc_and_cos(half * half)
    rise, level = sinc_and_cos(latitude * latitude)
    east, ahead = 2.0 * half * sine * cosine, 1.0 - 2.0 * half * half * sine * sine
    return ray_along(camera, (level * east, latitude * rise, level * ahead), True)


@implement(project_bounding_sphere, PanoramaRays)
def _project_bounding_sphere(camera: Any, center: Any, r: float) -> Any:
    """Rows between the extreme latitudes; all columns if the sphere contains a pole or crosses the seam."""
    place, distance, valid = sphere_in_camera_space(camera, center, r)
    if not valid:
        return 0.0, 0.0, 0.0, 0.0, distance - r, False
    level = hypotenuse(place[0], place[2])
    latitude, reach = arctangent(place[1], level), arcsine(r / distance)
    wide, high = camera.size[0] / (2.0 * math.pi), camera.size[1] / math.pi
    top, bottom = high * (0.5 * math.pi - latitude - reach), high * (0.5 * math.pi - latitude + reach)
    share = r * ASIN_SENSITIVITY / level if level > 0.0 else 1.0
    longitude, reach = arctangent(place[0], place[2]), arcsine(share) if share < 1.0 else math.inf
    if abs(longitude) + reach > math.pi:
        return -math.inf, top, math.inf, bottom, distance - r, True
    x = camera.size[0] * 0.5 + wide * longitude
    return x - wide * reach, top, x + wide * reach, bottom, distance - r, True


# Points closer to a pole or to the seam are not projected; bounding spheres of primitives are. Within MAX_HULL_ANGLE of
# a projected point, longitudes differ by at most 0.25, so that no hull crosses the seam.
MAX_LATITUDE_SINE, MAX_LONGITUDE = 0.5 * math.sqrt(3.0), math.pi - 0.3


@implement(project, PanoramaRays)
def _project(camera: Any, p: Any) -> Any:
    place, distance, valid = sphere_in_camera_space(camera, p, 0.0)
    longitude, rise = arctangent(place[0], place[2]), place[1] / (distance if valid else 1.0)
    if not valid or abs(longitude) > MAX_LONGITUDE or abs(rise) > MAX_LATITUDE_SINE:
        return 0.0, 0.0, 0.0, distance, False
    wide, high = camera.size[0] / (2.0 * math.pi), camera.size[1] / math.pi
    x, y = 0.5 * camera.size[0] + wide * longitude, 0.5 * camera.size[1] - high * arcsine(rise)
    return x, y, MAX_STRETCH * max(wide, high) / distance, distance, True


# A degree of longitude is at least half as long as one of latitude there; twice that for a finite step.
MAX_STRETCH = 4.0


@implement(distortion_bound, PanoramaRays)
def _distortion_bound(camera: Any, extent: float) -> Any:
    """Angles are at most distances in the image; see wide_angle.BULGE_FACTOR.

    Along great circles the second derivative of the longitude is at most sin a / cos^2 a at latitude a, and that of the
    latitude tan a: 5.4 and 2.3 at pi / 3 + MAX_HULL_ANGLE.
    """
    wide, high = camera.size[0] / (2.0 * math.pi), camera.size[1] / math.pi
    return hull_distortion_bound(extent / min(wide, high), hypotenuse(5.4 * wide, 2.3 * high))
