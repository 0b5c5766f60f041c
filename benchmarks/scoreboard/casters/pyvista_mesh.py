import numpy as np
import pyvista
from serve import t_of_points


def trace(v, f, o, d, t_min, t_max):
    mesh = pyvista.PolyData.from_regular_faces(v.astype(np.float64), f)
    reach = 2 * np.linalg.norm(np.abs(v).max(axis=0) + np.abs(o), axis=1) / np.linalg.norm(d, axis=1)
    t = np.full(len(o), np.inf)
    for i in range(len(o)):  # it takes segments
        points, _ = mesh.ray_trace(o[i], o[i] + reach[i] * d[i])
        t[i] = t_of_points(o[[i]], d[[i]], np.reshape(points, (-1, 3))).min(initial=np.inf)
    return t, None
