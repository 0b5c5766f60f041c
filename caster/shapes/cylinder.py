"""An open tube."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.fields import Positive, Shape, Vec3
from caster.kernels.jit import implement
from caster.kernels.protocol import hull_point, hull_size, intersect, prepare, surface
from caster.kernels.roots import ball_roots
from caster.kernels.vec import MISS, add, angle_fraction, row, sub, turned, turned_back, unit
from caster.placing import Rounding, affine_arrays


class Cylinders(NamedTuple):
    """Images of the unit tube x^2 + y^2 = 1, 0 <= z <= 1 under p -> center + to_world p."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


class Cylinder(Shape):
    """The wall of a cylinder around the axis p0-p1, without caps, visible from inside and outside.

    The normal points away from the axis.
    """

    type: Literal["cylinder"] = "cylinder"
    p0: Vec3 = (0.0, 0.0, 0.0)
    p1: Vec3 = (0.0, 0.0, 1.0)
    radius: Positive = 1.0

    @model_validator(mode="after")
    def _has_an_axis(self) -> "Cylinder":
        if self.p0 == self.p1:
            raise ValueError(f"p0 and p1 must be different points, got {list(self.p0)} for both")
        return self

    def pack(self, rounded: Rounding) -> Cylinders:
        linear = self.matrix[:3, :3]
        center = linear @ np.array(self.p0) + self.matrix[:3, 3]
        return Cylinders(*affine_arrays(center, linear @ self._own_axes(), rounded))

    def _own_axes(self) -> np.ndarray:
        """Columns: two radii across the axis, and the axis; right-handed."""
        axis = np.array(self.p1) - np.array(self.p0)
        along = axis / np.linalg.norm(axis)
        if along[0] == along[1] == 0.0 and along[2] > 0.0:
            first = np.array([1.0, 0.0, 0.0])
        else:
            first = np.cross(np.eye(3)[np.argmin(np.abs(along))], along)
            first /= np.linalg.norm(first)
        return np.column_stack([self.radius * first, self.radius * np.cross(along, first), axis])


@implement(prepare, Cylinders)
def _prepare(prims: Any, k: int, o: Any) -> Any:
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    return k, f, f[0] * f[0] + f[1] * f[1] - 1.0


@implement(intersect, Cylinders)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float) -> float:
    k, f, c = pre
    e = turned(prims.to_object, k, d)
    near, far, hit = ball_roots((f[0], f[1], 0.0), (e[0], e[1], 0.0), c, 1.0)
    if not hit:
        return MISS
    z_near, z_far = f[2] + near * e[2], f[2] + far * e[2]
    if near > t_min and z_near >= 0.0 and z_near <= 1.0:
        return near
    return far if far > t_min and z_far >= 0.0 and z_far <= 1.0 else MISS


@implement(surface, Cylinders)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    """u is the angle as a fraction of a turn, v the height along the axis from 0 to 1."""
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    e = turned(prims.to_object, k, d)
    x, y, z = f[0] + t * e[0], f[1] + t * e[1], f[2] + t * e[2]
    length = math.sqrt(x * x + y * y)
    x, y = x / length, y / length
    n = unit(turned_back(prims.to_object, k, (x, y, 0.0)))
    p = add(row(prims.center, k), turned(prims.to_world, k, (x, y, z)))
    return p, n, n, angle_fraction(y, x), z


@implement(hull_size, Cylinders)
def _hull_size(prims: Any) -> int:
    return 8


@implement(hull_point, Cylinders)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    corner = (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.25 * (j & 4))
    return add(row(prims.center, k), turned(prims.to_world, k, corner))
