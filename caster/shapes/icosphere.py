"""A tessellated sphere: an icosahedron whose faces are split in four repeatedly."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from caster.geometry.triangle_mesh import Mesh, normalize_rows
from caster.geometry.world_space import MeshShape

GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0

# Three golden rectangles at right angles, and the faces between their corners.
SIGNS = [(-1, 1), (1, 1), (-1, -1), (1, -1)]
CORNERS = (
    *((a, b * GOLDEN, 0) for a, b in SIGNS),
    *((0, a, b * GOLDEN) for a, b in SIGNS),
    *((b * GOLDEN, 0, a) for a, b in SIGNS),
)
FACES = """
    0 11 5   0 5 1    0 1 7    0 7 10   0 10 11
    1 5 9    5 11 4   11 10 2  10 7 6   7 1 8
    3 9 4    3 4 2    3 2 6    3 6 8    3 8 9
    4 9 5    2 4 11   6 2 10   8 6 7    9 8 1
"""


class Icosphere(MeshShape):
    """The unit sphere, tessellated: an icosahedron subdivided `subdivisions` times."""

    type: Literal["icosphere"] = "icosphere"
    subdivisions: Annotated[int, Field(strict=True, ge=0, le=8)] = 3  # 1,310,720 faces at most

    def mesh(self) -> Mesh:
        """20 * 4^subdivisions faces with shared vertices; the normals are the positions. 0 gives an icosahedron."""
        vertices = normalize_rows(np.array(CORNERS))
        faces = np.array(FACES.split(), np.int32).reshape(-1, 3)
        for _ in range(self.subdivisions):  # each face in four; the two faces of an edge share its new midpoint
            ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
            edges, middle = np.unique(ends, axis=0, return_inverse=True)
            a, b, c = faces.T
            ab, bc, ca = (len(vertices) + middle.reshape(-1, 3)).T
            quarters = np.transpose([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)], (2, 0, 1))
            middles = normalize_rows(vertices[edges[:, 0]] + vertices[edges[:, 1]])
            vertices, faces = np.concatenate([vertices, middles]), quarters.reshape(-1, 3).astype(np.int32)
        return Mesh(vertices, faces, vertices.copy())
