"""Rays of a camera, and whether rays from outside are sound."""

import math
from typing import Any

from caster.jit.decorators import jit
from caster.kernels.math.vec import max_norm, row
from caster.kernels.protocol import Vec3, camera_ray


@jit
def generate_rays(camera: Any, window: Any, rays: Any, first_row: int, last_row: int) -> None:
    """The rays through the pixel centres of some rows of the window."""
    for y in range(first_row, last_row):
        for x in range(window.width):
            i = y * window.width + x
            o, d, t_min, t_max = camera_ray(camera, window.x0 + x + 0.5, window.y0 + y + 0.5)
            for c in range(3):
                rays.o[i, c], rays.d[i, c] = o[c], d[c]
            rays.t_min[i], rays.t_max[i] = t_min, t_max


@jit
def generate_rays_at(camera: Any, window: Any, rays: Any, pixels: Any) -> None:
    """The rays through the centres of some pixels, numbered row by row through the window."""
    for j in range(len(pixels)):
        y, x = pixels[j] // window.width, pixels[j] % window.width
        o, d, t_min, t_max = camera_ray(camera, window.x0 + x + 0.5, window.y0 + y + 0.5)
        for c in range(3):
            rays.o[j, c], rays.d[j, c] = o[c], d[c]
        rays.t_min[j], rays.t_max[j] = t_min, t_max


# Answers of `find_invalid_ray` if all rays are valid.
ALL_IN_RANGE, OUT_OF_RANGE = -1, -2

# Directions between these have squares, and powers of two in them change no bit of t but its exponent.
MIN_DIRECTION_IN_RANGE, MAX_DIRECTION_IN_RANGE = 2.0**-32, 2.0**32


@jit
def all_finite(v: Vec3) -> bool:
    return math.isfinite(v[0]) and math.isfinite(v[1]) and math.isfinite(v[2])


@jit
def find_invalid_ray(o: Any, d: Any, start: int, stop: int) -> int:
    """The first of rays start..stop that is not finite or has no direction; else whether all their d are PLAIN."""
    plain = True
    for i in range(start, stop):
        length = max_norm(row(d, i))
        if not (length > 0.0 and all_finite(row(o, i)) and all_finite(row(d, i))):
            return i
        plain &= MIN_DIRECTION_IN_RANGE < length < MAX_DIRECTION_IN_RANGE
    return ALL_IN_RANGE if plain else OUT_OF_RANGE
