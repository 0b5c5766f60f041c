"""An infinite plane."""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.fields import Number, Shape, UnitVec3, Vec3
from caster.kernels.jit import implement
from caster.kernels.protocol import hull_point, hull_size, intersect, prepare, surface
from caster.kernels.vec import MISS, along, cross, dot, row, sub, unit
from caster.placing import Rounding


class Planes(NamedTuple):
    """All p with normal . (p - point) = 0."""

    normal: np.ndarray  # (n, 3) float64, of about unit length
    point: np.ndarray  # (n, 3) float64


class Plane(Shape):
    """The plane through `point` across `normal`, or all p with normal . p = `offset` (normal made unit)."""

    type: Literal["plane"] = "plane"
    normal: UnitVec3 = (0.0, 0.0, 1.0)
    offset: Number | None = None
    point: Vec3 | None = None

    @model_validator(mode="after")
    def _has_one_place(self) -> "Plane":
        if (self.offset is None) == (self.point is None):
            got = "both" if self.point else "neither"
            raise ValueError(f"needs either offset or point, got {got}")
        return self

    def pack(self, rounded: Rounding) -> Planes:
        n = np.array(self.normal)
        point = np.array(self.point) if self.point is not None else self.offset * n
        linear = self.matrix[:3, :3]
        turned = n @ np.linalg.inv(linear)
        placed = linear @ point + self.matrix[:3, 3]
        return Planes(rounded(turned / np.linalg.norm(turned))[None], rounded(placed)[None])


@implement(prepare, Planes)
def _prepare(prims: Any, k: int, o: Any) -> Any:
    n = row(prims.normal, k)
    return n, dot(n, sub(row(prims.point, k), o))


@implement(intersect, Planes)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float) -> float:
    n, height = pre
    slope = dot(n, d)
    if slope == 0.0:  # seen edge-on: a plane has no thickness to hit
        return MISS
    t = height / slope
    return t if t > t_min else MISS


@implement(surface, Planes)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    """uv are distances from `point` along two axes of the plane, in scene units."""
    n = unit(row(prims.normal, k))
    p = along(o, t, d)
    side = (1.0, 0.0, 0.0) if abs(n[0]) < 0.5 else (0.0, 1.0, 0.0)
    right = unit(cross(side, n))
    q = sub(p, row(prims.point, k))
    return p, n, n, dot(q, right), dot(q, cross(n, right))


@implement(hull_size, Planes)
def _hull_size(prims: Any) -> int:
    return 0


@implement(hull_point, Planes)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return row(prims.point, k)
