"""The pinhole (perspective) camera."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

from caster.description.fields import ClippedCamera, FieldOfView, Vec2
from caster.description.transform import tangent
from caster.jit.decorators import implement, inlined
from caster.kernels.math.vec import U, add, dot, l1_norm, scaled, sub
from caster.kernels.protocol import Vec3, camera_ray, project, project_bounding_sphere

# A point is projected only if its depth exceeds this share of its l1 distance: then the rounding of its position moves
# the projection by less than 2^-53 * 1e6 = 1e-10 of the image plane's unit.
MIN_DEPTH_SHARE = 1e-6

# And if it exceeds this, whose inverse is finite.
MIN_INVERTIBLE_DEPTH = 2.0**-1000


class PinholeRays(NamedTuple):
    """Parameters of the pinhole camera for kernels."""

    eye: Vec3  # float64
    right: Vec3  # unit, to the right in the image
    up: Vec3  # unit
    forward: Vec3  # unit
    size: tuple[float, float]  # film width and height in pixels
    half: tuple[float, float]  # half extent of the image plane at distance 1
    shift: tuple[float, float]  # principal point offset, fractions of the film
    near: float
    far: float


class Pinhole(ClippedCamera):
    """A perspective camera. `fov` is measured along `fov_axis` of the whole film, aspect from its size.

    `principal_point` shifts the window by fractions of the film. `near` and `far` are clipping planes; depth is
    measured from the eye.
    """

    type: Literal["pinhole"] = "pinhole"
    shares_origin: ClassVar[bool] = True
    fov: FieldOfView = 45.0
    fov_axis: Literal["x", "y", "diagonal", "smaller", "larger"] = "x"
    principal_point: Vec2 = (0.0, 0.0)  # fractions of the film

    def half_extent(self, width: int, height: int) -> tuple[float, float]:
        """Half width and half height of the image plane at distance 1."""
        aspect = width / height
        tan = tangent(math.radians(self.fov) / 2.0)
        if self.fov_axis == "diagonal":
            x = tan / math.sqrt(1.0 + 1.0 / (aspect * aspect))
        elif self.fov_axis == "y" or self.fov_axis == ("smaller" if aspect >= 1.0 else "larger"):
            x = tan * aspect
        else:
            x = tan
        return x, x / aspect

    def pack(self, width: int, height: int) -> PinholeRays:
        half = self.half_extent(width, height)
        size = (float(width), float(height))
        return PinholeRays(self.eye, *self.frame, size, half, self.principal_point, *self.clip)


@implement(camera_ray, PinholeRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    across = (2.0 * (x / camera.size[0] + camera.shift[0]) - 1.0) * camera.half[0]
    above = (1.0 - 2.0 * (y / camera.size[1] + camera.shift[1])) * camera.half[1]
    # the length of the sum, since right, up and forward are orthonormal
    length = math.sqrt(across * across + above * above + 1.0)
    sideways = add(scaled(across, camera.right), scaled(above, camera.up))
    d = scaled(1.0 / length, add(sideways, camera.forward))
    return camera.eye, d, camera.near * length, camera.far * length


@implement(project, PinholeRays)
def _project(camera: Any, p: Any) -> Any:
    q = sub(p, camera.eye)
    depth, distance = dot(q, camera.forward), l1_norm(q)
    if not depth > max(MIN_DEPTH_SHARE * distance, MIN_INVERTIBLE_DEPTH):
        return 0.0, 0.0, 0.0, depth, False
    closeness = 1.0 / depth
    wide, high = 0.5 * camera.size[0] / camera.half[0], 0.5 * camera.size[1] / camera.half[1]
    x = wide * (dot(q, camera.right) * closeness) + (0.5 - camera.shift[0]) * camera.size[0]
    y = (0.5 - camera.shift[1]) * camera.size[1] - high * (dot(q, camera.up) * closeness)
    return x, y, max(wide, high) * closeness * (1.0 + distance * closeness), depth, True


@implement(project_bounding_sphere, PinholeRays)
def _project_bounding_sphere(camera: Any, center: Any, r: float) -> Any:
    q = sub(center, camera.eye)
    x, y, depth = dot(q, camera.right), dot(q, camera.up), dot(q, camera.forward)
    shallow = not depth - r > max(MIN_DEPTH_SHARE * l1_norm(q), MIN_SQUARABLE_LENGTH)
    if shallow or not l1_norm(q) + r < MAX_SQUARABLE_LENGTH:
        return 0.0, 0.0, 0.0, 0.0, depth - r, False
    low, high = tangents(x, depth, r)
    down, up = tangents(y, depth, r)
    wide, tall = 0.5 * camera.size[0] / camera.half[0], 0.5 * camera.size[1] / camera.half[1]
    across, above = (0.5 - camera.shift[0]) * camera.size[0], (0.5 - camera.shift[1]) * camera.size[1]
    return wide * low + across, above - tall * up, wide * high + across, above - tall * down, depth - r, True


# Between these, products of two lengths in `tangents` neither overflow nor underflow.
MIN_SQUARABLE_LENGTH, MAX_SQUARABLE_LENGTH = 2.0**-400, 2.0**400

# In `tangents`, the errors are: z^2 - r^2 as a product of two sums 3 u, the root 3 u, the sum of the two terms 4 u of
# their magnitudes: 12 u, and the rounding of the quotient.
TANGENT_ERROR = 16.0 * U


@inlined
def tangents(x: float, z: float, r: float) -> tuple[float, float]:
    """The least and the largest x / z on a circle of radius r < z around (x, z), rounded outwards."""
    power = (z - r) * (z + r)
    middle, half = x * z, r * math.sqrt(x * x + power)
    off = TANGENT_ERROR * (abs(middle) + half)
    return (middle - half - off) / power, (middle + half + off) / power
