import mujoco
import numpy as np


def trace(v, f, o, d, t_min, t_max):
    spec = mujoco.MjSpec()
    spec.add_mesh(name="m", uservert=v.ravel(), userface=f.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom, n = np.zeros(1, np.int32), np.zeros((len(o), 3))
    t = np.array([mujoco.mj_ray(model, data, o[i], d[i], None, 1, -1, geom, n[i]) for i in range(len(o))])
    return np.where(t < 0, np.inf, t), n
