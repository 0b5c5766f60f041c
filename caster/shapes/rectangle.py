"""The square; with to_world a rectangle or parallelogram."""

from typing import Literal

import numpy as np

from caster.description.fields import Shape
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import Rounding, transform_mesh
from caster.kernels.triangles import Triangles

__all__ = ["Rectangle"]

CORNERS = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 3], [1, 2, 3]], np.int32)


class Rectangle(Shape):
    """The square [-1, 1]^2 in the plane z = 0 with normal +z, as two triangles."""

    type: Literal["rectangle"] = "rectangle"

    def mesh(self) -> Mesh:
        return Mesh(CORNERS, FACES, None, 0.5 * CORNERS[:, :2] + 0.5)

    def pack(self, rounded: Rounding) -> Triangles:
        return transform_mesh(self.mesh(), self.matrix, rounded, face_normals=True)
