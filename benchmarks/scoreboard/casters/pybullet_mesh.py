import numpy as np
import pybullet

pybullet.connect(pybullet.DIRECT)


def trace(v, f, o, d, t_min, t_max):
    pybullet.resetSimulation()
    flags = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, vertices=v.tolist(), indices=f.ravel().tolist(), flags=flags
    )
    pybullet.createMultiBody(0, shape)
    reach = 2 * np.linalg.norm(np.abs(v).max(axis=0) + np.abs(o), axis=1) / np.linalg.norm(d, axis=1)
    ends, hits = o + reach[:, None] * d, []  # it takes segments, and returns the fraction of one
    for i in range(0, len(o), 10_000):  # at MAX_RAY_INTERSECTION_BATCH_SIZE the last one has no answer
        part = slice(i, i + 10_000)
        hits += pybullet.rayTestBatch(o[part].tolist(), ends[part].tolist())
    body, _, fraction, _, normal = zip(*hits, strict=True)
    return np.where(np.array(body) < 0, np.inf, np.array(fraction) * reach), np.array(normal)
