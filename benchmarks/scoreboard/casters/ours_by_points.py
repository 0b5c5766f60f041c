import os

import numpy as np
from ours import trace as exact
from serve import t_of_points


def trace(v, f, o, d, t_min, t_max):
    t, _ = exact(v, f, o, d, t_min, t_max)
    with np.errstate(invalid="ignore"):
        points = (o + t[:, None] * d).astype(os.environ["POINTS"])
    return t_of_points(o, d, np.where(np.isfinite(points), points, np.nan)), None
