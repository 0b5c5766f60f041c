import igl
import numpy as np


def trace(v, f, o, d, t_min, t_max):
    v, f = v.astype(np.float64), f.astype(np.int64)
    tree = igl.AABB()
    tree.init(v, f)
    face, t, _ = tree.intersect_ray_first(v, f, o, d)
    return np.where(face < 0, np.inf, t), None
