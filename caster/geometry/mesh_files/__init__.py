"""Readers of mesh files, OBJ and PLY. Strict: a face lost silently is a wrong image."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path

from caster.description.errors import SceneError
from caster.description.input_files import MAX_MESH_BYTES, read_input
from caster.geometry.mesh_files.obj import parse_obj
from caster.geometry.mesh_files.ply import parse_ply
from caster.geometry.triangle_mesh import Mesh, check_mesh, normalize_rows

FORMATS: dict[str, Callable[[bytes, str], Mesh]] = {".obj": parse_obj, ".ply": parse_ply}


def load_mesh(path: str | PathLike[str]) -> Mesh:
    """Read a mesh file: Wavefront OBJ or PLY (ascii, binary of either byte order), selected by its suffix.

    Polygons become fans of triangles around their first corner. Normals come out with unit length, None where
    the file has none; the v of an OBJ's uv is turned over (1 - v), as Mitsuba does it.
    Raises FileMissing for a file that cannot be read, SceneError for one that is not a usable mesh.
    """
    where = str(path)
    parse = _parser_for(where)
    data = read_input(where, "mesh file", MAX_MESH_BYTES)
    if not data:
        raise SceneError(f"{where}: the file is empty (0 bytes): expected a mesh; export or copy it again")
    mesh = parse(data, where)
    check_mesh(mesh, where)
    return mesh if mesh.normals is None else mesh._replace(normals=normalize_rows(mesh.normals))


def _parser_for(where: str) -> Callable[[bytes, str], Mesh]:
    ending = Path(where).suffix
    parse = FORMATS.get(ending.lower())
    if parse is None:
        expected = " or ".join(FORMATS)
        raise SceneError(f"{where}: unknown mesh format '{ending}': expected {expected}; convert it first")
    return parse
