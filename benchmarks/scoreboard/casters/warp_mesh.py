import warp as wp

RAYS = wp.array(dtype=wp.vec3)


@wp.kernel
def cast(mesh: wp.uint64, o: RAYS, d: RAYS, t: wp.array(dtype=float), n: RAYS):
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, o[i], d[i], 1.0e30)
    t[i] = wp.where(hit.result, hit.t, wp.inf)
    n[i] = hit.normal


def trace(v, f, o, d, t_min, t_max):
    with wp.ScopedDevice("cpu"):
        mesh = wp.Mesh(wp.array(v, dtype=wp.vec3), wp.array(f.ravel(), dtype=int))
        o, d = (wp.array(a, dtype=wp.vec3) for a in (o, d))
        t, n = wp.zeros(len(o), dtype=float), wp.zeros(len(o), dtype=wp.vec3)
        wp.launch(cast, len(o), [mesh.id, o, d, t, n])
    return t.numpy(), n.numpy()
