"""A mesh from a file: OBJ, PLY, STL, OFF or glTF."""

from typing import Any, Literal

from pydantic import field_validator

from caster.geometry.mesh_files import load_mesh, load_once
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import MeshShape

__all__ = ["MeshFile"]


class MeshFile(MeshShape):
    """Triangles of a mesh file; vertex normals are those of the file, or generated, unless face_normals."""

    type: Literal["mesh"] = "mesh"
    file: str

    @field_validator("file")
    @classmethod
    def _is_usable(cls, file: str, info: Any) -> str:
        return info.context.resolve(file, _load) if info.context else file

    def mesh(self) -> Mesh:
        """Read the file; cached until it changes. Raises SceneError, FileMissing."""
        return _load(self.file)


def _load(file: str) -> Mesh:
    return load_once(load_mesh, file)
