"""Shared rays: the caster's camera rays from the near plane on, in float32, which both sides trace."""

from typing import NamedTuple

import numpy as np

from caster.rendering.images import camera_rays
from caster.scene.model import Scene


class SharedRays(NamedTuple):
    """One ray a pixel, row by row. All numbers are float32 values, so neither side rounds them again."""

    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32
    t_max: np.ndarray  # (n,) float32, lengths of d; negative: no ray
    start: np.ndarray  # (n,) float64, distance from the eye to o


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
