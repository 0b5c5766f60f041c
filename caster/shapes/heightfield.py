"""A hilly landscape of triangles."""

from typing import Annotated, Literal

from pydantic import Field

from caster.description.fields import NonNegative, Positive
from caster.geometry.mesh import Mesh
from caster.geometry.procedural import heightfield
from caster.geometry.world_space import MeshShape

__all__ = ["Heightfield"]


class Heightfield(MeshShape):
    """A square of side `size` around the origin in x and y, its height a seeded sum of sine waves."""

    type: Literal["heightfield"] = "heightfield"
    size: Positive = 2.0
    resolution: Annotated[int, Field(ge=1, le=4096)] = 64
    amplitude: NonNegative = 0.2
    waves: Annotated[int, Field(ge=1, le=64)] = 8
    seed: Annotated[int, Field(ge=0)] = 0

    def mesh(self) -> Mesh:
        return heightfield(self.size, self.resolution, self.amplitude, self.waves, self.seed)
