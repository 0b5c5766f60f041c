"""The square and the cube; with to_world rectangles, boxes and parallelepipeds."""

from typing import Literal

import numpy as np

from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import TriangleShape

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 3], [1, 2, 3]], np.int32)


class Rectangle(TriangleShape):
    """The square [-1, 1]^2 in the plane z = 0 with normal +z, as two triangles."""

    type: Literal["rectangle"] = "rectangle"

    def mesh(self) -> Mesh:
        return Mesh(SQUARE, FACES, None, 0.5 * SQUARE[:, :2] + 0.5)


# The four corners of each side, counter-clockwise from outside, by the signs of x, y, z. Sides, corners and
# the diagonal between the first and third follow Mitsuba's cube: a prim_id means the same triangle there.
CORNERS = """
    +-- +-+ --+ ---
    ++- -+- -++ +++
    +-- ++- +++ +-+
    +-+ +++ -++ --+
    --+ -++ -+- ---
    ++- +-- --- -+-
"""


def _sides() -> Mesh:
    corners = np.array([[float(sign + "1") for sign in corner] for corner in CORNERS.split()])
    first = np.arange(0, 24, 4, dtype=np.int32)
    faces = first[:, None, None] + np.array([[0, 1, 2], [3, 0, 2]], np.int32)
    uv = np.tile([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], (6, 1))
    return Mesh(corners, faces.reshape(-1, 3), None, uv)


CUBE_MESH = _sides()


class Cube(TriangleShape):
    """The cube [-1, 1]^3 as twelve flat-shaded triangles."""

    type: Literal["cube"] = "cube"

    def mesh(self) -> Mesh:
        return CUBE_MESH
