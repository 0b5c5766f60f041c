"""Surfaces of many hits at once: SURFACE_LANES pixels of a tile in a scratch that stays in a core's first cache.

Field f of lane x is scratch[f * SURFACE_LANES + x]: what is computed, and behind that what the kind of primitive needs
of each lane's primitive. Gathering that is a scalar loop over runs of pixels; the rest has no branch.
"""

from typing import Any

import numpy as np

from caster.jit.decorators import inlined
from caster.kernels.protocol import Vec3
from caster.kernels.raster.tile import CACHE_LINE, lane

SURFACE_LANES = 32  # 16, 64 and 128 are slower or no faster; a row of a tile is whole scratches

# The first 11 are those of a surface buffer (surface/per_hit.py), in its order; LANE_LOCAL: what `fast_uv` reads.
LANE_P, LANE_N, LANE_SH_N, LANE_UV, LANE_UNSAFE, LANE_LOCAL, LANE_SETUP = (
    lane(SURFACE_LANES * field) for field in (0, 3, 6, 9, 11, 12, 15)
)
LANE_FIELDS = 41  # with the largest `surface_setup`, that of triangles
NEXT, NEXT_BUT_ONE = lane(SURFACE_LANES), lane(2 * SURFACE_LANES)


def new_lanes() -> np.ndarray:
    """Zeros, from the beginning of a cache line."""
    buffer = np.zeros(LANE_FIELDS * SURFACE_LANES + CACHE_LINE // 8)
    first = -buffer.ctypes.data % CACHE_LINE // 8
    return buffer[first : first + LANE_FIELDS * SURFACE_LANES]


@inlined
def get_lane(scratch: Any, at: Any) -> Vec3:
    """Three fields of a lane."""
    return scratch[at], scratch[at + NEXT], scratch[at + NEXT_BUT_ONE]


@inlined
def put_lane(scratch: Any, at: Any, v: Vec3) -> None:
    scratch[at], scratch[at + NEXT], scratch[at + NEXT_BUT_ONE] = v[0], v[1], v[2]
