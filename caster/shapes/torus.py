"""A ring of triangles."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from caster.fields import Positive
from caster.mesh import Mesh
from caster.mesh_shape import MeshShape
from caster.procedural import torus

Ring = Annotated[int, Field(ge=3, le=4096)]


class Torus(MeshShape):
    """A tube of radius minor_radius around a circle of radius major_radius in the plane z = 0."""

    type: Literal["torus"] = "torus"
    major_radius: Positive = 1.0
    minor_radius: Positive = 0.3
    segments: Ring = 64
    sides: Ring = 32

    @model_validator(mode="after")
    def _leaves_a_hole(self) -> "Torus":
        if self.minor_radius >= self.major_radius:
            raise ValueError(
                f"minor_radius must be < major_radius {self.major_radius}, got {self.minor_radius}"
            )
        return self

    def mesh(self) -> Mesh:
        return torus(self.major_radius, self.minor_radius, self.segments, self.sides)
