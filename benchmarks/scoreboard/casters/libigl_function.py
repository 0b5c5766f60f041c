import igl
import numpy as np


def trace(v, f, o, d, t_min, t_max):
    v, f = v.astype(np.float64), f.astype(np.int64)
    hits = [igl.ray_mesh_intersect(p, q, v, f) for p, q in zip(o, d, strict=True)]
    return np.array([min((hit[1] for hit in each), default=np.inf) for each in hits]), None
