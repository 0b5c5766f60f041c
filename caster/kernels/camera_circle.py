"""What the cameras that see around share: the eye, its axes, and the circle inscribed in the film."""

import math
from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import add, dot, scaled, size, sub


def film_circle(width: int, height: int) -> Vec3:
    """(centre x, centre y, radius) of the largest centred circle, in pixels."""
    return 0.5 * width, 0.5 * height, 0.5 * min(width, height)


@jit
def on_circle(circle: Any, x: float, y: float) -> tuple[float, float]:
    """Film position in units of the circle's radius, to the right and up from its centre."""
    return (x - circle[0]) / circle[2], (circle[1] - y) / circle[2]


@jit
def mixed(camera: Any, right: float, up: float, forward: float) -> Vec3:
    """right, up and forward shares of the camera's axes, added."""
    sideways = add(scaled(right, camera.right), scaled(up, camera.up))
    return add(sideways, scaled(forward, camera.forward))


@inlined
def looking(camera: Any, d: Vec3, inside: bool) -> Vec3:
    """d at length 1, or, outside the picture, forward. d is neither long nor short, nor 0 inside."""
    inverse = 1.0 / math.sqrt(dot(d, d))
    x, y, z = scaled(inverse, d)
    forward = camera.forward
    return x if inside else forward[0], y if inside else forward[1], z if inside else forward[2]


# Between these, squares of lengths are numbers that have lost nothing.
SMALLEST, LARGEST = 2.0**-400, 2.0**400

# A ball that fills more than this of the distance to its centre has no picture of its own: 28 degrees on either side.
NEAREST_BALL = 0.47


@inlined
def seen_ball(camera: Any, center: Vec3, r: float) -> tuple[Vec3, float, bool]:
    """(to the right, up, ahead; distance; valid) of a ball's centre, seen from the eye.

    Valid for r at most NEAREST_BALL times the distance. Where that has no square, it is 0, which no distance is less
    than, nor valid.
    """
    q = sub(center, camera.eye)
    plain = (size(q) + r < LARGEST) & (size(q) > SMALLEST)
    distance = math.sqrt(dot(q, q)) if plain else 0.0
    place = dot(q, camera.right), dot(q, camera.up), dot(q, camera.forward)
    return place, distance, plain & (r <= NEAREST_BALL * distance)


BallPicture = tuple[float, float, float, float, float, bool]
"""(left, top, right, bottom, least depth, valid) of a ball; see protocol.project_ball"""

# Depth is the distance from the eye.


@inlined
def nowhere(depth: float) -> BallPicture:
    """Off the film."""
    return math.inf, math.inf, -math.inf, -math.inf, depth, True


@inlined
def anywhere(depth: float) -> BallPicture:
    return 0.0, 0.0, 0.0, 0.0, depth, False


NEARBY = 0.1  # radians: how far apart the points of a hull may be for `bulge`

# How far beyond the pictures F(p_i) of its points the picture of a convex hull can reach, along any direction w, over
# M L^2: M bounds the second derivative of f = w . F along great circles, L the angles between any two points. Seen from
# a point p of the hull, the points are at v_i in its tangent plane, with weights m_i that make sum m_i v_i = 0. So
# f(p) <= sum m_i f(p_i) + M / 2 sum m_i |v_i|^2, and that sum is at most D^2 / 3 with D the largest |v_i - v_j|
# (Jung 1901), which is at most L times r / sin r for |v_i| <= r: 1.002 L for r = NEARBY. Instead of 1 / 6:
MORE = 0.2

# Angles and their pictures are off by some 20 u of a radian: nothing beside spans.MARGIN, but for a fisheye that is so
# narrow that its film shows a radian as 2^40 pixels.
ROUNDED = 2.0**-45


@inlined
def bulge(angle: float, bend: float) -> tuple[float, float, bool]:
    """What `protocol.bent` answers for points that are at most so far apart, seen from the eye; bend: M, in pixels."""
    square = angle * angle
    return (MORE * square + ROUNDED) * bend, 1.0 - 0.5 * square, angle <= NEARBY
