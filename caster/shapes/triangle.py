"""Single triangles, and the edge distances of the triangle kind."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator

from caster.description.fields import UnitVec3, Vec2, Vec3, row
from caster.description.transform import cross, subtract
from caster.geometry.edge_distances import (
    EDGE_ON,
    SCENE_UNITS,
    EdgeDistance,
    dot,
    edge_distances,
    exact,
    nearest_float,
    sqrt_fraction,
    square,
)
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import TriangleShape
from caster.kernels.triangles import Triangles

__all__ = ["Triangle"]


class Triangle(TriangleShape):
    """Three vertices; the normal is (v1 - v0) x (v2 - v0)."""

    type: Literal["triangle"] = "triangle"
    MINIMAL: ClassVar[Mapping[str, Any]] = {"vertices": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))}
    vertices: Annotated[tuple[Vec3, Vec3, Vec3], BeforeValidator(row(3, "3 points"))]  # scene units
    normals: Annotated[tuple[UnitVec3, UnitVec3, UnitVec3], BeforeValidator(row(3, "3 directions"))] | None = None
    uv: Annotated[tuple[Vec2, Vec2, Vec2], BeforeValidator(row(3, "3 pairs [u, v]"))] | None = None

    def mesh(self) -> Mesh:
        return Mesh(
            np.array(self.vertices, np.float64),
            np.array([[0, 1, 2]], np.int32),
            None if self.normals is None else np.array(self.normals, np.float64),
            None if self.uv is None else np.array(self.uv, np.float64),
        )

    def is_flat(self) -> bool:
        return self.normals is None


@edge_distances.register
def _edge_distances(prims: Triangles, k: int, o: np.ndarray, d: np.ndarray) -> tuple[EdgeDistance, ...]:
    """The distance of each edge from the ray, line to line."""
    eye, direction = exact(o), exact(d)
    corners = [subtract(exact(prims.vertices[i]), eye) for i in prims.faces[k]]
    sides = [subtract(corners[(i + 1) % 3], corners[i]) for i in range(3)]
    slope = dot(direction, cross(sides[0], subtract(corners[2], corners[0])))
    if slope == 0:
        return (EdgeDistance(EDGE_ON, 0.0, SCENE_UNITS),)
    found = []
    for i, side in enumerate(sides):
        j = (i + 1) % 3
        volume = dot(direction, cross(corners[i], corners[j])) * (1 if slope > 0 else -1)
        inside = nearest_float(volume / sqrt_fraction(square(cross(direction, side))))
        found.append(EdgeDistance(f"edge {i}-{j}", inside, SCENE_UNITS))
    return tuple(found)
