import numpy as np
from meshlib import mrmeshnumpy, mrmeshpy


def trace(v, f, o, d, t_min, t_max):
    part = mrmeshpy.MeshPart(mrmeshnumpy.meshFromFacesVerts(f, v))
    t = np.full(len(o), np.inf)
    for i, (p, q) in enumerate(zip(o.tolist(), d.tolist(), strict=True)):
        line = mrmeshpy.Line3d(mrmeshpy.Vector3d(*p), mrmeshpy.Vector3d(*q))
        hit = mrmeshpy.rayMeshIntersect(part, line, t_min[i], min(t_max[i], np.finfo(float).max))
        if hit:
            t[i] = hit.distanceAlongLine
    return t, None
