import ncollpyde
import numpy as np
from serve import first_of, t_of_points


def trace(v, f, o, d, t_min, t_max):
    volume = ncollpyde.Volume(v, f.astype(np.uint32), validate=False)
    size = np.linalg.norm(np.abs(v).max(axis=0) + np.abs(o), axis=1) / np.linalg.norm(d, axis=1)
    rays, points, _ = volume.intersections(o, o + 2 * size[:, None] * d)  # it takes segments
    return first_of(len(o), rays, t_of_points(o[rays], d[rays], points)), None
