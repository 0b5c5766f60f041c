"""The course's orthographic rays come from infinitely far; ours start at the window, which is moved back for them."""

import numpy as np

from caster.cameras import Orthographic
from caster.fields import Shape
from caster.placing import as_given, placed_vertices
from caster.scene_model import Scene
from caster.shapes import Plane, Sphere


def backed(scene: Scene) -> tuple[Scene, float]:
    """(the scene with its window behind everything, how far it was moved). Depths then count from there.

    By 0, and the very same scene, where nothing is behind the window.
    """
    camera = scene.camera
    if not isinstance(camera, Orthographic) or not scene.shapes:
        return scene, 0.0
    nearest = min(_nearest(scene, camera, shape) for shape in scene.shapes)
    if nearest > 0.0:
        return scene, 0.0
    back = 1.0 - 2.0 * nearest  # well behind it: rounding moves nothing by as much
    eye = np.array(camera.eye) - back * np.array(camera.frame[2])
    return scene.model_copy(update={"camera": camera.model_copy(update={"eye": eye.tolist()})}), back


def _nearest(scene: Scene, camera: Orthographic, shape: Shape) -> float:
    """A t before which no ray of the window meets the shape."""
    forward, eye = np.array(camera.frame[2]), np.array(camera.eye)
    linear, move = shape.matrix[:3, :3], shape.matrix[:3, 3]
    if isinstance(shape, Sphere):
        center = linear @ np.array(shape.center) + move
        return float(forward @ (center - eye) - shape.radius * np.linalg.norm(linear.T @ forward))
    if isinstance(shape, Plane):
        return _nearest_of_plane(scene, camera, shape)
    assert hasattr(shape, "mesh")  # a triangle, or a file of them
    return float(np.min((placed_vertices(shape.mesh(), shape.matrix, as_given) - eye) @ forward))


def _nearest_of_plane(scene: Scene, camera: Orthographic, shape: Plane) -> float:
    """t is linear over the window, so that it is least at a corner. A plane along the rays is never met."""
    part = shape.pack(as_given)
    n, point = part.normal[0], part.point[0]
    right, up, forward = (np.array(v) for v in camera.frame)
    half = 0.5 * camera.width
    tall = half * scene.film.height / scene.film.width
    corners = [np.array(camera.eye) + x * half * right + y * tall * up for x in (-1, 1) for y in (-1, 1)]
    slope = float(n @ forward)
    return min(float(n @ (point - corner)) / slope for corner in corners) if slope else np.inf
