"""Families of extreme magnitudes: scale, offset, distance, length of directions, field of view, film size."""

import math
from dataclasses import replace

import numpy as np

from caster.cameras import Pinhole
from caster.rendering.images import camera_rays
from caster.scene.model import Scene
from caster.shapes import Rectangle, Sphere, Triangle
from mitsuba_ref.stress.family import (
    EYE_DISTANCE,
    CameraRays,
    Family,
    Rays,
    Rng,
    Setting,
    float32,
    hits_triangles,
    icosphere_scene,
    part_of,
    random_directions,
    rays_to_triangle,
    scene_of,
    select_rays,
    setting_around,
    sphere_scene,
    unit_normal,
)


def scaled_mesh(rng: Rng, scale: float, count: int) -> Setting:
    center = scale * rng.normal(scale=0.3, size=3)
    scene = icosphere_scene(rng, scale, center)
    return setting_around(rng, scale, scene, (center, scale, EYE_DISTANCE * scale), count)


def scaled_sphere(rng: Rng, scale: float, count: int) -> Setting:
    center = scale * rng.normal(scale=0.3, size=3)
    scene = sphere_scene(scale, center)
    return setting_around(rng, scale, scene, (center, scale, EYE_DISTANCE * scale), count)


def decades(*exponents: int) -> tuple[float, ...]:
    return tuple(float(np.float64(f"1e{exponent}")) for exponent in exponents)


SCALE_MESH = Family(
    "scale-mesh",
    "the size of a whole scene of triangles",
    "radius, scene units",
    decades(-20, -16, -14, -13, -12, -11, -9, -6, -3, 0, 3, 6, 9, 11, 12, 13, 14, 16, 18),
    1.0,
    scaled_mesh,
)
SCALE_SPHERE = Family(
    "scale-sphere",
    "the size of a whole scene of a sphere",
    "radius of the sphere, scene units",
    decades(-30, -24, -20, -19, -17, -15, -12, -8, -4, 0, 4, 8, 12, 15, 17, 18, 19, 20, 24, 30),
    1.0,
    scaled_sphere,
)


def offset_center(rng: Rng, offset: float) -> np.ndarray:
    """A float32 point at about this distance from the origin."""
    return (offset * random_directions(rng, 1)[0]).astype(np.float32).astype(np.float64)


def offset_mesh(rng: Rng, offset: float, count: int) -> Setting:
    center = offset_center(rng, offset)
    scene = icosphere_scene(rng, 1.0, center)
    return setting_around(rng, offset, scene, (center, 1.0, EYE_DISTANCE), count)


def offset_sphere(rng: Rng, offset: float, count: int) -> Setting:
    center = offset_center(rng, offset)
    return setting_around(rng, offset, sphere_scene(1.0, center), (center, 1.0, EYE_DISTANCE), count)


OFFSET_MESH = Family(
    "offset-mesh",
    "how far from the origin a sphere of triangles is",
    "offset over radius",
    (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 3e6, 1e7),
    1.0,
    offset_mesh,
)
OFFSET_SPHERE = Family(
    "offset-sphere",
    "how far from the origin a sphere is",
    "offset over radius",
    (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7),
    1.0,
    offset_sphere,
)


DISTANCES = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)


def distant_triangle(rng: Rng, distance: float, count: int) -> Setting:
    corners = np.array([[1.0, 0.1, 0.0], [-0.6, 0.8, 0.1], [-0.4, -0.9, -0.1]]) + rng.normal(scale=0.1, size=(3, 3))
    scene = scene_of(Triangle(vertices=corners))
    part = part_of(scene)
    n = unit_normal(corners)

    def make(number: int) -> Rays:
        return rays_to_triangle(rng, part.vertices, n, distance, number)

    return Setting(distance, scene, *select_rays(make, hits_triangles(part.vertices[part.faces]), count))


