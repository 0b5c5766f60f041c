import numpy as np
from raysect.core import Point3D, Ray, Vector3D
from raysect.optical import World
from raysect.primitive import Mesh


def trace(v, f, o, d, t_min, t_max):
    world = World()
    Mesh(v, f, closed=False, smoothing=False, parent=world)
    hits = [world.hit(Ray(Point3D(*p), Vector3D(*q).normalise())) for p, q in zip(o, d, strict=True)]
    t = np.array([hit.ray_distance if hit else np.inf for hit in hits]) / np.linalg.norm(d, axis=1)
    return t, np.array([list(hit.normal) if hit else [0.0, 0.0, 0.0] for hit in hits])
