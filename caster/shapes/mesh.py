"""A mesh from a file: OBJ, PLY, STL, OFF or glTF."""

import functools
import os
from typing import Literal

from caster.geometry.mesh_files import load_mesh
from caster.geometry.triangle_mesh import Mesh
from caster.geometry.world_space import MeshShape

__all__ = ["MeshFile"]


class MeshFile(MeshShape):
    """Triangles of a mesh file; vertex normals are those of the file, or generated, unless face_normals."""

    type: Literal["mesh"] = "mesh"
    file: str

    def load(self) -> Mesh:
        """Read the file; cached until it changes. Raises SceneError, FileMissing."""
        try:
            stamp = os.stat(self.file)
        except OSError:
            return load_mesh(self.file)  # raises the error
        return _loaded(self.file, stamp.st_mtime_ns, stamp.st_size)

    def mesh(self) -> Mesh:
        """The mesh of the file, in object space."""
        return self.load()


@functools.lru_cache(maxsize=16)
def _loaded(path: str, changed: int, size: int) -> Mesh:
    return load_mesh(path)