def distant_sphere(rng: Rng, distance: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    return setting_around(rng, distance, sphere_scene(1.0, center), (center, 1.0, distance), count)


DISTANCE_TRIANGLE = Family(
    "distance-triangle",
    "how far rays come to a triangle",
    "distance over size",
    DISTANCES,
    DISTANCES[0],
    distant_triangle,
)
DISTANCE_SPHERE = Family(
    "distance-sphere", "how far rays come to a sphere", "distance over radius", DISTANCES, DISTANCES[0], distant_sphere
)


LENGTHS = decades(-36, -30, -25, -20, -15, -10, -5, -3, 0, 3, 5, 10, 15, 18, 20, 25, 30, 36)


def with_length(setting: Setting, length: float) -> Setting:
    """The directions scaled by `length` and rounded to float32 again, which changes them slightly."""
    return replace(setting, x=length, d=(setting.d.astype(np.float64) * length).astype(np.float32))


def mesh_by_length(rng: Rng, length: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    scene = icosphere_scene(rng, 1.0, center)
    return with_length(setting_around(rng, length, scene, (center, 1.0, EYE_DISTANCE), count), length)


def sphere_by_length(rng: Rng, length: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    scene = sphere_scene(1.0, center)
    return with_length(setting_around(rng, length, scene, (center, 1.0, EYE_DISTANCE), count), length)


LENGTH_MESH = Family("length-mesh", "how long d is, at triangles", "length of d", LENGTHS, 1.0, mesh_by_length)
LENGTH_SPHERE = Family("length-sphere", "how long d is, at a sphere", "length of d", LENGTHS, 1.0, sphere_by_length)


FOV_DEGREES = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 45.0, 90.0, 120.0, 150.0, 170.0, 179.0, 179.9, 179.99)  # degrees
FILM_WIDTHS = (16.0, 64.0, 256.0, 1024.0, 4096.0, 16384.0, 65536.0)
SQUARE_SHARE = 0.7  # of the image's width


def eye_and_view(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A float32 point, and a unit vector."""
    view = rng.normal(size=3)
    return float32(rng.normal(scale=0.3, size=3)).astype(np.float64), view / np.linalg.norm(view)


def field_of_view(rng: Rng, tangent: float, count: int) -> Setting:
    """A tilted square that fills most of the image."""
    eye, view = eye_and_view(rng)
    side = math.isqrt(count)
    camera = Pinhole(eye=tuple(eye), direction=tuple(view), fov=math.degrees(2.0 * math.atan(tangent)))
    steps = [
        {"rotate": {"axis": [0.0, 0.0, 1.0], "degrees": 20.0}},
        {"scale": SQUARE_SHARE * tangent},
        {"look_at": {"origin": eye + view, "target": eye, "up": camera.frame[1]}},
    ]
    scene = Scene(film={"width": side, "height": side}, camera=camera, shapes=[Rectangle(to_world=steps)])
    return camera_setting(tangent, camera, scene)


def film_size(rng: Rng, width: float, count: int) -> Setting:
    """A crop window around a point of a sphere's silhouette, in a square film of this width."""
    eye, view = eye_and_view(rng)
    camera = Pinhole(eye=tuple(eye), direction=tuple(view), fov=45.0)
    forward = np.array(camera.frame[2])
    turned = rng.uniform(0.0, 2.0 * math.pi)
    share = math.tan(math.asin(1.0 / EYE_DISTANCE)) / math.tan(math.radians(camera.fov / 2.0))
    middle = [0.5 * (1.0 + share * math.cos(turned)), 0.5 * (1.0 - share * math.sin(turned))]
    side = min(int(width), math.isqrt(count))
    start = [min(max(round(m * width - side / 2), 0), int(width) - side) for m in middle]
    crop = (*start, start[0] + side, start[1] + side)
    sphere = Sphere(center=eye + EYE_DISTANCE * forward, radius=1.0)
    film = {"width": int(width), "height": int(width), "crop": crop}
    return camera_setting(width, camera, Scene(film=film, camera=camera, shapes=[sphere]))


def camera_setting(x: float, camera: Pinhole, scene: Scene) -> Setting:
    """The camera's own rays, rounded to float32."""
    rays = camera_rays(scene)
    every = np.arange(len(rays.t_max))
    found = [CameraRays(camera, scene.film, every, every)]
    return Setting(x, scene_of(*scene.shapes), float32(rays.o), float32(rays.d), camera_rays=found)


def tangent_of(degrees: float) -> float:
    """Half the width of the image at distance 1."""
    return math.tan(math.radians(degrees / 2.0))


FIELD_OF_VIEW = Family(
    "field-of-view",
    "the field of view of a pinhole camera",
    "tan(fov / 2)",
    tuple(tangent_of(degrees) for degrees in FOV_DEGREES),
    tangent_of(90.0),
    field_of_view,
)
FILM_SIZE = Family(
    "film-size",
    "how many pixels wide the film is: the window at a silhouette narrows",
    "width of the film, pixels",
    FILM_WIDTHS,
    FILM_WIDTHS[0],
    film_size,
)
