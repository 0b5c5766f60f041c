"""A tessellated torus around the z axis."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from caster.description.fields import Positive
from caster.description.transform import sine_and_cosine
from caster.geometry.triangle_mesh import Floats, Mesh, grid_faces
from caster.geometry.world_space import MeshShape


def _circle(parts: int) -> Floats:
    """(2, parts) sines and cosines of the parts of a turn."""
    angles = 2.0 * math.pi * np.arange(parts) / parts
    return np.array([sine_and_cosine(angle) for angle in angles.tolist()]).T


PartCount = Annotated[int, Field(strict=True, ge=3, le=4096)]  # 4096 * 4096 * 2 faces at most


class Torus(MeshShape):
    """The torus of tube radius minor_radius around a circle of radius major_radius in the plane z = 0.

    segments: parts around z; sides: parts around the tube.
    """

    type: Literal["torus"] = "torus"
    major_radius: Positive = 1.0  # scene units
    minor_radius: Positive = 0.3  # scene units
    segments: PartCount = 64
    sides: PartCount = 32

    @model_validator(mode="after")
    def _leaves_a_hole(self) -> "Torus":
        if self.minor_radius >= self.major_radius:
            raise ValueError(f"minor_radius must be < major_radius {self.major_radius}, got {self.minor_radius}")
        return self

    def mesh(self) -> Mesh:
        """2 * segments * sides faces with shared vertices, no seam and no uv; the normals are the exact torus's."""
        (sine, cosine), (rise, level) = _circle(self.segments)[:, :, None], _circle(self.sides)[:, None, :]
        x, y = cosine * level, sine * level
        normals = np.stack([x, y, np.broadcast_to(rise, x.shape)], axis=2)
        middle = np.stack([cosine, sine, np.zeros_like(sine)], axis=2)
        vertices = self.major_radius * middle + self.minor_radius * normals
        number = np.arange(x.size, dtype=np.int32).reshape(x.shape)
        pairs = grid_faces(np.pad(number, (0, 1), "wrap")).reshape(-1, 2, 3)  # the last row and column join the first
        faces = pairs[:, ::-1, [0, 2, 1]].reshape(-1, 3)  # rows run around z, columns up
        return Mesh(vertices.reshape(-1, 3), faces, normals.reshape(-1, 3))
