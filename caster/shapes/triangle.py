"""One triangle."""

from typing import Literal

import numpy as np

from caster.description.fields import Shape, UnitVec3, Vec2, Vec3
from caster.geometry.mesh import Mesh
from caster.geometry.world_space import Rounding, transform_mesh
from caster.kernels.triangles import Triangles

__all__ = ["Triangle"]


class Triangle(Shape):
    """Three corners; the normal (v1 - v0) x (v2 - v0) looks at you where they run counter-clockwise."""

    type: Literal["triangle"] = "triangle"
    vertices: tuple[Vec3, Vec3, Vec3]
    normals: tuple[UnitVec3, UnitVec3, UnitVec3] | None = None
    uv: tuple[Vec2, Vec2, Vec2] | None = None

    def mesh(self) -> Mesh:
        return Mesh(
            np.array(self.vertices, np.float64),
            np.array([[0, 1, 2]], np.int32),
            None if self.normals is None else np.array(self.normals, np.float64),
            None if self.uv is None else np.array(self.uv, np.float64),
        )

    def pack(self, rounded: Rounding) -> Triangles:
        return transform_mesh(self.mesh(), self.matrix, rounded, face_normals=self.normals is None)
