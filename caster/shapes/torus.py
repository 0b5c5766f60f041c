"""A ring of triangles."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from caster.description.fields import Positive
from caster.geometry.mesh import Mesh
from caster.geometry.procedural import torus
from caster.geometry.world_space import MeshShape

__all__ = ["Torus"]

PartCount = Annotated[int, Field(ge=3, le=4096)]


class Torus(MeshShape):
    """A tube of radius minor_radius around a circle of radius major_radius in the plane z = 0."""

    type: Literal["torus"] = "torus"
    major_radius: Positive = 1.0
    minor_radius: Positive = 0.3
    segments: PartCount = 64
    sides: PartCount = 32

    @model_validator(mode="after")
    def _leaves_a_hole(self) -> "Torus":
        if self.minor_radius >= self.major_radius:
            raise ValueError(
                f"minor_radius must be < major_radius {self.major_radius}, got {self.minor_radius}"
            )
        return self

    def mesh(self) -> Mesh:
        return torus(self.major_radius, self.minor_radius, self.segments, self.sides)
