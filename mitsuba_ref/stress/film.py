"""Field of view and film size: pixels of a pinhole camera that lie ever closer together, or ever wider apart."""

import math

import numpy as np

from caster.cameras import Pinhole
from caster.rendering import camera_rays
from caster.scene import Scene
from caster.shapes import Rectangle, Sphere
from mitsuba_ref.stress.aiming import float32, scene_of
from mitsuba_ref.stress.family import Family, Rng, Setting, Shot

FIELDS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 45.0, 90.0, 120.0, 150.0, 170.0, 179.0, 179.9, 179.99)  # degrees
SIDES = (16.0, 64.0, 256.0, 1024.0, 4096.0, 16384.0, 65536.0)
FILLED = 0.7  # share of the picture's width that the square takes
DISTANCE = 5.0  # radii, from the eye to the ball at whose silhouette the crop window lies


def eye_and_view(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A float32 point, and a unit vector."""
    view = rng.normal(size=3)
    return float32(rng.normal(scale=0.3, size=3)).astype(np.float64), view / np.linalg.norm(view)


def of_field(rng: Rng, tangent: float, count: int) -> Setting:
    """A square that fills most of the picture, tilted in it."""
    eye, view = eye_and_view(rng)
    side = math.isqrt(count)
    camera = Pinhole(eye=tuple(eye), direction=tuple(view), fov=math.degrees(2.0 * math.atan(tangent)))
    steps = [
        {"rotate": {"axis": [0.0, 0.0, 1.0], "degrees": 20.0}},
        {"scale": FILLED * tangent},
        {"look_at": {"origin": eye + view, "target": eye, "up": camera.frame[1]}},
    ]
    scene = Scene(film={"width": side, "height": side}, camera=camera, shapes=[Rectangle(to_world=steps)])
    return pictured(tangent, camera, scene)


def of_side(rng: Rng, width: float, count: int) -> Setting:
    """A crop window around a point of a ball's silhouette, in a square film of this width."""
    eye, view = eye_and_view(rng)
    camera = Pinhole(eye=tuple(eye), direction=tuple(view), fov=45.0)
    forward = np.array(camera.frame[2])
    turned = rng.uniform(0.0, 2.0 * math.pi)
    share = math.tan(math.asin(1.0 / DISTANCE)) / math.tan(math.radians(camera.fov / 2.0))
    middle = [0.5 * (1.0 + share * math.cos(turned)), 0.5 * (1.0 - share * math.sin(turned))]
    side = min(int(width), math.isqrt(count))
    start = [min(max(round(m * width - side / 2), 0), int(width) - side) for m in middle]
    crop = (*start, start[0] + side, start[1] + side)
    ball = Sphere(center=eye + DISTANCE * forward, radius=1.0)
    film = {"width": int(width), "height": int(width), "crop": crop}
    return pictured(width, camera, Scene(film=film, camera=camera, shapes=[ball]))


def pictured(x: float, camera: Pinhole, scene: Scene) -> Setting:
    """The camera's own rays, rounded to float32."""
    rays = camera_rays(scene)
    every = np.arange(len(rays.t_max))
    shots = [Shot(camera, scene.film, every, every)]
    return Setting(x, scene_of(*scene.shapes), float32(rays.o), float32(rays.d), shots=shots)


def tangent_of(degrees: float) -> float:
    """Half the width of the picture at distance 1."""
    return math.tan(math.radians(degrees / 2.0))


FIELD = Family(
    "field-of-view",
    "how wide a pinhole camera sees",
    "tan(fov / 2)",
    tuple(tangent_of(degrees) for degrees in FIELDS),
    tangent_of(90.0),
    of_field,
)
SIDE = Family(
    "film-size",
    "how many pixels a picture is wide: the window at a silhouette narrows",
    "width of the film, pixels",
    SIDES,
    SIDES[0],
    of_side,
)
