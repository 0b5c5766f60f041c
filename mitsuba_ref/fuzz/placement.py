"""Random `to_world`: turned, mirrored, stretched and sheared up to a condition."""

from typing import Any

import numpy as np

from mitsuba_ref.fuzz.setting import GRID, Rng, Setting, decades, orthogonal


def placed(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    """Steps that bring a shape of about unit size to somewhere near the middle of the setting."""
    if setting.lattice:
        return _on_the_lattice(rng, setting)
    if setting.condition == 1.0 or rng.random() < 0.3:
        return _similar(rng, setting)
    return [{"matrix": matrix_rows(_linear(rng, setting), _somewhere(rng, setting))}]


def matrix_rows(linear: np.ndarray, move: np.ndarray) -> list[list[float]]:
    """The 4 x 4 matrix as a scene file spells it."""
    rows = np.column_stack([linear, move]).tolist()
    return [*rows, [0.0, 0.0, 0.0, 1.0]]


def _somewhere(rng: Rng, setting: Setting) -> np.ndarray:
    return np.array(setting.middle) + 1.5 * setting.size * rng.normal(size=3)


def _on_the_lattice(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    """Quarter turns, mirror images and powers of two, all without rounding."""
    steps: list[dict[str, Any]] = []
    if rng.random() < 0.4:
        axis = np.eye(3)[rng.integers(3)].tolist()
        steps.append({"rotate": {"axis": axis, "degrees": 90.0 * int(rng.integers(1, 4))}})
    factors = setting.size * rng.choice([1.0, 1.0, 1.0, -1.0], 3) * _stretch(rng)
    if not np.all(factors == 1.0):
        steps.append({"scale": factors.tolist()})
    move = np.array(setting.middle) + setting.size * rng.integers(-2 * GRID, 2 * GRID + 1, 3) / GRID
    return [*steps, {"translate": move.tolist()}] if move.any() else steps


def _stretch(rng: Rng) -> np.ndarray:
    return 2.0 ** rng.integers(-2, 3, 3) if rng.random() < 0.3 else np.ones(3)


def _similar(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    axis = rng.normal(size=3)
    turn = {"axis": axis.tolist(), "degrees": float(rng.uniform(0.0, 360.0))}
    scale = setting.size * decades(rng, 0.1, 1.0) * float(rng.choice([1.0, 1.0, -1.0]))
    return [{"scale": scale}, {"rotate": turn}, {"translate": _somewhere(rng, setting).tolist()}]


def _linear(rng: Rng, setting: Setting) -> np.ndarray:
    """Singular values from 1 / condition to 1; sheared, and mirrored half of the time."""
    condition = decades(rng, 1.0, setting.condition)
    values = np.array([1.0, condition ** -rng.random(), 1.0 / condition])
    values = rng.permutation(values) * rng.choice([-1.0, 1.0], 3)
    return setting.size * orthogonal(rng) @ np.diag(values) @ orthogonal(rng)
