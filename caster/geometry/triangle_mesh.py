"""Triangle meshes: arrays, generated vertex normals, validation and triangulation of polygons."""

import inspect
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.description.transform import Floats as Floats
from caster.description.transform import dot_rows, row_lengths
from caster.kernels.math.angles import eighths_and_rest

Ints = NDArray[np.int32]


class Mesh(NamedTuple):
    """An indexed triangle mesh in object space with per-vertex attributes.

    vertices: (n, 3), scene units. faces: (m, 3), indices of vertices, counter-clockwise seen from outside.
    normals: (n, 3), unit length, or None. uv: (n, 2) or None.
    """

    vertices: Floats
    faces: Ints
    normals: Floats | None = None
    uv: Floats | None = None


# Normal of a vertex without a face of positive area: Mitsuba's choice, so that both sides agree.
NO_NORMAL = (1.0, 0.0, 0.0)


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Vertex normals: the angle-weighted mean of the unit normals of adjacent faces.

    vertices: (n, 3); faces: (m, 3) within range. Returns (n, 3) unit vectors, (1, 0, 0) at vertices without a finite
    face of positive area. Call it in world space: non-uniform scaling changes angles.
    Source: Thuermer and Wuethrich, Computing Vertex Normals from Polygonal Facets (1998), as Mitsuba does.
    """
    vertices = np.asarray(vertices, np.float64)
    faces = faces[np.isfinite(vertices).all(axis=1).take(faces).all(axis=1)]
    weighted = np.empty((3, len(faces), 3))  # x, y, z of a face's unit normal times the angle, at each corner
    for start in range(0, len(faces), FACES_PER_CHUNK):
        chunk = slice(start, start + FACES_PER_CHUNK)
        at = np.ascontiguousarray(vertices[faces[chunk]].transpose(1, 2, 0))
        edges = np.roll(at, -1, axis=0) - at  # edge i runs from corner i to the next one
        edges = np.ldexp(edges, -_exponents(edges.reshape(9, -1)))
        cross = np.cross(edges[0], edges[1], axis=0)
        sine = row_lengths(cross.T)  # scaled by two edge lengths, like the cosine
        unit = normalize_rows(cross.T).T
        for i in range(3):
            eighths, rest = _angle_parts(sine, -dot_rows(edges[i].T, edges[i - 1].T))
            weighted[:, chunk, i] = unit * (0.25 * math.pi * eighths + rest)
    owner = np.ravel(faces)
    sums = [np.bincount(owner, each.ravel(), len(vertices)) for each in weighted]
    total = np.stack(sums, axis=1).astype(np.float64)
    normals = normalize_rows(total)
    normals[~total.any(axis=1)] = NO_NORMAL
    return normals


def normalize_rows(vectors: Floats) -> Floats:
    """Each row of (n, 3) normalized; rows of zeros stay zero."""
    columns = np.transpose(vectors)
    scaled = np.ldexp(columns, -_exponents(columns))
    length = row_lengths(scaled.T)
    return (scaled / np.where(length == 0.0, 1.0, length)).T


def check_mesh(mesh: Mesh, where: str) -> None:
    """Validate a mesh from a file. Degenerate faces and vertices that are not finite are valid: packing rejects them.

    Raises SceneError that starts with `where` and names the first bad face or normal.
    """
    count = len(mesh.vertices)
    if len(mesh.faces) == 0:
        raise SceneError(f"{where}: the mesh has no faces: expected at least one, got {count} vertices only")
    bad = np.flatnonzero(((mesh.faces < 0) | (mesh.faces >= count)).any(axis=1))
    if len(bad):
        limits, got = f"0 to {count - 1} (the mesh has {count})", format_row(mesh.faces[bad[0]])
        raise SceneError(f"{where}: face {bad[0]} must join vertices {limits}, got {got}")
    if mesh.normals is not None and len(bad := np.flatnonzero(~mesh.normals.any(axis=1))):
        hint = "leave the normals out to have them generated"
        raise SceneError(f"{where}: the normal of vertex {bad[0]} must have a direction, got (0, 0, 0); {hint}")


def format_row(numbers: Any) -> str:
    """A row of numbers for an error message: (1, 0.5, nan)."""
    return "(" + ", ".join(f"{float(x):g}" for x in numbers) + ")"


FACES_PER_CHUNK = 1 << 11  # temporaries stay in the cache of a core

_angle_parts = inspect.unwrap(eighths_and_rest)  # the plain function, for arrays


def _exponents(columns: Floats) -> Ints:
    """(n,) exponents: columns scaled by 2^-exponent have squares that neither overflow nor underflow."""
    return np.asarray(np.frexp(np.max(np.abs(columns), axis=0, initial=0.0))[1])


def grid_faces(vertex: Ints) -> Ints:
    """Two triangles for each cell of a grid of vertex numbers: (m, 3).

    vertex: (rows, columns), or (n, rows, columns) for n grids. The triangles are counter-clockwise where columns run to
    the right and rows upwards.
    """
    here, right = vertex[..., :-1, :-1], vertex[..., :-1, 1:]
    above, opposite = vertex[..., 1:, :-1], vertex[..., 1:, 1:]
    return np.stack((here, right, opposite, here, opposite, above), axis=-1).reshape(-1, 3)


Indices = NDArray[np.int64]


def triangle_fans(sizes: Indices) -> Indices:
    """Triangulate polygons as fans: indices into the flat list of all polygons' corners.

    sizes: (k,) corners of each polygon, all >= 3. Returns (m, 3): for each polygon (first, i, i + 1), in order.
    """
    first_corner = np.cumsum(sizes) - sizes
    triangles = sizes - 2
    first_triangle = np.cumsum(triangles) - triangles
    first = np.repeat(first_corner, triangles)
    nth = np.arange(len(first)) - np.repeat(first_triangle, triangles)
    return np.stack([first, first + nth + 1, first + nth + 2], axis=1)
