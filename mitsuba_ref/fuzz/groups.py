"""Groups of shapes that share corners, are nearly degenerate, or coincide."""

import copy
from collections.abc import Callable

import numpy as np

from mitsuba_ref.fuzz.settings import (
    Fields,
    log_uniform,
    random_rotation,
    random_shape,
    shape_types,
    triangle_of,
)
from mitsuba_ref.judge.independent_checks.aims import Setting, perturbed_by_ulps
from mitsuba_ref.shapes.targets import Rng

Shapes = list[Fields]


def triangle_fan(rng: Rng, setting: Setting) -> Shapes:
    """A closed fan of 3 to 8 triangles; in a quarter of them each triangle has its own corners, an ulp off."""
    count = int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count
    rim = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, count)])
    turn = np.eye(3) if setting.lattice else random_rotation(rng)
    rim, tip = to_setting(rim @ turn.T, setting), to_setting(np.zeros((1, 3)), setting)[0]
    faces = [np.array([tip, rim[i], rim[(i + 1) % count]]) for i in range(count)]
    if rng.random() < 0.25:
        faces = [
            np.where(face == 0.0, 0.0, perturbed_by_ulps(rng, face, 1)) for face in faces
        ]  # no denormals
    return [triangle_of(np.roll(face, int(rng.integers(3)), axis=0)) for face in faces]


def slivers(rng: Rng, setting: Setting) -> Shapes:
    """Two to six triangles, 1e-17 to 1e-1 as thin as long; some have a whole sliver, not a line, for a neighbour."""
    faces = [to_setting(random_sliver(rng), setting) for _ in range(int(rng.integers(1, 4)))]
    for a, b, _ in list(faces):
        if rng.random() < 0.6:
            faces.append(np.array([b, a, to_setting(rng.uniform(-1.0, 1.0, (1, 3)), setting)[0]]))
    return [triangle_of(face) for face in faces]


def random_sliver(rng: Rng) -> np.ndarray:
    """(3, 3) corners: a needle, a cap, a line, two corners in one place, or three."""
    a, b = rng.uniform(-1.0, 1.0, (2, 3))
    thin = log_uniform(rng, 1e-17, 1e-1) * rng.normal(size=3)
    third = (a + thin, 0.5 * (a + b) + thin, a + float(rng.integers(1, 4)) / 2.0 * (b - a), b, a + thin)
    which = int(rng.integers(5))
    corners = np.array([a, b, third[which]])
    if which == 4 and rng.random() < 0.2:
        corners[:] = a
    return rng.permutation(corners)


def to_setting(points: np.ndarray, setting: Setting) -> np.ndarray:
    return setting.on_lattice(np.array(setting.center) + setting.size * points)


def coincident_shapes(rng: Rng, setting: Setting) -> Shapes:
    """A few shapes that coincide, in random order, half of the time with another shape among them."""
    shapes = COINCIDENT_GROUPS[rng.integers(len(COINCIDENT_GROUPS))](rng, setting)
    if rng.random() < 0.5:
        shapes.append(random_shape(rng, str(rng.choice(shape_types())), setting))
    return [shapes[i] for i in rng.permutation(len(shapes))]


def copies(rng: Rng, setting: Setting) -> Shapes:
    """The same shape two to six times."""
    shape = random_shape(rng, str(rng.choice(shape_types())), setting)
    return [copy.deepcopy(shape) for _ in range(int(rng.integers(2, 7)))]


def nearly_equal_spheres(rng: Rng, setting: Setting) -> Shapes:
    """One centre, and radii that differ by a unit in the last place or not at all."""
    center = np.array(setting.center) + setting.size * setting.on_lattice(rng.uniform(-1.0, 1.0, 3))
    radius = setting.size * float(rng.choice([1.0, 0.625, rng.uniform(0.1, 1.0)]))
    return [
        {
            "type": "sphere",
            "center": center.tolist(),
            "radius": abs(float(perturbed_by_ulps(rng, np.array(radius), 1))),
        }
        for _ in range(int(rng.integers(2, 7)))
    ]


def coincident_squares(rng: Rng, setting: Setting) -> Shapes:
    """The square [-1, 1]^2 as a rectangle, two triangles, a plane, the side of a cube, and with a disk in it."""
    step = [{"scale": setting.size}, {"translate": list(setting.center)}]
    below = [{"translate": [0.0, 0.0, -1.0]}, *step]
    corners = np.array(setting.center) + setting.size * np.array(
        [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    )
    shapes: Shapes = [
        {"type": "rectangle", "to_world": step},
        {"type": "disk", "to_world": step},
        {"type": "cube", "to_world": below},
        {"type": "plane", "normal": [0.0, 0.0, 1.0], "point": list(setting.center)},
        {"type": "plane", "normal": [0.0, 0.0, -1.0], "point": corners[1].tolist()},
        triangle_of(corners[[0, 1, 2]]),
        triangle_of(corners[[3, 2, 0]]),
    ]
    return [shapes[i] for i in rng.choice(len(shapes), int(rng.integers(2, 6)), replace=False)]


def permuted_triangles(rng: Rng, setting: Setting) -> Shapes:
    """A triangle with its corners in all six orders."""
    corners = setting.on_lattice(np.array(setting.center) + setting.size * rng.uniform(-1.0, 1.0, (3, 3)))
    return [triangle_of(rng.permutation(corners)) for _ in range(int(rng.integers(2, 7)))]


def touching_quadrics(rng: Rng, setting: Setting) -> Shapes:
    """A sphere, a cylinder of its radius and a disk in its equator: they touch in a circle and in points."""
    step = [{"scale": setting.size}, {"translate": list(setting.center)}]
    beside = [{"translate": [2.0, 0.0, 0.0]}, *step]
    kinds = rng.permutation(["sphere", "cylinder", "disk"])
    shapes: Shapes = [{"type": str(kind), "to_world": step} for kind in kinds]
    return [*shapes, {"type": "sphere", "to_world": beside}]


COINCIDENT_GROUPS: tuple[Callable[[Rng, Setting], Shapes], ...] = (
    copies,
    nearly_equal_spheres,
    coincident_squares,
    permuted_triangles,
    touching_quadrics,
)
