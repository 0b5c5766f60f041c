import numpy as np
import open3d


def trace(v, f, o, d, t_min, t_max):
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(v), f.astype(np.uint32))
    hits = scene.cast_rays(np.column_stack([o, d]).astype(np.float32))
    return hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
