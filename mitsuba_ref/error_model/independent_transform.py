"""to_world a second time, from its definition, so that an error in composing it cannot hide on both sides."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.description.fields import Shape
from mitsuba_ref.error_model.intersections import K, norm, unit


def compose_transform(steps: Sequence[Any]) -> np.ndarray:
    """The 4x4 matrix of the steps of a to_world: the first one acts first."""
    matrix = np.eye(4)
    for step in steps:
        matrix = _matrix(step) @ matrix
    return matrix


def transform_error_ratio(shape: Shape) -> float:
    """|the caster's matrix - placement| over what float64 rounding of as many products allows; 1 is all of it.

    Each step of n adds K roundings of a row times a column, whose size is the product of the steps' magnitudes.
    """
    expected = compose_transform(shape.to_world)
    size = np.eye(4)
    for step in shape.to_world:
        size = np.abs(_matrix(step)) @ size
    bound = (
        K * (1 + len(shape.to_world)) * 2.0**-53 * (size + np.linalg.norm(size[:3, :3]))
        + np.finfo(float).tiny
    )
    return float(np.max(np.abs(shape.matrix - expected) / bound))


def _matrix(step: Any) -> np.ndarray:
    if step.translate is not None:
        return _affine(np.eye(3), step.translate)
    if step.scale is not None:
        return _affine(np.diag(step.scale))
    if step.rotate is not None:
        return _affine(_rotation(np.array(step.rotate.axis), np.deg2rad(np.fmod(step.rotate.degrees, 360.0))))
    if step.look_at is not None:
        return _looking(*(np.array(v) for v in (step.look_at.origin, step.look_at.target, step.look_at.up)))
    return np.array(step.matrix, np.float64)


def _affine(linear: np.ndarray, move: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, move
    return matrix


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """By the unit quaternion of half the angle."""
    w, v = np.cos(angle / 2.0), np.sin(angle / 2.0) * axis / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), v)  # cross @ x = v cross x
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def _looking(origin: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left = left / np.linalg.norm(left)
    return _affine(np.column_stack([left, np.cross(forward, left), forward]), origin)


# Shapes in the world a second time: from the description and its matrix, in other formulas than the caster's.
#
# Both sides trace the numbers that the caster packs, so no picture shows an error in packing. These claims do.


class ExpectedNumbers(NamedTuple):
    """Numbers as they were packed and as they should be, and the size of what was rounded on the way."""

    what: str
    packed: np.ndarray
    expected: np.ndarray
    size: np.ndarray
    rounded: bool = True  # False: it has to be these very numbers


# A matrix that is flatter than this may turn inside out when its numbers are rounded to float32.
LARGEST_HANDED_CONDITION = 2.0**20

# (description, its packed arrays) -> what has to hold
ExpectedPacking = Callable[[Any, Any], Iterator[ExpectedNumbers]]


def expected_sphere(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Centre, and radius or matrix; a similarity stretches every direction as it does the x axis."""
    linear = shape.matrix[:3, :3]
    yield _point(shape, "center", part.center[0], np.array(shape.center))
    if hasattr(part, "radius"):
        radius = shape.radius * np.linalg.norm(linear[:, 0])
        yield ExpectedNumbers("radius", part.radius[0], radius, radius)
    else:
        yield _same("to_world", part.to_world[0], shape.radius * linear)


