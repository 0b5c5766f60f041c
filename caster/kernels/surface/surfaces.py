"""Rays out of a camera, and surfaces out of hits: each computed once, for what turned out to be visible."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import jit
from caster.kernels.math.vec import max_norm, row
from caster.kernels.protocol import Vec3, camera_ray, normal, surface


class Surfaces(NamedTuple):
    """Where each ray meets the scene; zeros on a miss."""

    p: np.ndarray  # (n, 3) float64
    n: np.ndarray  # (n, 3) geometric normal
    sh_n: np.ndarray  # (n, 3) shading normal
    uv: np.ndarray  # (n, 2)


def no_surfaces(count: int) -> Surfaces:
    return Surfaces(*(np.zeros((count, size)) for size in (3, 3, 3, 2)))


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


# What `survey` says of rays that are all in order, if it is not the number of one that is not.
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


@jit
def find_normals_at(
    prims: Any, ks: Any, where: Any, rays: Any, t: Any, out: Any, start: int, stop: int
) -> None:
    """The geometric normal of primitive ks[j] on ray where[j], for j from start to stop."""
    for j in range(start, stop):
        i = where[j]
        n = normal(prims, ks[j], row(rays.o, i), row(rays.d, i), t[i])
        out[i, 0], out[i, 1], out[i, 2] = n[0], n[1], n[2]


@jit
def find_all_normals(prims: Any, rays: Any, prim: Any, t: Any, out: Any, start: int, stop: int) -> None:
    """The same for all of rays start..stop, given the primitives that they hit; 0 for -1."""
    for i in range(start, stop):
        n = (0.0, 0.0, 0.0)
        if prim[i] >= 0:
            n = normal(prims, prim[i], row(rays.o, i), row(rays.d, i), t[i])
        out[i, 0], out[i, 1], out[i, 2] = n[0], n[1], n[2]


@jit
def find_surfaces(
    prims: Any, ks: Any, where: Any, rays: Any, t: Any, out: Any, start: int, stop: int
) -> None:
    """The surface of primitive ks[j] on ray where[j], for j from start to stop."""
    for j in range(start, stop):
        i = where[j]
        p, n, sh_n, u, v = surface(prims, ks[j], row(rays.o, i), row(rays.d, i), t[i], True)
        for c in range(3):
            out.p[i, c], out.n[i, c], out.sh_n[i, c] = p[c], n[c], sh_n[c]
        out.uv[i, 0], out.uv[i, 1] = u, v
