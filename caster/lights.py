"""Lights: how much arrives at a point, and from where."""

from typing import Literal

import numpy as np

from caster import fields
from caster.fields import RGB, UnitVec3, Vec3


class Point(fields.Light):
    """A point that shines evenly in all directions. `intensity` in power per solid angle (W/sr)."""

    type: Literal["point"] = "point"
    position: Vec3
    intensity: RGB

    def towards(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors to the light, and intensity over squared distance; none of it in the light itself."""
        d, _ = self.shadow_rays(p)
        square = d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2]
        apart = square > 0.0
        safe = np.where(apart, square, 1.0)[:, None]
        return d / np.sqrt(safe), np.where(apart[:, None], np.array(self.intensity) / safe, 0.0)

    def shadow_rays(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions that reach the light at t = 1."""
        return np.array(self.position) - p, np.ones(len(p))


class Directional(fields.Light):
    """Parallel light that travels along `direction`; a surface across it receives `irradiance` (W/m^2)."""

    type: Literal["directional"] = "directional"
    direction: UnitVec3
    irradiance: RGB

    def towards(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same everywhere: against the direction of travel."""
        return self._backwards(p), np.tile(np.array(self.irradiance), (len(p), 1))

    def shadow_rays(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The light is infinitely far."""
        return self._backwards(p), np.full(len(p), np.inf)

    def _backwards(self, p: np.ndarray) -> np.ndarray:
        return np.tile(0.0 - np.array(self.direction), (len(p), 1))


class Ambient(fields.Light):
    """The same `radiance` from everywhere (W/(m^2 sr)); it casts no shadow."""

    type: Literal["ambient"] = "ambient"
    radiance: RGB


Light = Point | Directional | Ambient
LIGHTS = (Point, Directional, Ambient)
