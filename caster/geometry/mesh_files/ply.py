"""Reader of PLY files: the elements `vertex` and `face` become a mesh; others are ignored."""

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.geometry.mesh import Floats, Mesh, format_row, triangle_fans
from caster.geometry.mesh_files.ply_body import read_ascii, read_binary
from caster.geometry.mesh_files.ply_header import Lists, Table, parse_header

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
CORNERS = ("vertex_indices", "vertex_index")


def parse_ply(data: bytes, where: str) -> Mesh:
    """Bytes of a PLY file -> Mesh, with the file's vertices in its order. Raises SceneError with `where`."""
    header = parse_header(data, where)
    tables = (read_binary if header.byte_order else read_ascii)(data, header, where)
    for name in ("vertex", "face"):
        if name not in tables:
            got = ", ".join(tables) or "none"
            raise SceneError(f"{where}: expected elements vertex and face, got no '{name}' (but: {got})")
    vertices = _floats(tables["vertex"], POSITION, where)
    return Mesh(
        vertices,
        _faces(tables["face"], len(vertices), where),
        _normals(tables["vertex"], where),
        _uv(tables["vertex"], where),
    )


def _floats(table: Table, names: tuple[str, ...], where: str) -> Floats:
    """(n, len(names)) of the columns `names`, all required."""
    columns = [table.columns.get(name) for name in names]
    scalars = [column for column in columns if isinstance(column, np.ndarray)]
    if len(scalars) < len(names):
        expected, got = ", ".join(names), ", ".join(table.columns)
        raise SceneError(f"{where}: expected the properties {expected} of element 'vertex', got {got}")
    rows = np.stack([np.asarray(column, np.float64) for column in scalars], axis=1)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad) and names != POSITION:  # faces with such a vertex are rejected later
        place, got = table.place(where, int(bad[0])), format_row(rows[bad[0]])
        raise SceneError(f"{place}: {', '.join(names)} of vertex {bad[0]} must be finite numbers, got {got}")
    return rows


def _normals(vertex: Table, where: str) -> Floats | None:
    return _floats(vertex, NORMAL, where) if any(name in vertex.columns for name in NORMAL) else None


def _uv(vertex: Table, where: str) -> Floats | None:
    names = next((pair for pair in UV if all(name in vertex.columns for name in pair)), None)
    return _floats(vertex, names, where) if names else None


def _faces(face: Table, count: int, where: str) -> NDArray[np.int32]:
    corners = next((c for name in CORNERS if isinstance(c := face.columns.get(name), Lists)), None)
    if corners is None:
        got = ", ".join(face.columns) or "none"
        raise SceneError(f"{where}: expected a list {' or '.join(CORNERS)} of element 'face', got {got}")
    _check_sizes(corners, face, where)
    _check_indices(corners, face, count, where)
    return corners.values.astype(np.int32)[triangle_fans(corners.sizes)]


def _check_sizes(corners: Lists, face: Table, where: str) -> None:
    bad = np.flatnonzero(corners.sizes < 3)
    if len(bad):
        place, got = face.place(where, int(bad[0])), corners.sizes[bad[0]]
        raise SceneError(f"{place}: face {bad[0]} needs at least 3 vertices, got {got}")


def _check_indices(corners: Lists, face: Table, count: int, where: str) -> None:
    values = corners.values
    bad = np.flatnonzero(~((values >= 0) & (values < count) & (values == np.floor(values))))
    if len(bad):
        row = int(np.searchsorted(np.cumsum(corners.sizes), bad[0], side="right"))
        limits = f"0 to {count - 1} (the file has {count})"
        place, got = face.place(where, row), f"{values[bad[0]]:g}"
        raise SceneError(f"{place}: face {row} must join vertices {limits}, got {got}")
