"""A filled circle; under a to_world that stretches it, a filled ellipse."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from caster.fields import Shape
from caster.kernels.jit import implement
from caster.kernels.protocol import hull_point, hull_size, intersect, prepare, surface
from caster.kernels.vec import MISS, add, angle_fraction, row, sub, turned, turned_back, unit
from caster.placing import Rounding, affine_arrays


class Disks(NamedTuple):
    """Images of the unit disk z = 0 under p -> center + to_world p."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


class Disk(Shape):
    """The unit disk in the plane z = 0, facing +z, visible from both sides; placed by to_world."""

    type: Literal["disk"] = "disk"

    def pack(self, rounded: Rounding) -> Disks:
        return Disks(*affine_arrays(self.matrix[:3, 3], self.matrix[:3, :3], rounded))


@implement(prepare, Disks)
def _prepare(prims: Any, k: int, o: Any) -> Any:
    return k, turned(prims.to_object, k, sub(o, row(prims.center, k)))


@implement(intersect, Disks)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float) -> float:
    k, f = pre
    e = turned(prims.to_object, k, d)
    if e[2] == 0.0:  # edge-on: the disk has no thickness to hit
        return MISS
    t = -f[2] / e[2]
    x, y = f[0] + t * e[0], f[1] + t * e[1]
    return t if t > t_min and x * x + y * y <= 1.0 else MISS


@implement(surface, Disks)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    """u is the distance from the centre, v the angle as a fraction of a turn."""
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    e = turned(prims.to_object, k, d)
    x, y = f[0] + t * e[0], f[1] + t * e[1]
    n = unit(turned_back(prims.to_object, k, (0.0, 0.0, 1.0)))
    p = add(row(prims.center, k), turned(prims.to_world, k, (x, y, 0.0)))
    return p, n, n, math.sqrt(x * x + y * y), angle_fraction(y, x)


@implement(hull_size, Disks)
def _hull_size(prims: Any) -> int:
    return 4


@implement(hull_point, Disks)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return add(row(prims.center, k), turned(prims.to_world, k, (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 0.0)))
