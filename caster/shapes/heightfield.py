"""A triangulated terrain whose height is a seeded sum of sine waves."""

import inspect
import math
from random import Random
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from caster.description.fields import NonNegative, Positive
from caster.description.transform import power, sine_and_cosine
from caster.geometry.triangle_mesh import Floats, Mesh, grid_faces, normalize_rows
from caster.geometry.world_space import MeshShape
from caster.kernels.math.angles import sinc_and_cos

VERTICES_PER_CHUNK = 1 << 16  # vertices; temporaries take some 200 bytes each

_series_of_arrays = inspect.unwrap(sinc_and_cos)

# Periods across the square: from one, since fewer look flat, to a dozen, since more need a fine grid.
MAX_PERIODS_ACROSS = 12.0

# A wave, height * sin(kx x + ky y + phase), on a grid: kx, ky, height, and the sines and cosines of kx x for the
# columns and of ky y + phase for the rows.
Wave = tuple[float, float, float, tuple[Floats, Floats], tuple[Floats, Floats]]

# The quarter turn as a sum of two numbers, of which the first has so few bits that its multiples are exact.
QUARTER_TURN = 1.5707963267341256, 6.077100506506192e-11


def _sines_and_cosines(angles: Floats) -> tuple[Floats, Floats]:
    """(sin, cos) of angles below 2^20 radians, each within 2^-51; the same bits on every machine."""
    quarters = np.rint(angles / (0.5 * math.pi))
    h = (angles - quarters * QUARTER_TURN[0]) - quarters * QUARTER_TURN[1]
    sinc, cosine = _series_of_arrays(h * h)
    swap, place = quarters % 2.0, quarters % 4.0
    sine, cosine = swap * cosine + (1.0 - swap) * (h * sinc), swap * (h * sinc) + (1.0 - swap) * cosine
    return np.where(place >= 2.0, -sine, sine), np.where((place == 1.0) | (place == 2.0), -cosine, cosine)


class Heightfield(MeshShape):
    """A square terrain of side `size` around the origin, its height a seeded sum of sine waves."""

    type: Literal["heightfield"] = "heightfield"
    size: Positive = 2.0  # scene units
    resolution: Annotated[int, Field(strict=True, ge=1, le=4096)] = 64  # 33,554,432 faces at most
    amplitude: NonNegative = 0.2  # scene units
    waves: Annotated[int, Field(strict=True, ge=1, le=64)] = 8
    seed: Annotated[int, Field(strict=True, ge=0)] = 0

    def _drawn_waves(self) -> list[Wave]:
        """Random waves of equal steepness: heights are proportional to wavelengths and add up to `amplitude`."""
        draw = Random(self.seed).random  # unlike NumPy's generators, guaranteed never to change
        periods = [power(MAX_PERIODS_ACROSS, draw()) for _ in range(self.waves)]  # log-uniform
        scale = self.amplitude / sum(1.0 / n for n in periods)
        grid = (np.arange(self.resolution + 1) / self.resolution - 0.5) * self.size
        waves: list[Wave] = []
        for n in periods:
            k = 2.0 * math.pi * n / self.size
            y, x = sine_and_cosine(2.0 * math.pi * draw())
            phase = 2.0 * math.pi * draw()
            columns, rows = _sines_and_cosines(k * x * grid), _sines_and_cosines(k * y * grid + phase)
            waves.append((k * x, k * y, scale / n, columns, rows))
        return waves

    def mesh(self) -> Mesh:
        """2 * resolution^2 faces over the square [-size/2, size/2]^2 of the plane z = 0, seen from +z.

        |z| <= amplitude. The seed draws direction, length and phase of each wave, the same on all machines. Normals are
        the exact surface's; uv runs from (0, 0) to (1, 1).
        """
        side = self.resolution + 1
        drawn = self._drawn_waves()
        number = np.arange(side * side, dtype=np.int32)
        uv = np.stack([number % side, number // side], axis=1) / self.resolution
        vertices, normals = np.empty((len(uv), 3)), np.empty((len(uv), 3))
        vertices[:, :2] = (uv - 0.5) * self.size
        rows = max(1, VERTICES_PER_CHUNK // side)
        for first in range(0, side, rows):  # along y
            some = slice(first, min(first + rows, side))
            band = slice(some.start * side, some.stop * side)
            z, slope_x, slope_y = np.zeros((3, some.stop - some.start, side))
            for kx, ky, height, (sine_x, cosine_x), row_waves in drawn:  # by the sine and cosine of a sum
                sine_y, cosine_y = (each[some, None] for each in row_waves)
                z += height * (sine_x * cosine_y + cosine_x * sine_y)
                slope = height * (cosine_x * cosine_y - sine_x * sine_y)
                slope_x += kx * slope
                slope_y += ky * slope
            vertices[band, 2] = z.ravel()
            normals[band] = normalize_rows(np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=2).reshape(-1, 3))
        return Mesh(vertices, grid_faces(number.reshape(side, side)), normals, uv)
