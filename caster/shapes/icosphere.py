"""A ball of triangles, nearly equal in size."""

from typing import Annotated, Literal

from pydantic import Field

from caster.geometry.mesh import Mesh
from caster.geometry.procedural import icosphere
from caster.geometry.world_space import MeshShape

__all__ = ["Icosphere"]


class Icosphere(MeshShape):
    """The unit sphere as an icosahedron whose faces are split in four `subdivisions` times."""

    type: Literal["icosphere"] = "icosphere"
    subdivisions: Annotated[int, Field(ge=0, le=8)] = 3

    def mesh(self) -> Mesh:
        return icosphere(self.subdivisions)
