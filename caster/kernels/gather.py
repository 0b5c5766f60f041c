"""Rays out of a camera, and surfaces out of hits: each computed once, for what turned out to be visible."""

from typing import Any, NamedTuple

import numpy as np

from caster.kernels.jit import jit
from caster.kernels.protocol import ray, surface
from caster.kernels.vec import row


class Surfaces(NamedTuple):
    """Where each ray meets the scene; zeros on a miss."""

    p: np.ndarray  # (n, 3) float64
    n: np.ndarray  # (n, 3) geometric normal
    sh_n: np.ndarray  # (n, 3) shading normal
    uv: np.ndarray  # (n, 2)


def no_surfaces(count: int) -> Surfaces:
    return Surfaces(*(np.zeros((count, size)) for size in (3, 3, 3, 2)))


@jit
def shoot(camera: Any, window: Any, rays: Any, first_row: int, last_row: int) -> None:
    """The rays through the pixel centres of some rows of the window."""
    for y in range(first_row, last_row):
        for x in range(window.width):
            i = y * window.width + x
            o, d, t_min, t_max = ray(camera, window.x0 + x + 0.5, window.y0 + y + 0.5)
            for c in range(3):
                rays.o[i, c], rays.d[i, c] = o[c], d[c]
            rays.t_min[i], rays.t_max[i] = t_min, t_max


@jit
def shoot_at(camera: Any, window: Any, rays: Any, pixels: Any) -> None:
    """The rays through the centres of some pixels, numbered row by row through the window."""
    for j in range(len(pixels)):
        y, x = pixels[j] // window.width, pixels[j] % window.width
        o, d, t_min, t_max = ray(camera, window.x0 + x + 0.5, window.y0 + y + 0.5)
        for c in range(3):
            rays.o[j, c], rays.d[j, c] = o[c], d[c]
        rays.t_min[j], rays.t_max[j] = t_min, t_max


@jit
def find_surfaces(prims: Any, ks: Any, where: Any, rays: Any, t: Any, out: Any) -> None:
    """The surface of primitive ks[j] on ray where[j], for every j."""
    for j in range(len(where)):
        i = where[j]
        p, n, sh_n, u, v = surface(prims, ks[j], row(rays.o, i), row(rays.d, i), t[i], True)
        for c in range(3):
            out.p[i, c], out.n[i, c], out.sh_n[i, c] = p[c], n[c], sh_n[c]
        out.uv[i, 0], out.uv[i, 1] = u, v
