import fcpw
import numpy as np


def trace(v, f, o, d, t_min, t_max):
    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.asfortranarray(v, np.float32), 0)
    scene.set_object_triangles(np.asfortranarray(f, np.int32), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, True)
    t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
    for i, (p, q) in enumerate(zip(o.astype(np.float32), d.astype(np.float32), strict=True)):
        hit, far = fcpw.interaction_3D(), np.float32(min(t_max[i], np.finfo(np.float32).max))
        if scene.intersect(fcpw.ray_3D(p, q, far), hit):
            t[i], n[i] = hit.d, hit.n
    return t, n
