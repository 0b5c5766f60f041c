"""Where a random scene stands, how large it is, and the numbers it is made of."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mitsuba_ref.shapes.targets import LATTICE_STEPS, Rng


@dataclass(frozen=True)
class Setting:
    """What all shapes of one scene have in common."""

    size: float = 1.0  # of a shape, scene units; a power of two on the lattice
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    condition: float = 1.0  # greatest of the placing matrices, their translation apart
    lattice: bool = False

    def on_lattice(self, points: np.ndarray) -> np.ndarray:
        """Points on the lattice, if this setting has one."""
        if not self.lattice:
            return points
        step = self.size / LATTICE_STEPS
        return step * np.round(points / step)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Any order of magnitude is as likely as any other."""
    return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))


def perturbed_by_ulps(rng: Rng, numbers: np.ndarray, ulps: int = 2) -> np.ndarray:
    """Each number moved by up to so many units in the last place."""
    steps = rng.integers(-ulps, ulps + 1, np.shape(numbers))
    out = np.array(numbers, np.float64)
    with np.errstate(over="ignore", under="ignore"):
        for step in range(1, ulps + 1):
            beyond = np.nextafter(out, np.copysign(np.inf, steps))
            out = np.where(np.abs(steps) >= step, beyond, out)
    return out


def random_rotation(rng: Rng) -> np.ndarray:
    """(3, 3) rotation, any as likely as any other."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def random_setting(rng: Rng, *, condition: float = 1e3, decades_of_size: float = 3.0) -> Setting:
    """Half of them on a lattice around the origin; the others of any size, and up to 1e6 sizes off."""
    if rng.random() < 0.5:
        return random_lattice_setting(rng)
    size = log_uniform(rng, 10.0**-decades_of_size, 10.0**decades_of_size) if rng.random() < 0.5 else 1.0
    away = size * log_uniform(rng, 1.0, 1e6) if rng.random() < 0.4 else 0.0
    return Setting(size, vector(away * rng.normal(size=3)), condition)


def random_lattice_setting(rng: Rng) -> Setting:
    """Every coordinate a small whole multiple of a power of two."""
    size = float(2.0 ** rng.integers(-3, 4))
    middle = vector(size * rng.integers(-4, 5, 3)) if rng.random() < 0.3 else (0.0, 0.0, 0.0)
    return Setting(size, middle, 1.0, lattice=True)


def vector(numbers: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(number) for number in numbers)
    return x, y, z


# Random `to_world`: turned, mirrored, stretched and sheared up to a condition.


def random_to_world(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    """Steps that bring a shape of about unit size to somewhere near the middle of the setting."""
    if setting.lattice:
        return _lattice_steps(rng, setting)
    if setting.condition == 1.0 or rng.random() < 0.3:
        return _similarity_steps(rng, setting)
    return [{"matrix": matrix_rows(_random_linear(rng, setting), _random_translation(rng, setting))}]


def matrix_rows(linear: np.ndarray, move: np.ndarray) -> list[list[float]]:
    """The 4 x 4 matrix as a scene file spells it."""
    rows = np.column_stack([linear, move]).tolist()
    return [*rows, [0.0, 0.0, 0.0, 1.0]]


def _random_translation(rng: Rng, setting: Setting) -> np.ndarray:
    return np.array(setting.middle) + 1.5 * setting.size * rng.normal(size=3)


def _lattice_steps(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    """Quarter turns, mirror images and powers of two, all without rounding."""
    steps: list[dict[str, Any]] = []
    if rng.random() < 0.4:
        axis = np.eye(3)[rng.integers(3)].tolist()
        steps.append({"rotate": {"axis": axis, "degrees": 90.0 * int(rng.integers(1, 4))}})
    factors = setting.size * rng.choice([1.0, 1.0, 1.0, -1.0], 3) * _lattice_stretch(rng)
    if not np.all(factors == 1.0):
        steps.append({"scale": factors.tolist()})
    move = (
        np.array(setting.middle)
        + setting.size * rng.integers(-2 * LATTICE_STEPS, 2 * LATTICE_STEPS + 1, 3) / LATTICE_STEPS
    )
    return [*steps, {"translate": move.tolist()}] if move.any() else steps


def _lattice_stretch(rng: Rng) -> np.ndarray:
    return 2.0 ** rng.integers(-2, 3, 3) if rng.random() < 0.3 else np.ones(3)


def _similarity_steps(rng: Rng, setting: Setting) -> list[dict[str, Any]]:
    axis = rng.normal(size=3)
    turn = {"axis": axis.tolist(), "degrees": float(rng.uniform(0.0, 360.0))}
    scale = setting.size * log_uniform(rng, 0.1, 1.0) * float(rng.choice([1.0, 1.0, -1.0]))
    return [{"scale": scale}, {"rotate": turn}, {"translate": _random_translation(rng, setting).tolist()}]


def _random_linear(rng: Rng, setting: Setting) -> np.ndarray:
    """Singular values from 1 / condition to 1; sheared, and mirrored half of the time."""
    condition = log_uniform(rng, 1.0, setting.condition)
    values = np.array([1.0, condition ** -rng.random(), 1.0 / condition])
    values = rng.permutation(values) * rng.choice([-1.0, 1.0], 3)
    return setting.size * random_rotation(rng) @ np.diag(values) @ random_rotation(rng)
