import numpy as np
from ours import trace as exact


def trace(v, f, o, d, t_min, t_max):
    reach = 4 * np.maximum(v.max(axis=0) - o, o - v.min(axis=0)).max(axis=1)  # as in bullet.cpp
    ends = (o + reach[:, None] * d).astype(np.float32)
    fraction, _ = exact(v, f, o, ends - o, t_min, t_max)
    return fraction.astype(np.float32) * reach, None
