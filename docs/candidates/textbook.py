"""A ray caster as a textbook has it, with a mistake that many people make. Which one? Ask the judge:

mitsuba-ref validate scenes/one-sphere.toml scenes/inside-sphere.toml --candidate docs.candidates.textbook:trace
"""

import numpy as np


def trace(scene, o, d):
    """t and geometric normal of the nearest hit of each ray; t is inf on a miss."""
    t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
    for shape in scene.shapes:
        for found, normal in hits_of(shape, o, d):
            nearer = found < t
            t[nearer], n[nearer] = found[nearer], normal[nearer]
    return t, n


def hits_of(shape, o, d):
    """(t, normal) of each primitive of a shape, one after the other."""
    if shape.type == "sphere" and not shape.to_world:
        yield sphere(np.array(shape.center), shape.radius, o, d)
    elif shape.type == "plane":
        yield plane(np.array(shape.point), np.array(shape.normal), o, d)
    elif shape.type == "mesh":
        mesh = shape.mesh()
        for face in mesh.faces:
            yield triangle(*mesh.vertices[face], o, d)
    else:
        raise NotImplementedError(f"a {shape.type} is not in this chapter")


def sphere(center, radius, o, d):
    """a t^2 + b t + c = 0."""
    from_center = o - center
    a = (d * d).sum(axis=1)
    b = 2 * (from_center * d).sum(axis=1)
    c = (from_center * from_center).sum(axis=1) - radius**2
    discriminant = b * b - 4 * a * c
    t = (-b - np.sqrt(np.maximum(discriminant, 0))) / (2 * a)
    t = np.where((discriminant >= 0) & (t > 0), t, np.inf)
    return t, (o + np.where(np.isfinite(t), t, 0)[:, None] * d - center) / radius


def plane(point, normal, o, d):
    """n . (o + t d - point) = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((point - o) @ normal) / (d @ normal)
    return np.where(t > 0, t, np.inf), np.broadcast_to(normal, o.shape)


def triangle(a, b, c, o, d):
    """Moeller and Trumbore."""
    ab, ac = b - a, c - a
    p = np.cross(d, ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / (p @ ab)
        u = ((o - a) * p).sum(axis=1) * inverse
        q = np.cross(o - a, ab)
        v = (d * q).sum(axis=1) * inverse
        t = (q @ ac) * inverse
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    normal = np.cross(ab, ac)
    return np.where(inside, t, np.inf), np.broadcast_to(normal, o.shape)
