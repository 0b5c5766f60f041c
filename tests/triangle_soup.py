"""Triangles without common vertices, vertex normals and uv."""

import numpy as np

from caster.kernels.triangles import Triangles


def triangle_soup(corners: np.ndarray) -> Triangles:
    """One triangle for each three rows of corners (3 n, 3)."""
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    unused = np.zeros(len(faces), bool)
    return Triangles(corners, faces, np.zeros_like(corners), np.zeros((len(corners), 2)), unused, unused)
