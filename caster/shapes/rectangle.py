"""The square; with to_world a rectangle or parallelogram."""

from typing import Literal

import numpy as np

from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import TriangleShape

__all__ = ["Rectangle"]

CORNERS = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 3], [1, 2, 3]], np.int32)


class Rectangle(TriangleShape):
    """The square [-1, 1]^2 in the plane z = 0 with normal +z, as two triangles."""

    type: Literal["rectangle"] = "rectangle"

    def mesh(self) -> Mesh:
        return Mesh(CORNERS, FACES, None, 0.5 * CORNERS[:, :2] + 0.5)
