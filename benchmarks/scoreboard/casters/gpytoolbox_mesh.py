import gpytoolbox
import numpy as np


def trace(v, f, o, d, t_min, t_max):
    t, _, _ = gpytoolbox.ray_mesh_intersect(o, d, v.astype(np.float64), f, use_embree=True)
    return t, None
