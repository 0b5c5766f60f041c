"""Exact intersection with each kind of primitive.

Planes by a linear equation, triangles by signs of determinants, spheres and round segments by quadratic equations, and
unit shapes under a matrix by its exact inverse.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, cross, dot, shifted, sign_with_root, sub
from mitsuba_ref.oracle.implicit_surfaces import ImplicitSurface, Vector
from mitsuba_ref.oracle.interface import ExactKind, Roots, boxes_around


def intersect_plane(plane: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
    """All p with normal . (p - point) = 0; the scale of the normal does not matter. A ray in the plane misses it."""
    normal, point = plane
    height, slope = dot(normal, sub(shifted(point, bits), ray.o)), dot(normal, ray.d)
    return ((Root(height, 0, 0, slope, ray.e), "inside"),) if slope else ()


PLANES = ExactKind(
    boxes=lambda prims: boxes_around(prims.point, np.inf),  # all of space
    vectors=lambda prims, k: np.stack([prims.normal[k], prims.point[k]], axis=-2),
    intersect=intersect_plane,
    surface=lambda plane: ImplicitSurface(plane[1], (plane[0],)),
)


# Embree drops a face with a coordinate as large as this, and so does the oracle.
LARGEST_COORDINATE = 1844 * 10**15

WHERE = ("inside", "edge", "vertex")  # by the number of edge functions that are 0


def intersect_triangle(corners: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
    """With corners a, b, c relative to o and normal N: t d.N = a.N, where a.N = a.(b x c) and d.N = U + V + W.

    A ray in the plane of the triangle misses it.
    """
    a, b, c = (sub(shifted(corner, bits), ray.o) for corner in corners)
    bc = cross(b, c)
    u, v, w = dot(ray.d, bc), dot(ray.d, cross(c, a)), dot(ray.d, cross(a, b))
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return ()
    area = u + v + w
    if area == 0 or any(abs(x) >= LARGEST_COORDINATE << (ray.ko - bits) for corner in corners for x in corner):
        return ()
    return ((Root(dot(a, bc), 0, 0, area, ray.e), WHERE[(u == 0) + (v == 0) + (w == 0)]),)


def triangle_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (prims.vertices[corner] for corner in prims.faces.T)
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def triangle_surface(corners: Sequence[Vector]) -> ImplicitSurface:
    a, b, c = corners
    return ImplicitSurface(a, (cross(sub(b, a), sub(c, a)),), corners=(a, b, c))


TRIANGLES = ExactKind(
    triangle_boxes,
    vectors=lambda prims, k: prims.vertices[prims.faces[k]],
    intersect=intersect_triangle,
    # all but faces with a corner that is nowhere
    present=lambda prims: np.isfinite(prims.vertices).all(axis=1)[prims.faces].all(axis=1),
    surface=triangle_surface,
)


class ObjectRay(NamedTuple):
    """A ray in the object space of a unit shape, scaled up: (o + s d) / size, where t = s 2^e."""

    o: Integers3
    d: Integers3
    size: int  # the determinant, not 0
    e: int


def cofactors(a: Any, b: Any, c: Any) -> tuple[Any, Any]:
    """(rows of the adjugate, determinant) of the matrix with these columns, in any numbers."""
    rows = cross(b, c), cross(c, a), cross(a, b)
    return rows, dot(a, rows[0])


def in_object_space(
    intersect_unit_shape: Callable[[ObjectRay], Roots],
) -> Callable[[Sequence[Integers3], int, IntegerRay], Roots]:
    """ExactKind.intersect of a unit shape under a matrix, from that of the shape.

    The inverse is the adjugate over the determinant, which has one length more: its unit is shifted.
    """

    def intersect(affine: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
        center, *columns = affine
        (x, y, z), determinant = cofactors(*columns)
        if not determinant:
            return ()
        o, d = ((dot(x, v), dot(y, v), dot(z, v)) for v in (sub(ray.o, shifted(center, bits)), ray.d))
        return intersect_unit_shape(ObjectRay(o, d, determinant << bits, ray.e))

    return intersect


# A sum of three magnitudes and this product take three roundings, each down by at most 2^-53 of the result.
ROUNDED_UP = 1.0 + 8 * 2.0**-53


def affine_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around the image of the cube [-1, 1]^3."""
    with np.errstate(over="ignore"):
        return boxes_around(prims.center, np.abs(prims.to_world).sum(axis=2) * ROUNDED_UP)


def line_sphere_roots(o: Integers3, d: Integers3, size: int, e: int) -> list[Root]:
    """All t = s 2^e with |o + s d| = size, ascending: two, one for a tangent, or none. d != 0.

    a s^2 + 2 b s + c = 0 with a = d.d, b = o.d, c = o.o - size^2, so s = (-b -+ sqrt(b^2 - a c)) / a.
    """
    a, b = dot(d, d), dot(o, d)
    inside = b * b - a * (dot(o, o) - size * size)
    if inside < 0:
        return []
    return [Root(-b, side, inside, a, e) for side in ((-1, 1) if inside else (0,))]


