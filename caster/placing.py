"""From a description to numbers in world space: the numbers that are cast, exported and judged.

Every shape packs itself through a `Rounding`. `as_given` keeps float64; `as_float32` rounds each number that
defines the geometry (corner, centre, radius, matrix entry) once, so that a float32 renderer which is handed
those numbers traces the same geometry bit for bit. What follows from them (inverses, normals) is float64
either way.
"""

import math
from collections.abc import Callable

import numpy as np

from caster.kernels.triangles import Triangles
from caster.mesh import Mesh, vertex_normals

Rounding = Callable[[np.ndarray], np.ndarray]

# A product of a dozen rotations and uniform scales leaves its columns orthogonal and equally long to about
# 12 * 8 u of their length, u = 2^-53; a stretch anybody means is far larger.
SIMILARITY_RTOL = 128 * 2.0**-53


def as_given(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(numbers, np.float64)


def as_float32(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(numbers, np.float64).astype(np.float32).astype(np.float64)


def is_similarity(linear: np.ndarray) -> bool:
    """Whether a 3x3 matrix keeps angles: rotation, mirroring and one scale."""
    ratios = linear / np.abs(linear).max()  # whose squares neither overflow nor vanish
    gram = ratios.T @ ratios
    size = np.trace(gram) / 3.0
    return bool(np.all(np.abs(gram - size * np.eye(3)) <= SIMILARITY_RTOL * size))


def size_of_similarity(linear: np.ndarray) -> float:
    """By how much such a matrix stretches: exact for a mere scale, and twice that for twice the matrix."""
    largest = float(np.abs(linear).max())
    ratios = linear / largest
    return largest * math.sqrt(float((ratios * ratios).sum()) / 3.0)


def is_mirrored(matrix: np.ndarray) -> bool:
    linear = matrix[:3, :3]
    return bool(np.linalg.det(linear / np.abs(linear).max()) < 0.0)


def affine_arrays(
    center: np.ndarray, linear: np.ndarray, rounded: Rounding
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(center, to_world, to_object) of one primitive, each with a leading axis of 1."""
    to_world = rounded(linear)
    return rounded(center)[None], to_world[None], np.linalg.inv(to_world)[None]


def triangles(mesh: Mesh, matrix: np.ndarray, rounded: Rounding, face_normals: bool) -> Triangles:
    """A mesh in world space. Where it has no normals and wants some, they are generated there.

    A mirrored matrix turns each face around, so that outside stays outside: normals travel by the inverse
    transpose, for every shape.
    """
    vertices = rounded(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])
    faces = mesh.faces[:, [0, 2, 1]] if is_mirrored(matrix) else mesh.faces
    normals = np.zeros((len(vertices), 3))
    if not face_normals:
        normals = rounded(_placed_normals(mesh, matrix, vertices, faces))
    uv = np.zeros((len(vertices), 2)) if mesh.uv is None else rounded(mesh.uv)
    return Triangles(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
        normals,
        uv,
        np.full(len(faces), not face_normals),
        np.full(len(faces), mesh.uv is not None),
    )


def _placed_normals(mesh: Mesh, matrix: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    if mesh.normals is None:
        return vertex_normals(vertices, faces)
    turned = mesh.normals @ np.linalg.inv(matrix[:3, :3])
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.divide(turned, length, out=turned, where=length > 0.0)
