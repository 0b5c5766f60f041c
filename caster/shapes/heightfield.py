"""A triangulated terrain whose height is a seeded sum of sine waves."""

import inspect
import math
from random import Random
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from caster.description.fields import NonNegative, Positive
from caster.description.transform import power, sine_and_cosine
from caster.geometry.triangle_mesh import Floats, Mesh, grid_faces, normalize_rows
from caster.geometry.world_space import MeshShape
from caster.kernels.math.angles import sinc_and_cos

__all__ = ["Heightfield"]

VERTICES_PER_CHUNK = 1 << 16  # vertices; temporaries take some 200 bytes each

_series_of_arrays = inspect.unwrap(sinc_and_cos)

# Periods across the square: fewer than one look flat, more than a dozen need a fine grid.
MIN_PERIODS_ACROSS, MAX_PERIODS_ACROSS = 1.0, 12.0


class _Wave(NamedTuple):
    """The wave height * sin(kx x + ky y + phase) on a grid.

    columns, rows: sines and cosines of kx x for the columns and of ky y + phase for the rows.
    """

    kx: float
    ky: float
    height: float
    columns: tuple[Floats, Floats]
    rows: tuple[Floats, Floats]


def _draw(size: float, resolution: int, amplitude: float, waves: int, seed: int) -> list[_Wave]:
    """Random waves of about equal steepness: amplitudes are proportional to wavelengths and add up to `amplitude`."""
    draw = Random(seed).random  # unlike NumPy's generators, guaranteed never to change
    across = [MIN_PERIODS_ACROSS * power(MAX_PERIODS_ACROSS / MIN_PERIODS_ACROSS, draw()) for _ in range(waves)]
    scale = amplitude / sum(1.0 / n for n in across)
    place = (np.arange(resolution + 1) / resolution - 0.5) * size
    result = []
    for n in across:
        k, (y, x) = 2.0 * math.pi * n / size, sine_and_cosine(2.0 * math.pi * draw())
        phase = 2.0 * math.pi * draw()
        columns, rows = _sines_and_cosines(k * x * place), _sines_and_cosines(k * y * place + phase)
        result.append(_Wave(k * x, k * y, scale / n, columns, rows))
    return result


def _surface(waves: list[_Wave], rows: slice) -> tuple[Floats, Floats]:
    """z and the unit normal, (-dz/dx, -dz/dy, 1) normalized, of some rows; by the sine and cosine of a sum."""
    z, slope_x, slope_y = np.zeros((3, rows.stop - rows.start, len(waves[0].columns[0])))
    for wave in waves:
        sine_x, cosine_x = wave.columns
        sine_y, cosine_y = (each[rows, None] for each in wave.rows)
        z += wave.height * (sine_x * cosine_y + cosine_x * sine_y)
        slope = wave.height * (cosine_x * cosine_y - sine_x * sine_y)
        slope_x += wave.kx * slope
        slope_y += wave.ky * slope
    normals = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=2)
    return z.ravel(), normalize_rows(normals.reshape(-1, 3))


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

    def mesh(self) -> Mesh:
        """2 * resolution^2 faces over the square [-size/2, size/2]^2 of the plane z = 0, seen from +z.

        |z| <= amplitude. The seed draws direction, length and phase of each wave, the same on all machines. Normals are
        the exact surface's; uv runs from (0, 0) to (1, 1).
        """
        side = self.resolution + 1
        drawn = _draw(self.size, self.resolution, self.amplitude, self.waves, self.seed)
        number = np.arange(side * side, dtype=np.int32)
        uv = np.stack([number % side, number // side], axis=1) / self.resolution
        vertices, normals = np.empty((len(uv), 3)), np.empty((len(uv), 3))
        vertices[:, :2] = (uv - 0.5) * self.size
        rows = max(1, VERTICES_PER_CHUNK // side)
        for first in range(0, side, rows):  # along y
            some = slice(first, min(first + rows, side))
            band = slice(some.start * side, some.stop * side)
            vertices[band, 2], normals[band] = _surface(drawn, some)
        return Mesh(vertices, grid_faces(number.reshape(side, side)), normals, uv)
