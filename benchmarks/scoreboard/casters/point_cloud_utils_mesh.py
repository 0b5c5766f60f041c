import numpy as np
import point_cloud_utils


def trace(v, f, o, d, t_min, t_max):
    o, d = o.astype(np.float32), d.astype(np.float32)
    _, _, t = point_cloud_utils.ray_mesh_intersection(v, f, o, d)
    return t, None
