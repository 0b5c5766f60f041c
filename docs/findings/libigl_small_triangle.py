"""libigl 2.6.3: a triangle whose determinant with the ray is below 1e-6 is not hit. Needs libigl, NumPy and SciPy."""

import igl
import numpy as np

corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
faces = np.array([[0, 1, 2]])
for size in (1.0, 1e-2, 1e-3, 1e-4):
    o, d = np.array([0.25, 0.25, 1.0]) * size, np.array([0.0, 0.0, -1.0])
    alone = igl.ray_mesh_intersect(o, d, corners * size, faces)
    tree = igl.AABB()
    tree.init(corners * size, faces)
    face, _, _ = tree.intersect_ray_first(corners * size, faces, o[None], d[None])
    print(size, "ray_mesh_intersect:", "hit" if alone else "MISSED", "AABB:", "hit" if np.all(face >= 0) else "MISSED")
