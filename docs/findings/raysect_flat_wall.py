"""raysect 0.9.1: rays onto a mesh in one plane along the axes; some are not hit. Needs raysect and NumPy alone."""

import numpy as np
from raysect.core import Point3D, Ray, Vector3D
from raysect.optical import World
from raysect.primitive import Mesh

world = World()
corners = np.array([[-1.5, -1.25, -2.0], [2.5, -1.25, -2.0], [2.5, 1.75, -2.0], [-1.5, 1.75, -2.0]])
Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), closed=False, parent=world)
grid = [Vector3D(x - 0.5, y - 0.25, -5.0) for x in np.linspace(-1.4, 2.4, 200) for y in np.linspace(-1.2, 1.7, 200)]
missed = sum(world.hit(Ray(Point3D(0.5, 0.25, 3.0), d.normalise())) is None for d in grid)
print(f"{missed} of {len(grid)} rays MISSED")
