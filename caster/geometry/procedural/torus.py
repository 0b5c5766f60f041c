"""A ring around the z axis."""

import math

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.mesh import Floats, Ints, Mesh
from caster.geometry.procedural.parameters import check_integer, check_length

MAX_PARTS = 4096  # 4096 * 4096 * 2 faces at most


def torus(major_radius: float, minor_radius: float, segments: int, sides: int) -> Mesh:
    """2 * segments * sides faces on a torus around z, with shared vertices, no seam and no uv.

    major_radius: from the origin to the middle of the tube; minor_radius: of the tube, smaller; scene units.
    segments: parts around z; sides: parts around the tube; 3 to 4096 each. The normals are the exact torus's.
    Raises SceneError for anything else.
    """
    _check(major_radius, minor_radius, segments, sides)
    around, across = _turn(segments)[:, None], _turn(sides)[None, :]
    x, y = np.cos(around) * np.cos(across), np.sin(around) * np.cos(across)
    z = np.broadcast_to(np.sin(across), x.shape)
    normals = np.stack([x, y, z], axis=2)
    middle = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=2)
    vertices = major_radius * middle + minor_radius * normals
    return Mesh(vertices.reshape(-1, 3), _faces(segments, sides), normals.reshape(-1, 3))


def _check(major_radius: float, minor_radius: float, segments: int, sides: int) -> None:
    check_length("torus", "major_radius", major_radius)
    check_length("torus", "minor_radius", minor_radius)
    if minor_radius >= major_radius:
        raise SceneError(
            f"torus: minor_radius must be smaller than major_radius ({major_radius!r}), got {minor_radius!r}"
        )
    check_integer("torus", "segments", segments, 3, MAX_PARTS)
    check_integer("torus", "sides", sides, 3, MAX_PARTS)


def _turn(parts: int) -> Floats:
    return 2.0 * math.pi * np.arange(parts) / parts


def _faces(segments: int, sides: int) -> Ints:
    """Two triangles for each of segments * sides quads; the last row and column join the first."""
    number = np.arange(segments * sides).reshape(segments, sides)
    here, on = number, np.roll(number, -1, axis=0)
    up, on_up = np.roll(here, -1, axis=1), np.roll(on, -1, axis=1)
    quads = np.stack([here, on, on_up, here, on_up, up], axis=2)
    return quads.reshape(-1, 3).astype(np.int32)
