import numpy as np
from panda3d import core


def trace(v, f, o, d, t_min, t_max):
    root, polygons, ray = core.NodePath("root"), core.CollisionNode("mesh"), core.CollisionRay()
    for a, b, c in v[f].tolist():
        polygons.add_solid(core.CollisionPolygon(core.Point3(*a), core.Point3(*b), core.Point3(*c)))
        polygons.add_solid(core.CollisionPolygon(core.Point3(*c), core.Point3(*b), core.Point3(*a)))  # one-sided
    root.attach_new_node(polygons)
    caster = root.attach_new_node(core.CollisionNode("ray"))
    caster.node().add_solid(ray)
    queue, traverser, t = core.CollisionHandlerQueue(), core.CollisionTraverser(), np.full(len(o), np.inf)
    traverser.add_collider(caster, queue)
    for i, (p, q) in enumerate(zip(o.tolist(), d.tolist(), strict=True)):
        ray.set_origin(*p), ray.set_direction(*q)
        traverser.traverse(root)
        points = np.array([each.get_surface_point(root) for each in queue.entries]).reshape(-1, 3)
        t[i] = (((points - o[i]) @ d[i]) / (d[i] @ d[i])).min(initial=np.inf)
    return t, None
