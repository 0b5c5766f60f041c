"""Warp's Mesh, on the CPU."""

import numpy as np
import warp as wp

RAYS = wp.array(dtype=wp.vec3)


@wp.kernel
def cast(mesh: wp.uint64, o: RAYS, d: RAYS, t: wp.array(dtype=float), n: RAYS):
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, o[i], d[i], 1.0e30)
    t[i] = wp.where(hit.result, hit.t, wp.inf)
    n[i] = hit.normal


def trace(scene, o, d):
    meshes = [shape.mesh() for shape in scene.shapes]
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + a for mesh, a in zip(meshes, first, strict=False)])
    with wp.ScopedDevice("cpu"):
        v = wp.array(np.concatenate([mesh.vertices for mesh in meshes]), dtype=wp.vec3)
        mesh, (o, d) = (wp.Mesh(v, wp.array(faces.ravel(), dtype=int)), (wp.array(a, dtype=wp.vec3) for a in (o, d)))
        t, n = wp.zeros(len(o), dtype=float), wp.zeros(len(o), dtype=wp.vec3)
        wp.launch(cast, len(o), [mesh.id, o, d, t, n])
    return t.numpy(), n.numpy()
