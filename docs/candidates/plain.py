"""A ray caster in float32 that keeps the digits it has: spheres, planes, triangles, one after the other.

mitsuba-ref validate scenes -k '(sphere or mesh or triangles) and not hills' --candidate docs.candidates.plain:trace
"""

import numpy as np

TRIANGLES_PER_BATCH = 32


def trace(scene, o, d):
    """float32 arrays: t (n,), inf on a miss, and geometric normals (n, 3)."""
    o, d = o.astype(np.float32), d.astype(np.float32)
    t, n = np.full(len(o), np.inf, np.float32), np.zeros((len(o), 3), np.float32)
    for shape in scene.shapes:
        for found, normal in hits_of(shape, o, d):
            nearer = found < t
            t[nearer], n[nearer] = found[nearer], normal[nearer]
    return t, n


def hits_of(shape, o, d):
    """(t, normal) of some of a shape's primitives at a time."""
    if shape.type == "sphere" and not shape.to_world:
        yield sphere(np.array(shape.center, np.float32), np.float32(shape.radius), o, d)
    elif shape.type == "spheres":
        for center, radius in zip(*shape.spheres(), strict=True):
            yield sphere(center.astype(np.float32), np.float32(radius), o, d)
    elif shape.type == "plane":
        yield plane(np.array(shape.point, np.float32), np.array(shape.normal, np.float32), o, d)
    elif shape.type == "mesh":
        mesh = shape.mesh()
        corners = mesh.vertices[mesh.faces].astype(np.float32)
        for start in range(0, len(corners), TRIANGLES_PER_BATCH):
            yield triangles(corners[start : start + TRIANGLES_PER_BATCH], o, d)
    else:
        raise NotImplementedError(f"no {shape.type}")


def sphere(center, radius, o, d):
    """By the point of closest approach, so that nothing large cancels (Haines et al. 2019)."""
    away = center - o
    dd = (d * d).sum(axis=1)
    middle = (away * d).sum(axis=1) / dd
    closest = middle[:, None] * d - away
    left = radius * radius - (closest * closest).sum(axis=1)
    half = np.sqrt(np.maximum(left, 0) / dd)
    t = np.where(middle > half, middle - half, middle + half)
    t = np.where((left >= 0) & (t > 0), t, np.float32(np.inf))
    return t, closest + np.where(middle > half, -half, half)[:, None] * d


def plane(point, normal, o, d):
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((point - o) @ normal) / (d @ normal)
    return np.where(t > 0, t, np.float32(np.inf)), np.broadcast_to(normal, o.shape)


def triangles(corners, o, d):
    """The nearest of a few. Corners are seen from the origin; neighbours see their edge with opposite signs."""
    a, b, c = (corners[None, :, i] - o[:, None] for i in range(3))
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # (p - q) x (p + q) = 2 p x q, with less to cancel where the corners are far away, as Embree has it
    pairs = ((c, b), (a, c), (b, a))
    edges = np.stack([(d[:, None] * np.cross(p - q, p + q)).sum(axis=2) for p, q in pairs])
    inside = (edges >= 0).all(axis=0) | (edges <= 0).all(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n * a).sum(axis=2) / (d @ n.T)
        t = np.where(inside & (t > 0), t, np.float32(np.inf))
    first = t.argmin(axis=1)
    return t[np.arange(len(o)), first], n[first]
