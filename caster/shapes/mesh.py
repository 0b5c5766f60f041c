"""Triangle meshes: a file (OBJ, PLY, STL, OFF or glTF), or arrays."""

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from caster.description.errors import SceneError, join_words
from caster.description.fields import Faces, Flag, Points, UVs
from caster.geometry import triangle_mesh
from caster.geometry.mesh_files import load_mesh, load_once, readable
from caster.geometry.world_space import MeshShape

__all__ = ["Mesh"]


class Mesh(MeshShape):
    """Triangles from arrays or from a mesh file. Vertex normals are the given ones, or generated, unless face_normals.

    `vertices` (n, 3) and `faces` (m, 3), numbers of vertices, counter-clockwise seen from outside; `normals` (n, 3), of
    any length, and `uv` (n, 2) may be None. Arrays are copied. Or `file`: a path.
    """

    type: Literal["mesh"] = "mesh"
    ARRAYS: ClassVar[tuple[str, ...]] = ("vertices", "faces", "normals", "uv")
    vertices: Points | None = None  # scene units
    faces: Faces | None = None
    normals: Points | None = None
    uv: UVs | None = None
    file: Annotated[str | None, readable(load_mesh)] = None  # OBJ, PLY, STL, OFF or glTF
    flip_normals: Flag = False

    if TYPE_CHECKING:

        def __init__(
            self,
            vertices: ArrayLike | None = None,
            faces: ArrayLike | None = None,
            normals: ArrayLike | None = None,
            uv: ArrayLike | None = None,
            *,
            file: str | None = None,
            name: str = "",
            material: str = "",
            to_world: Any = (),
            face_normals: bool = False,
            flip_normals: bool = False,
        ) -> None: ...

    else:

        def __init__(self, *arrays: ArrayLike | None, **fields: Any) -> None:
            super().__init__(**dict(zip(self.ARRAYS[: len(arrays)], arrays, strict=True)), **fields)

        __init__.__pydantic_base_init__ = True  # as of Description

    @classmethod
    def from_trimesh(cls, mesh: Any, **fields: Any) -> Self:
        """The triangles of a `trimesh.Trimesh` with its uv, if any; normals are generated. fields: as of Mesh."""
        return cls(mesh.vertices, mesh.faces, uv=getattr(mesh.visual, "uv", None), **fields)

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        given = [name for name in self.ARRAYS if getattr(self, name) is not None]
        if self.file is not None and given:
            raise ValueError(f"needs either file or arrays, got file and {join_words(given, 'and')}")
        if self.file is None:
            if self.vertices is None or self.faces is None:
                raise ValueError(f"needs file, or vertices and faces, got {join_words(given or ['none'], 'and')}")
            for name, rows in (("normals", self.normals), ("uv", self.uv)):
                if rows is not None and len(rows) != len(self.vertices):
                    raise ValueError(f"{name} must have {len(self.vertices)} rows, one a vertex, got {len(rows)}")
            try:
                triangle_mesh.check_mesh(self._arrays, "")
            except SceneError as error:
                raise ValueError(str(error).removeprefix(": ")) from None
        return self

    @cached_property
    def _arrays(self) -> triangle_mesh.Mesh:
        normals = None if self.normals is None else triangle_mesh.normalize_rows(np.asarray(self.normals))
        uv = None if self.uv is None else np.asarray(self.uv)
        return triangle_mesh.Mesh(np.asarray(self.vertices), np.array(self.faces, np.int32), normals, uv)

    def mesh(self) -> triangle_mesh.Mesh:
        """The arrays; those of a file are cached until it changes. Raises SceneError, FileMissing."""
        return self._arrays if self.file is None else load_once(load_mesh, self.file)
