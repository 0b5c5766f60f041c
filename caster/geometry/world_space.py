"""Transforms of geometry to world space: the numbers that are traced, exported and judged.

Every shape packs itself with a `Rounding`. `as_given` keeps float64; `as_float32` rounds each number that defines the
geometry (vertex, centre, radius, matrix entry) once, so that a float32 renderer traces bit-identical geometry. Derived
numbers (inverses, normals) are float64 in both cases.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from caster.description.fields import Flag, Shape
from caster.description.transform import inverse, is_mirrored, product, row_lengths, transform_points, transform_vectors
from caster.geometry.triangle_mesh import Mesh, vertex_normals
from caster.kernels.triangles import Triangles

__all__ = ["LARGEST_COORDINATE", "Rounding", "TriangleShape", "as_float32", "as_given", "is_usable", "world_vertices"]

Rounding = Callable[[np.ndarray], np.ndarray]
AnyScene: TypeAlias = Any  # a caster.scene.model.Scene, which is declared by means of this package

# A product of a dozen rotations and uniform scales leaves its columns orthogonal and equally long to about
# 12 * 8 u of their length, u = 2^-53; intended non-uniform scales are far larger.
SIMILARITY_RTOL = 128 * 2.0**-53


# Embree silently rejects a triangle with a vertex that is not finite or this far out (its FLT_LARGE). We reject it too,
# and count it (packing.py). Scene units.
LARGEST_COORDINATE = 1.844e18


def as_given(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(numbers, np.float64)


def as_float32(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(numbers, np.float64).astype(np.float32).astype(np.float64)


def similarity_scale(linear: np.ndarray) -> float | None:
    """The scale of a similarity: rotation, reflection and uniform scale; None for any other 3x3 matrix.

    Exact for a pure scale, and homogeneous under powers of two.
    """
    largest = float(np.abs(linear).max())
    ratios = linear / largest  # squares neither overflow nor underflow
    gram = product(ratios.T, ratios)
    size = np.trace(gram) / 3.0
    if not np.all(np.abs(gram - size * np.eye(3)) <= SIMILARITY_RTOL * size):
        return None
    return largest * math.sqrt(float((ratios * ratios).sum()) / 3.0)


class AffineImages(NamedTuple):
    """Images of a unit shape under p -> center + to_world p; each kind has a class derived from it."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


def largest_curvature(images: AffineImages) -> np.ndarray:
    """(n,), a bound on the curvature of images of a unit sphere or cylinder: longest axis / shortest^2.

    The Frobenius norm of a matrix is at least its longest axis, that of the inverse at least 1 / the shortest.
    """
    longest, inverse_of_shortest = (np.sqrt((m * m).sum(axis=(1, 2))) for m in (images.to_world, images.to_object))
    return np.asarray(longest * inverse_of_shortest * inverse_of_shortest)


def affine_arrays(
    center: np.ndarray, linear: np.ndarray, rounded: Rounding
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of AffineImages for one image."""
    to_world = rounded(linear)
    return rounded(center)[None], to_world[None], inverse(to_world)[None]


def transform_mesh(mesh: Mesh, matrix: np.ndarray, rounded: Rounding, face_normals: bool) -> Triangles:
    """Transform a mesh to world space; missing vertex normals are generated there unless `face_normals`.

    A mirroring matrix reverses the orientation of faces, since normals transform by the inverse transpose for every
    shape. Rejected faces become degenerate, so that the numbering is unchanged. Raises LinAlgError if no vertex stays
    finite.
    """
    vertices = world_vertices(mesh, matrix, rounded)
    if not np.isfinite(vertices).any():
        raise np.linalg.LinAlgError("no corner is finite")
    faces = mesh.faces[:, [0, 2, 1]] if is_mirrored(matrix) else mesh.faces
    vertices, faces = _collapse_rejected(vertices, faces)
    normals = np.zeros((len(vertices), 3))
    if not face_normals:
        if mesh.normals is None:
            normals = vertex_normals(vertices, faces)
        else:
            normals = transform_vectors(inverse(matrix[:3, :3]).T, mesh.normals)
            length = row_lengths(normals)[:, None]
            np.divide(normals, length, out=normals, where=length > 0.0)
        normals = rounded(normals)
    uv = np.zeros((len(vertices), 2)) if mesh.uv is None else rounded(mesh.uv)
    return Triangles(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
        normals,
        uv,
        np.full(len(faces), not face_normals),
        np.full(len(faces), mesh.uv is not None),
    )


def world_vertices(mesh: Mesh, matrix: np.ndarray, rounded: Rounding) -> np.ndarray:
    """(n, 3) vertices in world space; not finite where the mesh's are not, or on overflow."""
    with np.errstate(all="ignore"):
        return rounded(transform_points(matrix, mesh.vertices))


def is_usable(vertices: np.ndarray) -> np.ndarray:
    """(n,) bool: finite vertices within LARGEST_COORDINATE."""
    return (np.abs(vertices) < LARGEST_COORDINATE).all(axis=1)  # false for NaN


def _collapse_rejected(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace unusable vertices by a usable one and collapse their faces to a point."""
    usable = is_usable(vertices)
    if usable.all():
        return vertices, faces
    place = int(np.argmax(usable))  # any will do: a degenerate face is never hit
    replacement = vertices[place] if usable[place] else np.zeros(3)
    kept = usable[faces].all(axis=1, keepdims=True)
    return np.where(usable[:, None], vertices, replacement), np.where(kept, faces, place)


class TriangleShape(Shape):
    """Base of shapes that are made of triangles, flat where the mesh has no normals."""

    def mesh(self) -> Mesh:
        """The mesh in object space."""
        raise NotImplementedError

    def without_uv(self) -> str:
        return "" if self.mesh().uv is not None else "its triangles have no uv"

    def pack(self, rounded: Rounding) -> Triangles:
        mesh = self.mesh()
        return transform_mesh(mesh, self.matrix, rounded, face_normals=mesh.normals is None)


class MeshShape(TriangleShape):
    """Base of shapes that are smooth triangle meshes unless `face_normals`."""

    face_normals: Flag = False

    def pack(self, rounded: Rounding) -> Triangles:
        return transform_mesh(self.mesh(), self.matrix, rounded, self.face_normals)
