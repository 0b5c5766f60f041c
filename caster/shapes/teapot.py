"""Newell's teapot."""

from typing import Annotated, Literal

from pydantic import Field

from caster.geometry.mesh import Mesh
from caster.geometry.procedural import teapot
from caster.geometry.world_space import MeshShape

__all__ = ["Teapot"]


class Teapot(MeshShape):
    """The 32 published Bezier patches, each cut into 2 subdivisions^2 triangles; z is up."""

    type: Literal["teapot"] = "teapot"
    subdivisions: Annotated[int, Field(ge=1, le=64)] = 8

    def mesh(self) -> Mesh:
        return teapot(self.subdivisions)
