"""What fisheyes and panoramas share: rays, and spheres and hulls in their projections."""

import math
from typing import Any

from caster.jit.decorators import inlined
from caster.kernels.math.vec import add, dot, l1_norm, scaled, select, sub
from caster.kernels.protocol import Vec3


@inlined
def ray_along(camera: Any, shares: Vec3, inside: bool) -> Any:
    """`camera_ray` in the direction of shares of right, up and forward, which is neither long nor short, nor 0 inside.

    Outside the image there is none.
    """
    sideways = add(scaled(shares[0], camera.right), scaled(shares[1], camera.up))
    d = add(sideways, scaled(shares[2], camera.forward))
    unit = select(inside, scaled(1.0 / math.sqrt(dot(d, d)), d), camera.forward)
    return camera.eye, unit, 0.0, math.inf if inside else -1.0


# Between these, squares of lengths are numbers that have lost nothing.
MIN_SQUARABLE_LENGTH, MAX_SQUARABLE_LENGTH = 2.0**-400, 2.0**400

# A sphere whose radius is more than this share of the distance to its centre is not projected: 28 degrees each side.
MAX_SPHERE_SIZE = 0.47


@inlined
def sphere_in_camera_space(camera: Any, center: Vec3, r: float) -> tuple[Vec3, float, bool]:
    """(to the right, up, ahead; distance; valid) of a sphere's centre, relative to the eye.

    Valid for r at most MAX_SPHERE_SIZE times the distance. Where that has no square, it is 0, which no distance is less
    than, nor valid.
    """
    q = sub(center, camera.eye)
    plain = (l1_norm(q) + r < MAX_SQUARABLE_LENGTH) & (l1_norm(q) > MIN_SQUARABLE_LENGTH)
    distance = math.sqrt(dot(q, q)) if plain else 0.0
    place = dot(q, camera.right), dot(q, camera.up), dot(q, camera.forward)
    return place, distance, plain & (r <= MAX_SPHERE_SIZE * distance)


MAX_HULL_ANGLE = 0.1  # radians: how far apart the points of a hull may be for `hull_distortion_bound`

# How far beyond the projections F(p_i) of its points the projection of a convex hull can reach, along any direction w,
# over M L^2: M bounds the second derivative of f = w . F along great circles, L the angles between any two points. Seen
# from a point p of the hull, the points are at v_i in its tangent plane, with weights m_i that make sum m_i v_i = 0. So
# f(p) <= sum m_i f(p_i) + M / 2 sum m_i |v_i|^2, and that sum is at most D^2 / 3 with D the largest |v_i - v_j| (Jung
# 1901), which is at most L times r / sin r for |v_i| <= r: 1.002 L for r = MAX_HULL_ANGLE. Instead of 1 / 6:
BULGE_FACTOR = 0.2

# Angles and their projections are off by some 20 u of a radian: nothing beside screen_bounds.PROJECTION_MARGIN, but for
# a fisheye that is so narrow that its film shows a radian as 2^40 pixels.
ANGLE_ROUNDING = 2.0**-45


@inlined
def hull_distortion_bound(angle: float, bend: float) -> tuple[float, float, bool]:
    """`protocol.distortion_bound` for points that are at most this angle apart at the eye; bend: M, in pixels."""
    square = angle * angle
    return (BULGE_FACTOR * square + ANGLE_ROUNDING) * bend, 1.0 - 0.5 * square, angle <= MAX_HULL_ANGLE
