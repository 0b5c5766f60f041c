"""Polygons of any size, as fans of triangles."""

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def fans(sizes: Indices) -> Indices:
    """Where the corners of the triangles are in a flat list of the polygons' corners.

    sizes: (k,) corners of each polygon, all >= 3. Gives (m, 3): for each polygon (first, i, i + 1), in order.
    """
    first_corner = np.cumsum(sizes) - sizes
    triangles = sizes - 2
    first_triangle = np.cumsum(triangles) - triangles
    first = np.repeat(first_corner, triangles)
    nth = np.arange(len(first)) - np.repeat(first_triangle, triangles)
    return np.stack([first, first + nth + 1, first + nth + 2], axis=1)
