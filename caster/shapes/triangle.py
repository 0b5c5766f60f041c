"""Single triangles."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from caster.description.fields import Flag, RowOf, UnitVec3, Vec2, Vec3
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import TriangleShape


class Triangle(TriangleShape):
    """Three vertices; the normal is (v1 - v0) x (v2 - v0)."""

    type: Literal["triangle"] = "triangle"
    MINIMAL: ClassVar[Mapping[str, Any]] = {"vertices": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))}
    vertices: Annotated[Any, RowOf(Vec3, 3, "3 points")]  # scene units
    normals: Annotated[Any, RowOf(UnitVec3, 3, "3 directions")] | None = None
    uv: Annotated[Any, RowOf(Vec2, 3, "3 pairs [u, v]")] | None = None
    flip_normals: Flag = False

    def mesh(self) -> Mesh:
        return Mesh(
            np.array(self.vertices, np.float64),
            np.array([[0, 1, 2]], np.int32),
            None if self.normals is None else np.array(self.normals, np.float64),
            None if self.uv is None else np.array(self.uv, np.float64),
        )
