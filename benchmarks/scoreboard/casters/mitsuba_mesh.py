import os

import mitsuba
import numpy as np

mitsuba.set_variant(os.environ["MITSUBA_VARIANT"])


def trace(v, f, o, d, t_min, t_max):
    mesh = mitsuba.Mesh("mesh", len(v), len(f))
    values = mitsuba.traverse(mesh)
    values["vertex_positions"], values["faces"] = v.ravel(), f.ravel()
    values.update()
    scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
    if "scalar" not in mitsuba.variant():
        hit = scene.ray_intersect(mitsuba.Ray3f(mitsuba.Point3f(o.T), mitsuba.Vector3f(d.T)))
        return np.array(hit.t), np.array(hit.n).T
    hits = [scene.ray_intersect(mitsuba.Ray3f(p, q)) for p, q in zip(o, d, strict=True)]
    return np.array([hit.t for hit in hits]), np.array([hit.n for hit in hits])
