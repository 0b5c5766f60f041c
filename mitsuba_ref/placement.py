"""to_world a second time, from its definition, so that an error in composing it cannot hide on both sides."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from caster.fields import Shape
from mitsuba_ref.meeting import K


def placement(steps: Sequence[Any]) -> np.ndarray:
    """The 4x4 matrix of the steps of a to_world: the first one acts first."""
    matrix = np.eye(4)
    for step in steps:
        matrix = _matrix(step) @ matrix
    return matrix


def disagreement(shape: Shape) -> float:
    """|the caster's matrix - placement| over what float64 rounding of as many products allows; 1 is all of it.

    Each step of n adds K roundings of a row times a column, whose size is the product of the steps' magnitudes.
    """
    expected = placement(shape.to_world)
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
