"""What the cameras with a round image share: the eye, its axes, and the circle inscribed in the film."""

from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import add, scaled


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
