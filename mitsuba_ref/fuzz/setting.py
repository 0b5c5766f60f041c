"""Where a random scene stands, how large it is, and the numbers it is made of."""

from dataclasses import dataclass

import numpy as np

Rng = np.random.Generator

GRID = 8  # lattice coordinates are whole multiples of size / 8: their sums and differences are exact


@dataclass(frozen=True)
class Setting:
    """What all shapes of one scene have in common."""

    size: float = 1.0  # of a shape, scene units; a power of two on the lattice
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    condition: float = 1.0  # greatest of the placing matrices, their translation apart
    lattice: bool = False

    def snapped(self, points: np.ndarray) -> np.ndarray:
        """Points on the lattice, if this setting has one."""
        if not self.lattice:
            return points
        step = self.size / GRID
        return step * np.round(points / step)


def decades(rng: Rng, low: float, high: float) -> float:
    """Any order of magnitude is as likely as any other."""
    return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))


def directions(rng: Rng, count: int) -> np.ndarray:
    """(count, 3) of about unit length; some along axes, some with small whole components, the rest any."""
    any_way = rng.normal(size=(count, 3))
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    whole = rng.integers(-3, 4, (count, 3)).astype(float)
    whole[~whole.any(axis=1), 0] = 1.0
    axes = np.eye(3)[rng.integers(3, size=count)] * rng.choice([-1.0, 1.0], (count, 1))
    which = rng.choice(3, (count, 1), p=(0.6, 0.25, 0.15))
    return np.where(which == 0, any_way, np.where(which == 1, whole, axes))


def nudged(rng: Rng, numbers: np.ndarray, ulps: int = 2) -> np.ndarray:
    """Each number moved by up to so many units in the last place."""
    steps = rng.integers(-ulps, ulps + 1, np.shape(numbers))
    out = np.array(numbers, np.float64)
    with np.errstate(over="ignore", under="ignore"):
        for step in range(1, ulps + 1):
            beyond = np.nextafter(out, np.copysign(np.inf, steps))
            out = np.where(np.abs(steps) >= step, beyond, out)
    return out


def orthogonal(rng: Rng) -> np.ndarray:
    """(3, 3) rotation, any as likely as any other."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def any_setting(rng: Rng, *, condition: float = 1e3, decades_of_size: float = 3.0) -> Setting:
    """Half of them on a lattice around the origin; the others of any size, and up to 1e6 sizes off."""
    if rng.random() < 0.5:
        return lattice_setting(rng)
    size = decades(rng, 10.0**-decades_of_size, 10.0**decades_of_size) if rng.random() < 0.5 else 1.0
    away = size * decades(rng, 1.0, 1e6) if rng.random() < 0.4 else 0.0
    return Setting(size, vector(away * rng.normal(size=3)), condition)


def lattice_setting(rng: Rng) -> Setting:
    """Every coordinate a small whole multiple of a power of two."""
    size = float(2.0 ** rng.integers(-3, 4))
    middle = vector(size * rng.integers(-4, 5, 3)) if rng.random() < 0.3 else (0.0, 0.0, 0.0)
    return Setting(size, middle, 1.0, lattice=True)


def vector(numbers: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(number) for number in numbers)
    return x, y, z
