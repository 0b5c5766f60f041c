"""Readers of mesh files: OBJ, PLY and OFF in this package, STL and glTF by trimesh.

The readers are strict: a face that is dropped silently would be a wrong image.
"""

import io
import itertools
import json
import os
import struct
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from pydantic import AfterValidator

from caster.description.errors import FileMissing, SceneError, field_error, format_value
from caster.description.input_files import MAX_MESH_BYTES, MESH_SUFFIXES, FileName, read_input
from caster.description.transform import compose, is_mirrored, rotations, scale, transform_points, translate
from caster.geometry.mesh_files.obj import parse_obj
from caster.geometry.mesh_files.ply import parse_off, parse_ply, parse_ply_spheres
from caster.geometry.triangle_mesh import Mesh, check_mesh, normalize_rows

__all__ = ["load_points"]


def load_mesh(path: FileName) -> Mesh:
    """Read a mesh file: Wavefront OBJ, PLY (ascii or binary), STL, OFF or glTF, by its suffix.

    Polygons become fans of triangles around their first corner. Normals have unit length; they are None if the file
    has none. The v of an OBJ's uv becomes 1 - v, as in Mitsuba. STL, OFF and glTF files give triangles without normals
    and uv; the meshes of a glTF scene become one mesh in world space.
    Raises FileMissing for a file that cannot be read, SceneError for one that is not a usable mesh.
    """
    where = str(path)
    ending = Path(where).suffix.lower()
    readers = {".obj": parse_obj, ".ply": parse_ply, ".off": parse_off}
    parse = readers.get(ending, _parse_by_trimesh if ending in MESH_SUFFIXES else None)
    if parse is None:
        expected = f"{', '.join(MESH_SUFFIXES[:-1])} or {MESH_SUFFIXES[-1]}"
        raise SceneError(f"{where}: unknown mesh format '{Path(where).suffix}': expected {expected}; convert it first")
    data = read_input(where, "mesh file", MAX_MESH_BYTES)
    if not data:
        raise SceneError(f"{where}: the file is empty (0 bytes): expected a mesh; export or copy it again")
    mesh = parse(data, where)
    check_mesh(mesh, where)
    return mesh if mesh.normals is None else mesh._replace(normals=normalize_rows(mesh.normals))


def load_points(path: FileName) -> tuple[Any, Any]:
    """Read the vertices of a PLY file as spheres: centres (n, 3), and radii (n,) if it has the property `radius`.

    Raises FileMissing for a file that cannot be read, SceneError that names the first vertex that is not a sphere.
    """
    return parse_ply_spheres(read_input(str(path), "file of points", MAX_MESH_BYTES), str(path))


Loaded = TypeVar("Loaded")
Reader = Callable[[str], Any]  # of a file by its path


def load_once(load: Callable[[str], Loaded], path: str) -> Loaded:
    """load(path); the result is kept until the file changes."""
    try:
        stamp = os.stat(path)
    except OSError:
        return load(path)  # raises the error
    return cast(Loaded, _loaded(load, path, stamp.st_mtime_ns, stamp.st_size))


@lru_cache(maxsize=16)
def _loaded(load: Reader, path: str, changed: int, size: int) -> Any:
    return load(path)


def readable(load: Reader) -> AfterValidator:
    """For a field that is the path of a file, if any: resolves it where there are folders to be in; `load` reads it."""

    def resolved(file: str | None, info: Any) -> str | None:
        return info.context.resolve(file, load) if file is not None and info.context else file

    return AfterValidator(resolved)


class MeshFolders(NamedTuple):
    """The folders that mesh files of a scene may be in or below: its own, and those of --mesh-dir."""

    folder: Path
    mesh_dirs: tuple[Path, ...] = ()

    def resolve(self, file: str, load: Reader) -> str:
        """The absolute path of a file that `load` can read, links resolved; the error of the field if there is none."""
        if "\0" in file:
            raise field_error(f"must have no NUL character, got {format_value(file)}")
        folders = (self.folder, *self.mesh_dirs)
        allowed = [os.path.realpath(folder) for folder in folders]
        paths = (Path(os.path.realpath(folder / file)) for folder in folders)
        tried = list(dict.fromkeys(path for path in paths if any(path.is_relative_to(each) for each in allowed)))
        if not tried:
            mesh_dir = os.path.dirname(os.path.normpath(self.folder / file)) or "."
            expected = "in the scene's folder, below it, or below a folder given by --mesh-dir"
            raise field_error(f"must lie {expected}, got {format_value(file)}: add --mesh-dir {mesh_dir}")
        where = str(next((path for path in tried if path.exists()), tried[0]))
        try:
            load_once(load, where)
        except SceneError as error:
            text = f"cannot be used: {str(error).removeprefix(f'{where}: ').replace(where, file)}"
            missing = isinstance(error, FileMissing)
            if missing:
                text += f"; tried {', '.join(map(str, tried))}: if it is elsewhere, add --mesh-dir FOLDER"
            raise field_error(text, missing_file=missing) from None
        return where