def expected_disk(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """The matrix as it is."""
    yield _same("center", part.center[0], shape.matrix[:3, 3])
    yield _same("to_world", part.to_world[0], shape.matrix[:3, :3])


def expected_cylinder(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Base, axis and handedness; and A A^T, which does not depend on where around the axis the angle begins."""
    linear, packed = shape.matrix[:3, :3], part.to_world[0]
    p0, axis = np.array(shape.p0), np.subtract(shape.p1, shape.p0)
    ends = np.abs(shape.p0) + np.abs(shape.p1)
    across = np.eye(3) - np.outer(axis, axis) / np.dot(axis, axis)
    own = shape.radius**2 * across + np.outer(axis, axis)
    reach = np.abs(linear).sum(axis=1) * (shape.radius + ends.max())
    yield _point(shape, "p0", part.center[0], p0)
    yield ExpectedNumbers("axis", packed[:, 2], linear @ axis, np.abs(linear) @ ends)
    yield ExpectedNumbers("radius", packed @ packed.T, linear @ own @ linear.T, np.outer(reach, reach))
    hands = np.sign(np.linalg.det(packed)), np.sign(np.linalg.det(linear))
    yield ExpectedNumbers(
        "handedness", *hands, np.where(np.linalg.cond(packed) < LARGEST_HANDED_CONDITION, 0.0, np.inf)
    )


def expected_plane(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """A point of it, and the normal by the matrix of cofactors."""
    point = shape.point if shape.point is not None else np.multiply(shape.offset, shape.normal)
    yield _point(shape, "point", part.point[0], np.array(point))
    normal, size = _turned(shape.matrix, np.array([shape.normal]))
    yield ExpectedNumbers("normal", part.normal, normal, size)


def expected_mesh(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Corners, which side of each face is outside, and the vertex normals where there are to be some."""
    given = shape.mesh()
    linear = shape.matrix[:3, :3]
    corners = np.einsum("jk,ik->ij", linear, given.vertices) + shape.matrix[:3, 3]
    size = np.abs(given.vertices) @ np.abs(linear.T) + np.abs(shape.matrix[:3, 3])
    yield ExpectedNumbers("vertices", part.vertices, corners, size)
    mirrored = np.linalg.slogdet(linear)[0] < 0.0
    yield _exact("faces", part.faces, given.faces[:, [0, 2, 1]] if mirrored else given.faces)
    smooth = not getattr(shape, "face_normals", given.normals is None)
    yield _exact("smooth", part.smooth, np.full(len(given.faces), smooth))
    if smooth and given.normals is not None:
        yield ExpectedNumbers("normals", part.normals, *_turned(shape.matrix, given.normals))
    elif smooth:
        yield ExpectedNumbers("generated normals", part.normals, *_generated(part.vertices, part.faces))


def expected_triangle(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """The corners and normals in the order that was described, and where they stand."""
    given = shape.mesh()
    yield _exact("corners", given.vertices, shape.vertices)
    yield _exact("face", given.faces, [[0, 1, 2]])
    if shape.normals is not None:
        yield _exact("described normals", given.normals, shape.normals)
    yield from expected_mesh(shape, part)


def expected_rectangle(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """[-1, 1]^2 at z = 0, facing +z, and where it stands."""
    corners, doubled = _sides(shape)
    yield _exact("corners", np.abs(corners), np.tile([1.0, 1.0, 0.0], (len(corners), 1)))
    yield _exact("winding", np.sign(doubled[:, 2]), np.ones(len(doubled)))
    yield _exact("area", 0.5 * doubled.sum(axis=0), [0.0, 0.0, 4.0])
    yield from expected_mesh(shape, part)


def expected_cube(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """[-1, 1]^3 with its outside outside, and where it stands."""
    corners, doubled = _sides(shape)
    middles = shape.mesh().vertices[shape.mesh().faces].mean(axis=1)
    yield _exact("corners", np.abs(corners), np.ones_like(corners))
    yield _exact("winding", np.sign(np.einsum("ij,ij->i", doubled, middles)), np.ones(len(doubled)))
    yield _exact("area", 0.5 * np.abs(doubled).sum(axis=0), [8.0, 8.0, 8.0])
    yield from expected_mesh(shape, part)


def _sides(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """(corners of the mesh, twice the area of each face as a vector)."""
    given = shape.mesh()
    a, b, c = (given.vertices[given.faces[:, j]] for j in range(3))
    return given.vertices, np.cross(b - a, c - a)


def _point(shape: Any, what: str, packed: np.ndarray, p: np.ndarray) -> ExpectedNumbers:
    linear, move = shape.matrix[:3, :3], shape.matrix[:3, 3]
    expected = linear[:, 0] * p[0] + linear[:, 1] * p[1] + linear[:, 2] * p[2] + move
    return ExpectedNumbers(what, packed, expected, np.abs(linear) @ np.abs(p) + np.abs(move))


def _same(what: str, packed: Any, expected: Any) -> ExpectedNumbers:
    """Up to one rounding of each number."""
    return ExpectedNumbers(what, np.asarray(packed), np.asarray(expected), np.abs(expected))


def _exact(what: str, packed: Any, expected: Any) -> ExpectedNumbers:
    return ExpectedNumbers(
        what, np.asarray(packed, np.float64), np.asarray(expected, np.float64), np.zeros(()), rounded=False
    )


def _turned(matrix: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(normals (n, 3) in the world, size of their rounding): a normal is a cross product, and turns as one."""
    m = matrix[:3, :3] / np.abs(matrix[:3, :3]).max()
    cofactors = np.stack([np.cross(m[:, i - 2], m[:, i - 1]) for i in range(3)], axis=1)
    cofactors *= np.linalg.slogdet(m)[0]
    turned = np.einsum("jk,ik->ij", cofactors, normals)
    columns = norm(m.T)
    sizes = np.array([columns[i - 2] * columns[i - 1] for i in range(3)])
    with np.errstate(divide="ignore"):
        size = np.abs(normals) @ sizes / norm(turned)
    return unit(turned), size[:, None]


NO_NORMAL = np.array([1.0, 0.0, 0.0])  # what Mitsuba gives a vertex without a face that has an area


def _generated(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle-weighted normals corner by corner, and the size of their rounding (inf where they cancel)."""
    p = vertices / max(np.abs(vertices).max(), np.finfo(float).tiny)
    total, weight = np.zeros_like(p), np.zeros(len(p))
    with np.errstate(divide="ignore", invalid="ignore"):
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


def _scaled(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a, as long as the product of both lengths: Kahan's angle is between vectors of equal lengths."""
    scaled: np.ndarray = a * norm(b)[:, None]
    return scaled
