"""Images of the course: colour, depth and normals of one cast, with orthographic rays that start at infinity."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.cameras import Orthographic
from caster.classroom.course_files import CourseScene
from caster.classroom.scene_conversion import Falloff
from caster.description.fields import Shape
from caster.description.transform import dot_rows, row_lengths, transform_points, transform_vectors
from caster.geometry.world_space import as_given, world_vertices
from caster.rendering.hits import RayHits
from caster.rendering.images import film_window, trace_film
from caster.scene.model import Ambient, Directional, Light, Point, Scene
from caster.shapes import Plane, Sphere

__all__ = ["with_window_behind_scene"]


def with_window_behind_scene(scene: Scene) -> tuple[Scene, float]:
    """The scene with its orthographic window moved behind all shapes, and the distance moved (0: the scene itself).

    Rays of the course start at infinity, those of `Orthographic` at the window. Depths of the result count from there.
    """
    camera = scene.camera
    if not isinstance(camera, Orthographic) or not scene.shapes:
        return scene, 0.0
    nearest = min(_entry_bound(scene, camera, shape) for shape in scene.shapes)
    if nearest > 0.0:
        return scene, 0.0
    back = 1.0 - 2.0 * nearest  # a margin far above rounding
    eye = np.array(camera.eye) - back * np.array(camera.frame[2])
    return scene.model_copy(update={"camera": camera.model_copy(update={"eye": eye.tolist()})}), back


def _entry_bound(scene: Scene, camera: Orthographic, shape: Shape) -> float:
    """A lower bound of t at which a ray of the window hits the shape."""
    forward, eye = np.array(camera.frame[2]), np.array(camera.eye)
    if isinstance(shape, Sphere):
        center = transform_points(shape.matrix, np.array([shape.center]))
        reach = row_lengths(transform_vectors(shape.matrix[:3, :3].T, forward[None]))
        return float((dot_rows(center - eye, forward) - shape.radius * reach)[0])
    if isinstance(shape, Plane):
        return _plane_entry_bound(scene, camera, shape)
    assert hasattr(shape, "mesh")  # a triangle or a mesh
    return float(np.min(dot_rows(world_vertices(shape.mesh(), shape.matrix, as_given) - eye, forward)))


def _plane_entry_bound(scene: Scene, camera: Orthographic, shape: Plane) -> float:
    """The least t over the window: t is linear, so it is at a corner. inf for a plane parallel to the rays."""
    part = shape.pack(as_given)
    right, up, forward = (np.array(v) for v in camera.frame)
    half = 0.5 * camera.width
    tall = half * scene.film.height / scene.film.width
    corners = [np.array(camera.eye) + x * half * right + y * tall * up for x in (-1, 1) for y in (-1, 1)]
    slope = float(dot_rows(part.normal, forward)[0])
    heights = dot_rows(part.point - np.array(corners), part.normal)
    return float((heights / slope).min()) if slope else np.inf


# ---- the three images ----

Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True)
class CourseImages:
    """Results of one cast: (h, w) arrays; color and normal (h, w, 3)."""

    hit: Array  # bool
    t: Array  # along the ray, from the start of the course; inf on a miss
    normal: Array  # not flipped towards the ray; 0 on a miss
    color: Array  # linear, 0..1 and beyond


def render_course(course: CourseScene, threads: int | None = None) -> CourseImages:
    """Cast and shade. Back sides are black, unless the materials are two-sided."""
    scene, back = with_window_behind_scene(course.scene)
    view = trace_film(scene, threads=threads)
    window = film_window(scene)
    shape = (window.height, window.width)
    return CourseImages(
        view.hit.reshape(shape),
        (view.nearest.t - back).reshape(shape),
        view.normals.reshape(*shape, 3),
        _colors(course, view).reshape(*shape, 3),
    )


def depth_image(images: CourseImages, near: float, far: float) -> Array:
    """Depths as (h, w, 3) bytes: white at `near` and before, black at `far` and beyond, and where nothing is hit."""
    grey = np.clip((far - np.where(images.hit, images.t, far)) / (far - near), 0.0, 1.0)
    return np.repeat(to_bytes_truncated(grey)[..., None], 3, axis=-1)


def normal_image(images: CourseImages) -> Array:
    """Normals as (h, w, 3) bytes: |x|, |y|, |z| as red, green, blue; black where nothing is hit."""
    return to_bytes_truncated(np.abs(images.normal))


def to_bytes_truncated(values: Array) -> Array:
    """0..1, clipped -> 0..255, truncated without gamma, as the course writes its files."""
    return (255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def _colors(course: CourseScene, view: RayHits) -> Array:
    """(n, 3): ambient light times the diffuse colour, and for each light color max(0, n . l) times it.

    Unlike the AOV `diffuse`, lights fall off only as declared in their file.
    """
    front = np.sum(view.normals * view.rays.d, axis=1) <= 0.0
    n = np.where(front[:, None], view.normals, -view.normals)
    total = np.zeros((len(view.hit), 3))
    for light in view.scene.lights:
        if isinstance(light, Ambient):
            total += light.radiance
    for light, color, falloff in zip(view.scene.lights, course.colors, course.falloffs, strict=False):
        total += np.outer(_brightness(light, falloff, n, view), color)
    shaded = np.where((front | view.two_sided)[:, None], total * view.reflectance, 0.0)
    return np.where(view.hit[:, None], shaded, course.background)


def _brightness(light: Light, falloff: Falloff | None, n: Array, view: RayHits) -> Array:
    """(n,) the factor of a light's colour at each hit; 0 in shadow, if the scene has shadows."""
    towards, strength = _incident_light(light, falloff, view)
    brightness = np.where(view.hit, strength * np.maximum(np.sum(n * towards, axis=1), 0.0), 0.0)
    where = np.flatnonzero(brightness > 0.0)
    brightness[where[~view.lit(light, where)]] = 0.0
    return brightness


def _incident_light(light: Light, falloff: Falloff | None, view: RayHits) -> tuple[Array, Array]:
    """(unit vectors to the light, attenuation by distance); 0 at the position of the light."""
    count = len(view.hit)
    if isinstance(light, Directional):
        return np.tile(-np.array(light.direction), (count, 1)), np.ones(count)
    assert isinstance(light, Point) and falloff is not None
    way = np.array(light.position) - view.surfaces.p
    r = np.sqrt(np.sum(way * way, axis=1))
    apart = r > 0.0
    r = np.where(apart, r, 1.0)
    return way / r[:, None], apart / (falloff.constant + falloff.linear * r + falloff.quadratic * r * r)
