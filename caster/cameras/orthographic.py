"""The orthographic camera: all rays are parallel."""

from typing import Any, Literal, NamedTuple

from caster.description.fields import ClippedCamera, Positive
from caster.jit.decorators import implement
from caster.kernels.math.vec import add, dot, scaled, sub
from caster.kernels.protocol import Vec3, camera_ray, project, project_bounding_sphere


class OrthographicRays(NamedTuple):
    """Parameters of the orthographic camera for kernels."""

    eye: Vec3  # float64, centre of the window
    right: Vec3  # unit
    up: Vec3  # unit
    forward: Vec3  # unit
    size: tuple[float, float]  # film width and height in pixels
    half: tuple[float, float]  # half extent of the window, scene units
    near: float
    far: float


class Orthographic(ClippedCamera):
    """Parallel rays from a window `width` scene units wide around the eye; depth is the distance from the window."""

    type: Literal["orthographic"] = "orthographic"
    width: Positive = 2.0  # scene units

    def pack(self, width: int, height: int) -> OrthographicRays:
        half = (0.5 * self.width, 0.5 * self.width * height / width)
        size = (float(width), float(height))
        return OrthographicRays(self.eye, *self.frame, size, half, *self.clip)


@implement(camera_ray, OrthographicRays)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    across = (2.0 * (x / camera.size[0]) - 1.0) * camera.half[0]
    above = (1.0 - 2.0 * (y / camera.size[1])) * camera.half[1]
    sideways = add(scaled(across, camera.right), scaled(above, camera.up))
    return add(camera.eye, sideways), camera.forward, camera.near, camera.far


@implement(project, OrthographicRays)
def _project(camera: Any, p: Any) -> Any:
    q = sub(p, camera.eye)
    x = 0.5 * (dot(q, camera.right) / camera.half[0] + 1.0) * camera.size[0]
    y = 0.5 * (1.0 - dot(q, camera.up) / camera.half[1]) * camera.size[1]
    return x, y, 0.5 * camera.size[0] / camera.half[0], dot(q, camera.forward), True


@implement(project_bounding_sphere, OrthographicRays)
def _project_bounding_sphere(camera: Any, center: Any, r: float) -> Any:
    x, y, pixels, depth, _ = project(camera, center)
    wide, tall = r * pixels, r * 0.5 * camera.size[1] / camera.half[1]
    return x - wide, y - tall, x + wide, y + tall, depth - r, True
