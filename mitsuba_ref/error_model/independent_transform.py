"""Independent computation of to_world transforms, and helpers for the packed numbers that follow from them."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from caster.description.fields import Shape
from mitsuba_ref.error_model.intersections import Array, norm, unit, without_float_warnings, without_overflow_warnings
from mitsuba_ref.error_model.tolerances import K


def transform_error_ratio(shape: Shape) -> float:
    """Largest difference between the caster's matrix and the product of its steps, over its float64 error bound.

    The first step acts first. Each of n steps adds K roundings of a row times a column, whose size is the product of
    the steps' magnitudes.
    """
    expected = size = np.eye(4)
    for step in shape.to_world:
        matrix = _matrix(step)
        expected, size = matrix @ expected, np.abs(matrix) @ size
    bound = K * (1 + len(shape.to_world)) * 2.0**-53 * (size + np.linalg.norm(size[:3, :3])) + np.finfo(float).tiny
    return float(np.max(np.abs(shape.matrix - expected) / bound))


def _matrix(step: Any) -> Array:
    if step.translate is not None:
        return _affine(np.eye(3), step.translate)
    if step.scale is not None:
        return _affine(np.diag(step.scale))
    if step.rotate is not None:  # by the unit quaternion of half the angle
        axis, half = np.array(step.rotate.axis), np.deg2rad(np.fmod(step.rotate.degrees, 360.0)) / 2.0
        cross = np.cross(np.eye(3), np.sin(half) * axis / np.linalg.norm(axis))  # cross @ x = v cross x
        return _affine(np.eye(3) + 2.0 * np.cos(half) * cross + 2.0 * cross @ cross)
    if step.look_at is not None:
        origin, target, up = (np.array(v) for v in (step.look_at.origin, step.look_at.target, step.look_at.up))
        forward = (target - origin) / np.linalg.norm(target - origin)
        left = np.cross(up, forward)
        left = left / np.linalg.norm(left)
        return _affine(np.column_stack([left, np.cross(forward, left), forward]), origin)
    return np.array(step.matrix, np.float64)


def _affine(linear: Array, move: Any = (0.0, 0.0, 0.0)) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, move
    return matrix


# Expected packed numbers, from the description and its matrix by formulas other than the caster's. Both sides trace the
# numbers that the caster packs, so no image shows an error of packing; this comparison does.


class ExpectedNumbers(NamedTuple):
    """Packed numbers, the expected ones, and the magnitude that rounding on the way scales with."""

    what: str
    packed: Array
    expected: Array
    size: Array
    rounded: bool = True  # False: the numbers must be equal


# (description, its packed arrays) -> the numbers expected of them
ExpectedPacking = Callable[[Any, Any], Iterator[ExpectedNumbers]]


def expected_points(shape: Any, what: str, packed: Array, points: Array) -> ExpectedNumbers:
    """Points (..., 3) under the shape's to_world."""
    linear, move = shape.matrix[:3, :3], shape.matrix[:3, 3]
    with np.errstate(invalid="ignore", over="ignore"):
        expected = np.einsum("jk,...k->...j", linear, points) + move
        return ExpectedNumbers(what, packed, expected, np.abs(points) @ np.abs(linear.T) + np.abs(move))


def up_to_rounding(what: str, packed: Any, expected: Any) -> ExpectedNumbers:
    """Numbers whose rounding is relative to their own magnitude."""
    return ExpectedNumbers(what, np.asarray(packed), np.asarray(expected), np.abs(expected))


def exactly(what: str, packed: Any, expected: Any) -> ExpectedNumbers:
    return ExpectedNumbers(
        what, np.asarray(packed, np.float64), np.asarray(expected, np.float64), np.zeros(()), rounded=False
    )


@without_overflow_warnings
def transformed_normals(matrix: Array, normals: Array, keeps_lengths: bool = False) -> tuple[Array, Array]:
    """(normals (n, 3) in world space, size of their rounding): normals transform like cross products, by cofactors.

    They have unit length, or else the longest one has.
    """
    m = matrix[:3, :3] / np.abs(matrix[:3, :3]).max()
    cofactors = np.stack([np.cross(m[:, i - 2], m[:, i - 1]) for i in range(3)], axis=1)
    cofactors *= np.linalg.slogdet(m)[0]
    turned = np.einsum("jk,ik->ij", cofactors, normals)
    columns = norm(m.T)
    sizes = np.array([columns[i - 2] * columns[i - 1] for i in range(3)])
    length = norm(turned).max(keepdims=True) if keeps_lengths else norm(turned)
    return turned / length[:, None], (np.abs(normals) @ sizes / length)[:, None]


NO_NORMAL = np.array([1.0, 0.0, 0.0])  # Mitsuba's normal of a vertex all of whose faces have no area


@without_float_warnings
def angle_weighted_normals(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """Vertex normals weighted by face angles, and the size of their rounding (inf where they cancel)."""
    p = np.ldexp(vertices, -np.frexp(np.abs(vertices).max())[1])  # exact: differences cancel no rounding
    total, weight = np.zeros_like(p), np.zeros(len(p))
    for j in range(3):
        corner, after, before = (faces[:, (j + step) % 3] for step in (0, 1, 2))
        a, b = p[after] - p[corner], p[before] - p[corner]
        across = np.cross(a, b)
        area, lengths = norm(across), norm(a) * norm(b)
        angle = 2.0 * np.arctan2(norm(_scaled(a, b) - _scaled(b, a)), norm(_scaled(a, b) + _scaled(b, a)))
        real = area > 0.0
        share = np.where(real[:, None], across / area[:, None] * angle[:, None], 0.0)
        np.add.at(total, corner, share)
        np.add.at(weight, corner, np.where(real, angle + lengths / area, 0.0))
    size = np.bincount(faces.ravel(), minlength=len(p)) * weight / norm(total)
    normals = np.where((weight > 0.0)[:, None], unit(total), NO_NORMAL)
    return normals, np.where(weight > 0.0, size, 1.0)[:, None]


def _scaled(a: Array, b: Array) -> Array:
    """a scaled to |a| |b|: Kahan's formula for the angle needs vectors of equal lengths."""
    return a * norm(b)[:, None]