def intersect_sphere(sphere: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
    """All p with |p - center| = radius."""
    center, (radius, *_) = sphere
    return _closed(line_sphere_roots(sub(ray.o, shifted(center, bits)), ray.d, radius << bits, ray.e))


@in_object_space
def intersect_ellipsoid(ray: ObjectRay) -> Roots:
    return _closed(line_sphere_roots(*ray))


def _closed(roots: list[Root]) -> Roots:
    where = "tangent" if len(roots) == 1 else "inside"
    return tuple((root, where) for root in roots)


@in_object_space
def intersect_cylinder(ray: ObjectRay) -> Roots:
    """Roots of the circle in x and y that have z between 0 and size. A ray along the axis misses it."""
    o, d, size, e = ray
    if not (d[0] or d[1]):
        return ()
    found = []
    for root, where in _closed(line_sphere_roots((o[0], o[1], 0), (d[0], d[1], 0), size, e)):
        from_ends = height(root, o[2], d[2]) * height(root, o[2] - size, d[2])
        if from_ends <= 0:
            found.append((root, where if from_ends or where == "tangent" else "rim"))
    return tuple(found)


@in_object_space
def intersect_disk(ray: ObjectRay) -> Roots:
    """z is 0 at s = -o.z / d.z; x^2 + y^2 there is compared with size^2, both times d.z^2.

    A ray in the plane of the disk misses it.
    """
    (ox, oy, oz), (dx, dy, dz), size, e = ray
    if not dz:
        return ()
    x, y = ox * dz - oz * dx, oy * dz - oz * dy
    beyond = x * x + y * y - (size * dz) ** 2
    if beyond > 0:
        return ()
    return ((Root(-oz, 0, 0, dz, e), "inside" if beyond else "rim"),)


def height(root: Root, o: int, d: int) -> int:
    """Sign of o + s d at the root s = (p + q sqrt(r)) / a, a > 0."""
    return sign_with_root(root.s * o + root.p * d, root.q * d, root.r)


def enter_segment(segment: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
    """Where the line enters the hull: of the cone and both spheres the one root that lies on it.

    The hull of the spheres around both ends is the union of spheres around start + v axis with radii r + v grow,
    0 <= v <= 1. A point at s d is on the sphere v that touches the cone there if size v = (o + s d) . axis + r grow,
    where size = axis^2 - grow^2; those with v < 0 and v > 1 are on the spheres. With h = o + s d, the cone is
    size (h^2 - r^2) = (h . axis + r grow)^2.
    """
    start, end, (r, q, _) = (shifted(v, bits) for v in segment)
    o, axis, grow, e = sub(ray.o, start), sub(end, start), q - r, ray.e
    size, lift, rise = dot(axis, axis) - grow * grow, dot(o, axis) + r * grow, dot(ray.d, axis)
    at_start, at_end = line_sphere_roots(o, ray.d, r, e)[:1], line_sphere_roots(sub(o, axis), ray.d, q, e)[:1]
    found = [root for root in at_start if height(root, lift, rise) < 0]
    found += [root for root in at_end if height(root, lift - size, rise) > 0]
    a = size * dot(ray.d, ray.d) - rise * rise
    if size > 0:
        on_cone = entering_roots(a, size * dot(o, ray.d) - lift * rise, size * (dot(o, o) - r * r) - lift * lift, e)
        found += [root for root in on_cone if height(root, lift, rise) >= 0 >= height(root, lift - size, rise)]
    return tuple((root, "inside" if root.q or not a else "tangent") for root in found)


def entering_roots(a: int, b: int, c: int, e: int) -> list[Root]:
    """The t = s 2^e at which a s^2 + 2 b s + c is 0 and does not increase: at most one."""
    if a == 0:
        return [Root(-c, 0, 0, 2 * b, e)] if b < 0 else []
    inside = b * b - a * c
    return [Root(-b, -1, inside, a, e)] if inside >= 0 else []


def segment_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    low, high = boxes_around(prims.start, prims.radius[:, :1])
    end_low, end_high = boxes_around(prims.end, prims.radius[:, 1:])
    return np.minimum(low, end_low), np.maximum(high, end_high)


def affine_surface(affine: Sequence[Vector], used: slice = slice(3), *, flat: bool = False) -> ImplicitSurface:
    """In object space scaled by the determinant; the rows are those of the adjugate. used: the coordinates in it."""
    center, *columns = affine
    rows, determinant = cofactors(*columns)
    return ImplicitSurface(center, rows[used], None if flat else determinant)


SPHERES = ExactKind(
    boxes=lambda prims: boxes_around(prims.center, prims.radius[:, None]),
    # the centre, and the radius three times
    vectors=lambda prims, k: np.stack([prims.center[k], prims.radius[k, None].repeat(3, axis=-1)], axis=-2),
    intersect=intersect_sphere,
    surface=lambda sphere: ImplicitSurface(sphere[0], size=sphere[1][0]),
)
# Without a surface: a hull is one of three by where p is on it, no zero of one polynomial.
SEGMENTS = ExactKind(
    segment_boxes,
    # start and end, and the radii there, the second twice
    vectors=lambda prims, k: np.stack([prims.start[k], prims.end[k], prims.radius[k][..., [0, 1, 1]]], axis=-2),
    intersect=enter_segment,
)
ELLIPSOIDS = ExactKind(
    affine_boxes,
    # the centre and the columns of the matrix
    vectors=lambda prims, k: np.concatenate(
        [prims.center[k][..., None, :], prims.to_world[k].swapaxes(-1, -2)], axis=-2
    ),
    intersect=intersect_ellipsoid,
    surface=affine_surface,
)
OUTER_ELLIPSOIDS = ELLIPSOIDS._replace(
    intersect=lambda ellipsoid, bits, ray: intersect_ellipsoid(ellipsoid, bits, ray)[:1]  # where the line enters it
)
CYLINDERS = ELLIPSOIDS._replace(intersect=intersect_cylinder, surface=partial(affine_surface, used=slice(2)))
DISKS = ELLIPSOIDS._replace(intersect=intersect_disk, surface=partial(affine_surface, used=slice(2, 3), flat=True))
