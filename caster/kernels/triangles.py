"""The kind `Triangles`: what triangle, mesh, rectangle, cube and every generated mesh are made of."""

from typing import Any, NamedTuple

import numpy as np

from caster.kernels.corner_box import lies_in_box, moved_into_box
from caster.kernels.jit import implement, jit
from caster.kernels.protocol import Vec3, hull_point, hull_size, intersect, prepare, surface
from caster.kernels.vec import MISS, add, cross, row, scaled, sub, unit


class Triangles(NamedTuple):
    """Indexed triangles in world space."""

    vertices: np.ndarray  # (v, 3) float64
    faces: np.ndarray  # (n, 3) int32
    normals: np.ndarray  # (v, 3) float64, read where smooth
    uv: np.ndarray  # (v, 2) float64, read where textured
    smooth: np.ndarray  # (n,) bool: shading normal from the vertex normals
    textured: np.ndarray  # (n,) bool: uv from the vertices, else the barycentrics b1, b2


@implement(prepare, Triangles)
def _prepare(prims: Any, k: int, o: Vec3) -> Any:
    """The corners seen from the origin; a shared corner gives the same numbers in every triangle."""
    a = sub(row(prims.vertices, prims.faces[k, 0]), o)
    b = sub(row(prims.vertices, prims.faces[k, 1]), o)
    c = sub(row(prims.vertices, prims.faces[k, 2]), o)
    return a, b, c


@jit
def dominant_axis(d: Vec3) -> int:
    """The component of largest magnitude, the lowest on a tie."""
    x, y, z = abs(d[0]), abs(d[1]), abs(d[2])
    if x >= y and x >= z:
        return 0
    return 1 if y >= z else 2


@jit
def flattened(p: Vec3, d: Vec3, axis: int) -> Vec3:
    """p sheared along d onto the plane across the axis, times d[axis], and its height along the axis.

    A function of the corner and the ray alone, so all triangles around a corner agree on where it lies.
    """
    if axis == 0:
        return p[1] * d[0] - d[1] * p[0], p[2] * d[0] - d[2] * p[0], p[0]
    if axis == 1:
        return p[2] * d[1] - d[2] * p[1], p[0] * d[1] - d[0] * p[1], p[1]
    return p[0] * d[2] - d[0] * p[2], p[1] * d[2] - d[1] * p[2], p[2]


@jit
def edge_functions(pre: Any, d: Vec3) -> tuple[float, float, float, float, float, float]:
    """(u, v, w, area, height, slope): scaled barycentrics, their sum, their weighted height along the
    dominant axis, and d there.

    Watertight: u, v, w are differences of two rounded products. Rounding is monotonic, so a difference is
    zero or has the right sign, never the wrong one, and zero counts as inside for both triangles of an edge
    (Woop, Benthin, Wald 2013). The division by d[axis] of the paper is left out: it scales all three alike.

    What belongs to the second and third corner is added up first, here and in `surface`: a mirrored shape
    swaps the two, and so no bit changes.
    """
    axis = dominant_axis(d)
    a, b, c = flattened(pre[0], d, axis), flattened(pre[1], d, axis), flattened(pre[2], d, axis)
    u = c[0] * b[1] - c[1] * b[0]
    v = a[0] * c[1] - a[1] * c[0]
    w = b[0] * a[1] - b[1] * a[0]
    return u, v, w, u + (v + w), u * a[2] + (v * b[2] + w * c[2]), d[axis]


@implement(intersect, Triangles)
def _intersect(prims: Any, pre: Any, d: Vec3, t_min: float) -> float:
    """Seen edge-on up to rounding, u, v, w are noise, and t comes out anywhere along the triangle.

    A tree would lose such a t where the ray enters the triangle's box later, so it is moved into the box.
    A ray that misses the box was let in by a difference rounded to zero; it truly passes the neighbour.
    """
    u, v, w, area, height, slope = edge_functions(pre, d)
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return MISS
    across = area * slope
    if across == 0.0:  # edge-on or without area: nothing to hit
        return MISS
    t = height / across
    if not lies_in_box(pre, d, t):
        t = moved_into_box(pre, d, t)
    return t if t > t_min else MISS


@implement(surface, Triangles)
def _surface(prims: Any, k: int, o: Vec3, d: Vec3, t: float) -> Any:
    i0, i1, i2 = prims.faces[k, 0], prims.faces[k, 1], prims.faces[k, 2]
    a, b, c = row(prims.vertices, i0), row(prims.vertices, i1), row(prims.vertices, i2)
    u, v, w, area, _height, _slope = edge_functions((sub(a, o), sub(b, o), sub(c, o)), d)
    b0, b1, b2 = u / area, v / area, w / area
    p = add(scaled(b0, a), add(scaled(b1, b), scaled(b2, c)))
    n = unit(cross(sub(b, a), sub(c, a)))
    sh_n = n
    if prims.smooth[k]:
        n0, n1, n2 = row(prims.normals, i0), row(prims.normals, i1), row(prims.normals, i2)
        sh_n = unit(add(scaled(b0, n0), add(scaled(b1, n1), scaled(b2, n2))))
    s, r = b1, b2
    if prims.textured[k]:
        s = b0 * prims.uv[i0, 0] + (b1 * prims.uv[i1, 0] + b2 * prims.uv[i2, 0])
        r = b0 * prims.uv[i0, 1] + (b1 * prims.uv[i1, 1] + b2 * prims.uv[i2, 1])
    return p, n, sh_n, s, r


@implement(hull_size, Triangles)
def _hull_size(prims: Any) -> int:
    return 3


@implement(hull_point, Triangles)
def _hull_point(prims: Any, k: int, j: int) -> Vec3:
    return row(prims.vertices, prims.faces[k, j])
