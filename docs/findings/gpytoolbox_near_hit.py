"""gpytoolbox 0.3.8: a hit nearer than about 1e-4 is lost. Needs gpytoolbox and NumPy alone."""

import gpytoolbox
import numpy as np

corners, faces = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]), np.array([[0, 1, 2]])
for distance in (1.0, 1e-2, 1e-3, 1e-4, 1e-5):
    o, d = np.array([[1.0, 1.0, distance]]), np.array([[0.0, 0.0, -1.0]])
    t, _, _ = gpytoolbox.ray_mesh_intersect(o, d, corners, faces)
    print(distance, "hit" if np.isfinite(t).all() else "MISSED")
