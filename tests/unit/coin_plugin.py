"""A plug-in from outside of caster: a shape with a primitive kind of its own, and a camera."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from caster.cameras import CAMERAS
from caster.description.fields import Camera, Positive, Shape, Vec3
from caster.geometry.world_space import Rounding
from caster.jit.decorators import implement
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import exact_disk
from caster.kernels.math.angles import turn_fraction
from caster.kernels.math.vec import U, add, filter_result, point_at, row, scaled, sub
from caster.kernels.protocol import (
    camera_ray,
    exact_intersect,
    hull_point,
    hull_size,
    intersect,
    load,
    prepare,
    same_geometry,
    surely_misses,
    surface,
)
from caster.shapes import SHAPES


class Coins(NamedTuple):
    """Disks across the z axis."""

    center: np.ndarray  # (n, 3) float64
    radius: np.ndarray  # (n,) float64


@SHAPES.register
class Coin(Shape):
    """A disk of `radius` around `center` in the plane z = center[2]; to_world is ignored."""

    type: Literal["coin"] = "coin"
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 1.0

    def pack(self, rounded: Rounding) -> Coins:
        return Coins(rounded(np.array([self.center])), rounded(np.array([self.radius])))


@implement(load, Coins)
def _load(prims: Any, k: int) -> Any:
    return row(prims.center, k), prims.radius[k]


@implement(prepare, Coins)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    center, radius = prim
    return sub(o, center), radius


@implement(intersect, Coins)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    f, radius = pre
    steep = abs(d[2]) > 1e-3
    t = -f[2] / (d[2] if steep else 1.0)
    off = 8.0 * U * abs(t)
    x, y = f[0] + t * d[0], f[1] + t * d[1]
    outside = math.sqrt(x * x + y * y) / radius - 1.0
    clear = steep & (t - off > t_min) & (t + off < t_max)  # the rest is decided exactly
    return filter_result(clear & (outside < -1e-6), clear & (outside > 1e-6), t, off)


@implement(surely_misses, Coins)
def _surely_misses(prims: Any, pre: Any, d: Any) -> bool:
    return False


@implement(same_geometry, Coins)
def _same_geometry(prims: Any, k: int, j: int) -> bool:
    return False


@implement(exact_intersect, Coins)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_disk(row(prims.center, k), prims.radius[k] * np.eye(3), o, d, t_min, t_max)


@implement(surface, Coins)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    """uv as a disk's: distance from the centre over the radius, and angle as a fraction of a turn."""
    n = (0.0, 0.0, 1.0)
    x, y, _ = scaled(1.0 / prims.radius[k], sub(point_at(o, t, d), row(prims.center, k)))
    return point_at(o, t, d), n, n, math.sqrt(x * x + y * y), turn_fraction(y, x) if wants_uv else 0.0


@implement(hull_size, Coins)
def _hull_size(prims: Any) -> int:
    return 4


@implement(hull_point, Coins)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    r = prims.radius[k]
    return add(row(prims.center, k), (r * (1.0 - 2.0 * (j & 1)), r * (1.0 - (j & 2)), 0.0))


class ScannerRays(NamedTuple):
    """The scanner as its kernel reads it."""

    eye: tuple[float, float, float]
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    forward: tuple[float, float, float]
    spacing: float  # scene units per pixel
    center: tuple[float, float]  # of the film, in pixels


@CAMERAS.register
class Scanner(Camera):
    """Parallel rays, `spacing` scene units apart."""

    type: Literal["scanner"] = "scanner"
    spacing: Positive = 0.125
    shares_origin: ClassVar[bool] = False

    def pack(self, width: int, height: int) -> ScannerRays:
        return ScannerRays(self.eye, *self.frame, self.spacing, (0.5 * width, 0.5 * height))


@implement(camera_ray, ScannerRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    across, above = (x - camera.center[0]) * camera.spacing, (camera.center[1] - y) * camera.spacing
    start = add(camera.eye, add(scaled(across, camera.right), scaled(above, camera.up)))
    return start, camera.forward, 0.0, math.inf
