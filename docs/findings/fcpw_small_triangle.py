"""fcpw 1.2.0: a small triangle is not hit from a distance of 1. Needs fcpw and NumPy alone."""

import fcpw
import numpy as np

for size in (1.0, 1e-2, 1e-3, 1e-4):
    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.array([[0, 0, 0], [size, 0, 0], [0, size, 0]], np.float32, order="F"), 0)
    scene.set_object_triangles(np.array([[0, 1, 2]], np.int32, order="F"), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, False)
    ray = fcpw.ray_3D(np.array([size / 4, size / 4, 1], np.float32), np.array([0, 0, -1], np.float32))
    print(size, "hit" if scene.intersect(ray, fcpw.interaction_3D()) else "MISSED")
