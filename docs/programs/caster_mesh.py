# A scene built in Python, with a mesh from arrays.
import numpy as np

import caster

vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float64)
faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
mesh = caster.Mesh(vertices, faces, to_world={"scale": 2})
camera = caster.Pinhole(eye=(3.0, 2.0, 5.0), look_at=(0.5, 0.5, 0.5))
scene = caster.Scene(camera=camera, shapes=(mesh, caster.Sphere(radius=0.3)))
print(scene, caster.render(scene, aovs=("depth", "prim_id")))
