"""The three pictures of the course: colour, depth and normals, from one cast of our rays."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.classroom.backing import backed
from caster.classroom.building import Falloff
from caster.classroom.reading import Course
from caster.lights import Ambient, Directional, Light, Point
from caster.rendering import film_window, look
from caster.view import View

Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True)
class Drawn:
    """(h, w) images; color and normal (h, w, 3)."""

    hit: Array  # bool
    t: Array  # along the ray, from where the course starts it; inf on a miss
    normal: Array  # as the surface has it, 0 on a miss
    color: Array  # linear, 0..1 and beyond


def draw(course: Course, threads: int | None = None) -> Drawn:
    """Cast and shade. Surfaces seen from behind are black, unless the scene's materials are two-sided."""
    scene, back = backed(course.scene)
    view = look(scene, threads=threads)
    window = film_window(scene)
    shape = (window.height, window.width)
    return Drawn(
        view.hit.reshape(shape),
        (view.nearest.t - back).reshape(shape),
        view.normals.reshape(*shape, 3),
        _colors(course, view).reshape(*shape, 3),
    )


def depth_picture(drawn: Drawn, near: float, far: float) -> Array:
    """(h, w, 3) bytes: white at `near` and before, black at `far` and beyond, and where nothing is hit."""
    grey = np.clip((far - np.where(drawn.hit, drawn.t, far)) / (far - near), 0.0, 1.0)
    return np.repeat(bytes_of(grey)[..., None], 3, axis=-1)


def normal_picture(drawn: Drawn) -> Array:
    """(h, w, 3) bytes: |x|, |y|, |z| as red, green, blue; black where nothing is hit."""
    return bytes_of(np.abs(drawn.normal))


def bytes_of(values: Array) -> Array:
    """0..1 -> 0..255, linear and cut down to whole numbers, as the course writes its files; the rest is cut off."""
    return (255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def _colors(course: Course, view: View) -> Array:
    """(n, 3): ambient light times the diffuse colour, and for each light color max(0, n . l) times it.

    Lights have no 1 / r^2, unless their file says so; this is where the course and our AOV `diffuse` differ.
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


def _brightness(light: Light, falloff: Falloff | None, n: Array, view: View) -> Array:
    """(n,): what each hit gets of a light's colour; 0 in shadow, where the scene has shadows."""
    towards, strength = _arriving(light, falloff, view)
    brightness = np.where(view.hit, strength * np.maximum(np.sum(n * towards, axis=1), 0.0), 0.0)
    where = np.flatnonzero(brightness > 0.0)
    brightness[where[~view.lit(light, where)]] = 0.0
    return brightness


def _arriving(light: Light, falloff: Falloff | None, view: View) -> tuple[Array, Array]:
    """(unit vectors to the light, what the distance leaves of its colour); nothing in the light itself."""
    count = len(view.hit)
    if isinstance(light, Directional):
        return np.tile(-np.array(light.direction), (count, 1)), np.ones(count)
    assert isinstance(light, Point) and falloff is not None
    way = np.array(light.position) - view.surfaces.p
    r = np.sqrt(np.sum(way * way, axis=1))
    apart = r > 0.0
    r = np.where(apart, r, 1.0)
    return way / r[:, None], apart / (falloff.constant + falloff.linear * r + falloff.quadratic * r * r)
