"""Counts of rejected faces: not finite, too far out or degenerate (docs/scene-format.md, "Rejected faces")."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.world_space import Rounding, ShapeCollection, as_given, is_usable, world_vertices

# The error of a component of a cross product of two differences is at most 4 u of its terms' magnitudes; u = 2^-53.
# The error of products that underflow is 2^-1074, far below CROSS_UNDERFLOW.
CROSS_RELATIVE_ERROR, CROSS_UNDERFLOW = 5.0 * 2.0**-53, 2.0**-1000

FACES_PER_CHUNK = 1 << 16  # faces; temporaries take some 300 bytes each, and there may be millions


class RejectedFaces(NamedTuple):
    """Rejected faces of one shape; each face counts once, in the first category that applies."""

    not_finite: int  # a vertex is not finite
    too_large: int  # a coordinate is world_space.LARGEST_COORDINATE or more
    without_area: int  # exactly: its vertices are collinear

    @property
    def total(self) -> int:
        return sum(self)

    def __str__(self) -> str:
        words = ("with a corner that is not finite", "too far out", "without area")
        return ", ".join(f"{count} {what}" for count, what in zip(self, words, strict=True) if count)


def rejected_faces(scene: ShapeCollection, rounded: Rounding = as_given) -> Mapping[str, RejectedFaces]:
    """Counts by shape name, for shapes that have rejected faces."""
    names = scene.shape_names()
    counts = {names[i]: _rejected_of_shape(shape, rounded) for i, shape in enumerate(scene.shapes)}
    return {name: count for name, count in counts.items() if count.total}


def _rejected_of_shape(shape: Any, rounded: Rounding) -> RejectedFaces:
    if not hasattr(shape, "mesh"):
        return RejectedFaces(0, 0, 0)
    mesh = shape.mesh()
    vertices = world_vertices(mesh, shape.matrix, rounded)
    finite, usable = np.isfinite(vertices).all(axis=1), is_usable(vertices)
    total = np.zeros(3, np.int64)
    for start in range(0, len(mesh.faces), FACES_PER_CHUNK):
        total += _count_rejected(mesh.faces[start : start + FACES_PER_CHUNK], vertices, finite, usable)
    return RejectedFaces(*total.tolist())


def _count_rejected(
    faces: np.ndarray, vertices: np.ndarray, finite: np.ndarray, usable: np.ndarray
) -> np.ndarray:
    """The counts of RejectedFaces as an array. finite, usable: (v,) bool, of the vertices."""
    sound, good = finite[faces].all(axis=1), usable[faces].all(axis=1)
    flat = _count_degenerate(vertices[faces[good]])
    return np.array([(~sound).sum(), (sound & ~good).sum(), flat])


def _count_degenerate(corners: np.ndarray) -> int:
    """corners: (m, 3, 3), finite."""
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    terms = np.roll(e, -1, axis=1) * np.roll(f, 1, axis=1), np.roll(e, 1, axis=1) * np.roll(f, -1, axis=1)
    sure = (
        np.abs(terms[0] - terms[1])
        > CROSS_RELATIVE_ERROR * (np.abs(terms[0]) + np.abs(terms[1])) + CROSS_UNDERFLOW
    )
    return sum(_is_degenerate(face) for face in corners[~sure.any(axis=1)].tolist())


def _is_degenerate(face: list[list[float]]) -> bool:
    a, b, c = ([Fraction(x) for x in corner] for corner in face)
    e, f = [y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)]
    return all(e[i - 1] * f[i - 2] == e[i - 2] * f[i - 1] for i in range(3))


def in_words(scene: ShapeCollection) -> str:
    """The counts as text; "" if there are none."""
    return "; ".join(f"{name}: {count}" for name, count in rejected_faces(scene).items())
