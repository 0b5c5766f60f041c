"""Shared rays: the caster's camera rays from the near plane on, in float32, which both sides trace."""

from typing import NamedTuple

import numpy as np

from caster.rendering.images import camera_rays
from caster.scene.model import Scene

# How far from 1 the length of a float32 direction may be that was normalised in float32: some roundings of 2^-24.
UNIT_LENGTH_ATOL = 2.0**-20


class SharedRays(NamedTuple):
    """One ray a pixel, row by row. Numbers of camera rays are float32 values, so neither side rounds them again.

    Rays of a list (mitsuba_ref/subjects/ray_files.py) are laid out as a film, and may be float64 numbers.
    """

    o: np.ndarray  # (n, 3) float32, of a list float64
    d: np.ndarray  # (n, 3)
    t_max: np.ndarray  # (n,) lengths of d; negative: no ray
    start: np.ndarray  # (n,) float64, distance from the eye to o
    t_min: np.ndarray | float = 0.0  # (n,) float64 of a list; a hit has t_min < t <= t_max

    @property
    def is_list(self) -> bool:
        """Whether these are rays of a list, not of a camera."""
        return isinstance(self.t_min, np.ndarray)

    def rows(self, rows: np.ndarray | slice) -> "SharedRays":
        """Some of them."""
        t_min = self.t_min[rows] if isinstance(self.t_min, np.ndarray) else self.t_min
        return SharedRays(self.o[rows], self.d[rows], self.t_max[rows], self.start[rows], t_min)

    @property
    def reference_exponent(self) -> np.ndarray:
        """(n,) int; directions for Mitsuba are d / 2^exponent, of a length up to 1, and t counts in those.

        Its spheres and ellipsoids take the distance to the centre for t, and lose digits where d is longer than 1.
        """
        length = np.linalg.norm(self.d.astype(np.float64), axis=1)
        unit = np.abs(length - 1.0) <= UNIT_LENGTH_ATOL
        return np.where(unit, 0, np.ceil(np.log2(length))).astype(int)

    def for_reference(self) -> "SharedRays":
        """The rays as Mitsuba traces them: float32, from t_min on, since it has none; camera rays are so already."""
        if not isinstance(self.t_min, np.ndarray):
            return self
        o = _float32(self.o + self.t_min[:, None] * self.d)
        with np.errstate(invalid="ignore"):
            left = np.where(
                self.t_max < 0.0, -1.0, np.ldexp(self.t_max - self.t_min, self.reference_exponent)
            )
        d = np.ldexp(self.d, -self.reference_exponent[:, None])
        return SharedRays(o, _float32(d), _float32(left), self.start)

    def t_of_reference(self, t: np.ndarray) -> np.ndarray:
        """(n,) Mitsuba's t along those rays, as t along these."""
        return t if not self.is_list else np.ldexp(t, -self.reference_exponent) + self.t_min


def shared_rays(scene: Scene) -> SharedRays:
    """Camera rays of a scene. Mitsuba has no t_min, so a ray starts where the near plane cuts it."""
    rays = camera_rays(scene)
    o = rays.o + rays.t_min[:, None] * rays.d
    left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
    return SharedRays(_float32(o), _float32(rays.d), _float32(left), rays.t_min)


def _float32(a: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):  # what is beyond float32 becomes inf, and the caster refuses it
        return np.ascontiguousarray(a, np.float32)


def pixel_of(scene: Scene, row: int) -> tuple[int, int]:
    """x, y on the film of a row of the window."""
    x0, y0, x1, _y1 = scene.film.window
    return x0 + row % (x1 - x0), y0 + row // (x1 - x0)
