"""Images of the course: colour, depth and normals of one cast, with orthographic rays that start at infinity."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from caster.cameras import Orthographic
from caster.classroom.course_files import CourseScene
from caster.description.transform import dot_rows, row_lengths
from caster.geometry.packing import packed
from caster.rendering.hits import RayHits
from caster.rendering.images import film_window, trace_film
from caster.scene.model import Point, Scene

__all__ = ["with_window_behind_scene"]

Array = np.ndarray[Any, np.dtype[Any]]


def with_window_behind_scene(scene: Scene) -> tuple[Scene, float]:
    """Move the orthographic window of a scene behind all shapes. Returns the scene and the distance moved, or 0.

    Rays of the course start at infinity, those of `Orthographic` at the window, from where the depths of the new scene
    count.
    """
    camera = scene.camera
    if not isinstance(camera, Orthographic) or not scene.shapes:
        return scene, 0.0
    view = camera.pack(scene.film.width, scene.film.height)
    eye, right, up, forward = np.array(view[:4])
    corners = np.array([eye + x * view.half[0] * right + y * view.half[1] * up for x in (-1, 1) for y in (-1, 1)])
    nearest = np.inf  # a lower bound of t
    for kind in packed(scene).kinds:
        if kind.bounded:
            low, high = kind.boxes()
            entries = np.minimum(low * forward, high * forward).sum(axis=1) - dot_rows(eye[None], forward)
        else:  # planes: t is linear over the window, so the least is at a corner
            slopes = dot_rows(kind.prims.normal, forward)[:, None]
            heights = ((kind.prims.point[:, None] - corners) * kind.prims.normal[:, None]).sum(axis=2)
            entries = np.divide(heights, slopes, out=np.full(heights.shape, np.inf), where=slopes != 0.0)
        nearest = min(nearest, float(entries.min(initial=np.inf)))
    if nearest > 0.0:
        return scene, 0.0
    back = 1.0 - 2.0 * nearest  # a margin far above rounding
    return scene.model_copy(update={"camera": camera.model_copy(update={"eye": (eye - back * forward).tolist()})}), back


@dataclass(frozen=True)
class CourseImages:
    """The results of one cast: (h, w) arrays; color and normal (h, w, 3)."""

    hit: Array  # bool
    t: Array  # along the ray, from the start of the course; inf on a miss
    normal: Array  # not flipped towards the ray; 0 on a miss
    color: Array  # linear, 0..1 and beyond


def render_course(course: CourseScene, threads: int | None = None) -> CourseImages:
    """Cast and shade the scene. Back sides are black, unless the materials are two-sided."""
    scene, back = with_window_behind_scene(course.scene)
    view = trace_film(scene, threads=threads)
    window = film_window(scene)
    shape = (window.height, window.width)
    color = _colors(course, view).reshape(*shape, 3)
    normals = view.normal.reshape(*shape, 3)
    return CourseImages(view.hit.reshape(shape), (view.nearest.t - back).reshape(shape), normals, color)


def depth_image(images: CourseImages, near: float, far: float) -> Array:
    """Depths as (h, w, 3) bytes: white up to `near`, black from `far` on and where nothing is hit."""
    grey = np.clip((far - np.where(images.hit, images.t, far)) / (far - near), 0.0, 1.0)
    return np.repeat(to_bytes_truncated(grey)[..., None], 3, axis=-1)


def normal_image(images: CourseImages) -> Array:
    """Normals as (h, w, 3) bytes: |x|, |y|, |z| as red, green, blue; black where nothing is hit."""
    return to_bytes_truncated(np.abs(images.normal))


def to_bytes_truncated(values: Array) -> Array:
    """0..1, clipped -> 0..255, truncated without gamma, as in the course; rounding leaves 255 as it is."""
    return (255.0 * np.clip(values, 0.0, 1.0) + 2.0**-40).astype(np.uint8)


def _colors(course: CourseScene, view: RayHits) -> Array:
    """(n, 3): the AOV `diffuse`, but backs are black in ambient light too, and lights fall off as the file declares."""
    total = np.zeros((len(view.hit), 3))
    for k, light in enumerate(view.scene.lights):
        alone = replace(view, scene=view.scene.model_copy(update={"lights": (light,)}))
        diffuse = alone.evaluate(("diffuse",))["diffuse"]
        if isinstance(light, Point):
            constant, linear, quadratic = course.falloffs[k]
            r = row_lengths(np.array(light.position) - view.position)
            divisor = constant + linear * r + quadratic * r * r  # 0 only at the light itself, which stays dark
            of_scene = (constant + linear + quadratic) * r * r  # its light falls off by 1 / r^2, equal at r = 1
            diffuse *= np.divide(of_scene, divisor, out=np.zeros(len(r)), where=divisor > 0.0)[:, None]
        total += diffuse
    # the course has one setting for the back sides of all materials
    if not any(material.two_sided for material in view.scene.materials.values()):
        total[np.sum(view.normal * view.rays.d, axis=1) > 0.0] = 0.0
    return np.where(view.hit[:, None], total, course.background)
