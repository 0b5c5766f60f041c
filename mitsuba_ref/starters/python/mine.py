import numpy as np


def trace(scene, o, d):
    """The nearest hit of each ray: t (n,), normals (n, 3). o, d: (n, 3) float64."""
    t_hit, n_hit = np.full(len(o), np.inf), np.zeros((len(o), 3))
    for a, b, c in scene.triangles():
        e1, e2 = b - a, c - a
        p = np.cross(d, e2)
        det = p @ e1
        hit = det != 0.0  # not parallel
        det[~hit] = 1.0
        s = (o - a) / det[:, None]
        q = np.cross(s, e1)
        u, v, t = (s * p).sum(axis=1), (q * d).sum(axis=1), q @ e2
        hit &= (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < t_hit)
        t_hit[hit], n_hit[hit] = t[hit], np.cross(e1, e2)
    return t_hit, n_hit
