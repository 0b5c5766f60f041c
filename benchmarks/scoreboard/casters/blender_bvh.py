import bpy  # noqa: F401 - brings mathutils
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree


def trace(v, f, o, d, t_min, t_max):
    tree = BVHTree.FromPolygons(v.tolist(), f.tolist(), all_triangles=True)
    length, t, n = np.linalg.norm(d, axis=1), np.full(len(o), np.inf), np.zeros((len(o), 3))
    for i, (p, q) in enumerate(zip(o, d, strict=True)):
        _, normal, _, distance = tree.ray_cast(Vector(p), Vector(q))
        if normal is not None:
            t[i], n[i] = distance / length[i], normal
    return t, n