def _parse_by_trimesh(data: bytes, where: str) -> Mesh:
    """Read triangles by trimesh, without merging, reordering or repairing anything. Raises SceneError."""
    try:
        import trimesh
    except ImportError:
        raise SceneError(
            f"{where}: trimesh, which reads {Path(where).suffix}, is not installed: pip install trimesh; "
            "or convert the file to PLY or OBJ"
        ) from None
    kind = Path(where).suffix[1:].lower()
    if kind == "stl" and b"facet" not in data[:1024].lower():
        facets = int.from_bytes(data[80:84], "little")
        if len(data) != 84 + 50 * facets:  # of a binary file
            raise SceneError(
                f"{where}: binary STL: expected {84 + 50 * facets} bytes, 84 and 50 for each of {facets} facets, "
                f"got {len(data)}; copy or export it again"
            )
    beside = trimesh.resolvers.FilePathResolver(where) if kind == "gltf" else None
    try:
        scene = trimesh.load_scene(
            io.BytesIO(_rotations_as_matrices(data, kind)),
            file_type=kind,
            resolver=beside,
            process=False,
            maintain_order=True,
        )
        vertices, faces = _placed(scene, trimesh.Trimesh)
    except MemoryError:
        raise
    except Exception as error:  # whatever a foreign parser raises
        raise SceneError(
            f"{where}: not a usable {kind.upper()} file: {type(error).__name__}: {error}; export it again"
        ) from error
    return Mesh(np.ascontiguousarray(vertices), np.ascontiguousarray(faces.reshape(-1, 3), np.int32))


def _placed(scene: Any, mesh_class: type[Any]) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces) of all meshes of a scene, in world space.

    trimesh would multiply matrices by a BLAS, whose last bits depend on the processor.
    """
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    edges = scene.graph.transforms.edge_data
    for node in scene.graph.nodes_geometry:
        mesh = scene.geometry[scene.graph.transforms.node_data[node]["geometry"]]
        if not isinstance(mesh, mesh_class):
            continue
        path = scene.graph.transforms.shortest_path(scene.graph.base_frame, node)
        matrix = compose(edges[step].get("matrix", np.eye(4)) for step in reversed(list(itertools.pairwise(path))))
        points = np.asarray(mesh.vertices, np.float64)
        vertices.append(points if np.array_equal(matrix, np.eye(4)) else transform_points(matrix, points))
        faces.append(count + np.asarray(mesh.faces)[:, :: -1 if is_mirrored(matrix) else 1])
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


GLB_HEADER = struct.Struct("<4sIIII")  # magic, version, length of all; length and type of the first chunk, the JSON


def _rotations_as_matrices(data: bytes, kind: str) -> bytes:
    """Replace node rotations of a glTF file by matrices, since trimesh normalises quaternions with BLAS.

    A malformed file is returned unchanged, so that trimesh reports the error.
    """
    if b'"rotation"' not in data:
        return data
    try:
        if kind == "gltf":
            return _rewritten(data)
        magic, version, _, size, chunk = GLB_HEADER.unpack_from(data)
        start = GLB_HEADER.size
        text = _rewritten(data[start : start + size])
        text += b" " * (-len(text) % 4)
        rest = data[start + size :]
        return GLB_HEADER.pack(magic, version, start + len(text) + len(rest), len(text), chunk) + text + rest
    except Exception:  # trimesh reports the error
        return data


def _rewritten(text: bytes) -> bytes:
    content = json.loads(text)
    for node in content["nodes"]:
        if "rotation" in node and "matrix" not in node:
            turn = np.eye(4)
            with np.errstate(all="raise"):
                turn[:3, :3] = rotations(np.array([node.pop("rotation")], np.float64))[0]
            steps = scale(node.pop("scale", 1.0)), turn, translate(node.pop("translation", (0.0, 0.0, 0.0)))
            node["matrix"] = compose(steps).T.ravel().tolist()  # column by column
    return json.dumps(content).encode()
