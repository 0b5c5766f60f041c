"""panda3d 1.10.16: the plane of a CollisionPolygon far from the origin is tilted. Needs panda3d and NumPy alone."""

import numpy as np
from panda3d.core import CollisionPolygon, Point3

corners = np.array([[0.125, 0.75, 0.5], [1.25, 0.375, 0.25], [0.625, 1.375, 1.125]])
for offset in (0.0, 10.0, 100.0, 1000.0):
    a, b, c = corners + offset  # exact in float32
    n = np.cross(b - a, c - a)
    normal = np.array(CollisionPolygon(Point3(*a), Point3(*b), Point3(*c)).get_normal())
    print(f"at {offset}: the normal is off by {np.abs(normal - n / np.linalg.norm(n)).max():.1e}")
