"""Random shapes, cameras and scenes for every entry of the registries."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from caster.cameras import CAMERAS
from caster.description.fields import Camera, Shape
from caster.scene.model import Film, Scene
from caster.shapes import SHAPES, Cube, Torus
from mitsuba_ref import cameras, shapes

Rng = np.random.Generator

FILM = (37, 23)  # odd and oblong, so that a mix-up of width and height, or a lost last row, shows
VIEWS: tuple[type[Camera], ...] = tuple(cls for cls in CAMERAS if issubclass(cls, Camera))  # not a mere ray
# One or two shapes for each kind of primitive: kernels do not know which shape their triangles come from.
KINDS = tuple(cls for cls in SHAPES if not hasattr(cls, "mesh") or cls in (Cube, Torus))
MATERIALS = {"one": {"reflectance": (0.3, 0.6, 0.9)}, "both": {"two_sided": True}}


def point(rng: Rng, size: float) -> np.ndarray:
    return size * rng.uniform(-1.0, 1.0, 3)


def direction(rng: Rng) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_place(rng: Rng, size: float, middle: np.ndarray) -> list[dict[str, Any]]:
    """A random to_world for a shape of size 1: sometimes stretched or mirrored, rotated, translated."""
    stretch = size * 10.0 ** rng.uniform(-0.6, 0.2, 3 if rng.random() < 0.5 else 1)
    mirrored = rng.choice([-1.0, 1.0], 3)
    turn = {"axis": direction(rng), "degrees": rng.uniform(0.0, 360.0)}
    return [{"scale": stretch * mirrored}, {"rotate": turn}, {"translate": middle + point(rng, size)}]


def random_shape(cls: type[Shape], rng: Rng, size: float = 1.0, middle: Any = (0.0, 0.0, 0.0)) -> Shape:
    """A shape of this kind somewhere within about `size` of `middle`."""
    material = str(rng.choice(["", *MATERIALS]))
    place = random_place(rng, size, np.array(middle))
    return cls(**shapes.REFERENCES[cls].random_fields(rng, False), material=material, to_world=place)


def random_camera(cls: type[Camera], rng: Rng, size: float = 1.0, middle: Any = (0.0, 0.0, 0.0)) -> Camera:
    """A camera aimed near `middle`, from outside the shapes or among them."""
    away = size * rng.uniform(0.2, 2.5)
    eye = np.array(middle) + away * direction(rng)
    view = {"eye": eye, "look_at": np.array(middle) + point(rng, 0.2 * size), "up": direction(rng)}
    fields = cameras.REFERENCES[cls].random_fields(rng, size, lambda: view)
    if "principal_point" in cls.model_fields:
        fields["principal_point"] = rng.uniform(-0.2, 0.2, 2)
    return cls(**fields)


def random_lights(rng: Rng, size: float, middle: np.ndarray) -> list[dict[str, Any]]:
    """One light of each kind; the point light is among the shapes or near them."""
    place = middle + point(rng, 3.0 * size)
    return [
        {"type": "point", "position": place, "intensity": size * size * np.array([1.0, 2.0, 3.0])},
        {"type": "directional", "direction": direction(rng), "irradiance": [1.0, 0.5, 0.25]},
        {"type": "ambient", "radiance": [0.1, 0.2, 0.3]},
    ]


def random_scene(
    rng: Rng,
    shapes: Sequence[type[Shape]],
    camera: type[Camera],
    *,
    count: int = 6,
    size: float = 1.0,
    offset: float = 0.0,
    film: tuple[int, int] = FILM,
) -> Scene:
    """`count` shapes of each kind around a middle `offset` away from the origin, seen by the camera."""
    middle = offset * direction(rng)
    return Scene(
        film=Film(width=film[0], height=film[1]),
        camera=random_camera(camera, rng, size, middle),
        lights=random_lights(rng, size, middle),
        materials=MATERIALS,
        shapes=[random_shape(cls, rng, size, middle) for _ in range(count) for cls in shapes],
    )


def name(cls: type[Shape] | type[Camera]) -> str:
    """The name of a registered kind, for the ids of tests."""
    return str(cls.model_fields["type"].default)


in_each_view = pytest.mark.parametrize("camera", VIEWS, ids=name)
