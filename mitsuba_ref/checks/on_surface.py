"""Our hit lies on the primitive that we say it is on, with its normals: t, p, n and sh_n by float64's bounds.

All other bounds belong to that primitive, so naming a wrong one would make them worthless.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, flat, share_of_bound

NAME = "on_surface"


def ratio(pixels: Pixels) -> np.ndarray:
    """|ours - the same of our primitive, worked out anew| / bound where we hit, inf beside it, 0 where we miss."""
    own = pixels.bounds.own
    with np.errstate(invalid="ignore"):
        error = np.abs(pixels.t_ours - own.t)
    share = np.max(
        [
            share_of_bound(error, own.t_error),
            share_of_bound(apart(flat(pixels.ours, "normal"), own.n), own.n_error),
            share_of_bound(apart(flat(pixels.ours, "shading_normal"), own.sh_n), own.sh_error),
            share_of_bound(apart(flat(pixels.ours, "position"), pixels.point), own.p_error),
        ],
        axis=0,
    )
    return np.where(pixels.hits[0], np.where(own.possible, share, np.inf), 0.0)
