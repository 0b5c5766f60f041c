"""Packed numbers back into the fields of a scene file, to the bit."""

from typing import Any

import numpy as np


def unit_shape_matrix(part: Any, k: int) -> list[dict[str, Any]]:
    """The to_world that brings the unit shape where the primitive is."""
    rows = np.column_stack([part.to_world[k], part.center[k]])
    return [{"matrix": [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]]}]


# Of half the distance to the next float32: what is so near to the middle may be rounded away from it in float64.
ROUNDING_INTERVAL_FRACTION = 1.0 - 2.0**-20


def unit_vector_rounding_to(n: np.ndarray) -> np.ndarray:
    """A vector of unit length, to float64, whose components round to the float32 numbers n (3,).

    Descriptions bring normals to unit length, and rounding them to float32 gave n; so there is such a vector in the box
    of all that round to n. On the way from the box's corner that is nearest to 0 to the farthest, lengths grow, and
    somewhere they are 1.
    """
    if abs(float(n @ n) - 1.0) <= 2.0**-52:
        return n
    single = np.abs(n).astype(np.float32)
    half = [
        0.5 * (np.nextafter(single, np.float32(end)).astype(np.float64) - single) for end in (0.0, np.inf)
    ]
    low, high = (single + np.where(n == 0.0, 0.0, ROUNDING_INTERVAL_FRACTION * each) for each in half)
    across = high - low
    a, b, c = across @ across, low @ across, low @ low - 1.0
    s = -c / (b + np.sqrt(max(b * b - a * c, 0.0)))
    return np.copysign(low + min(max(s, 0.0), 1.0) * across, n)
