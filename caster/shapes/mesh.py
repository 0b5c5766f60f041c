"""A mesh from a file: OBJ, PLY, STL, OFF or glTF."""

from typing import Literal

from caster.geometry.mesh_files import load_mesh, load_once
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import MeshShape

__all__ = ["MeshFile"]


class MeshFile(MeshShape):
    """Triangles of a mesh file; vertex normals are those of the file, or generated, unless face_normals."""

    type: Literal["mesh"] = "mesh"
    file: str

    def load(self) -> Mesh:
        """Read the file; cached until it changes. Raises SceneError, FileMissing."""
        return load_once(load_mesh, self.file)

    def mesh(self) -> Mesh:
        """The mesh of the file, in object space."""
        return self.load()
