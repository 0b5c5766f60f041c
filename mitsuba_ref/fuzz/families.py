"""Families of adversarial scenes, and the examples drawn from them."""

import copy
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.fuzz.settings import (
    FILM_SIZES,
    Fields,
    bounded_types,
    log_uniform,
    matrix_rows,
    random_camera,
    random_lattice_setting,
    random_rotation,
    random_setting,
    random_shape,
    random_shapes,
    random_view,
    shape_types,
    triangle_of,
    vector,
    view_from_within,
    with_options,
)
from mitsuba_ref.judge.checks import adversarial_rays
from mitsuba_ref.judge.checks.adversarial_rays import Aim, RayBatch, Setting, Targets, aimed_rays, perturbed_by_ulps
from mitsuba_ref.shapes.targets import Rng, coin_flip

RAYS_PER_EXAMPLE = 40  # before those with limits

# Random numbers of an example are independent for each of these purposes.
SCENE_STREAM, AIM_STREAM, LIMIT_STREAM, MITSUBA_STREAM = range(4)

Shapes = list[Fields]
RandomScene = Callable[[Rng], tuple[Setting, Shapes]]


class Family(NamedTuple):
    """Random scenes of one numerical difficulty, and how rays are aimed at them."""

    name: str
    about: str
    draw: RandomScene
    aims: tuple[Aim, ...] = adversarial_rays.ALL_AIMS
    fits_float32: bool = True  # so that Mitsuba can trace it
    cameras: tuple[str, ...] = ()  # types; (): all that are registered
    films: tuple[tuple[int, int], ...] = FILM_SIZES
    view: Callable[[Rng, Setting], Fields] = random_view
    finish: Callable[[Rng, Setting, dict[str, Any]], dict[str, Any]] = lambda rng, setting, data: data
    always_judged: bool = False  # by Mitsuba, unless none is


# ---- shapes that are hard together ----


def triangle_fan(rng: Rng, setting: Setting) -> Shapes:
    """A closed fan of 3 to 8 triangles; in a quarter of them each triangle has its own corners, an ulp off."""
    count = int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count
    rim = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, count)])
    turn = np.eye(3) if setting.lattice else random_rotation(rng)
    rim, tip = to_setting(rim @ turn.T, setting), to_setting(np.zeros((1, 3)), setting)[0]
    faces = [np.array([tip, rim[i], rim[(i + 1) % count]]) for i in range(count)]
    if rng.random() < 0.25:
        faces = [np.where(face == 0.0, 0.0, perturbed_by_ulps(rng, face, 1)) for face in faces]  # no denormals
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
        {"type": "sphere", "center": center.tolist(), "radius": abs(float(perturbed_by_ulps(rng, np.array(radius), 1)))}
        for _ in range(int(rng.integers(2, 7)))
    ]


def coincident_squares(rng: Rng, setting: Setting) -> Shapes:
    """The square [-1, 1]^2 as a rectangle, two triangles, a plane, the side of a cube, and with a disk in it."""
    step = [{"scale": setting.size}, {"translate": list(setting.center)}]
    below = [{"translate": [0.0, 0.0, -1.0]}, *step]
    corners = np.array(setting.center) + setting.size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
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


# ---- families ----


def shapes_of(setting: Callable[[Rng], Setting], group: str, at_most: int) -> RandomScene:
    """Scenes of one to at_most shapes of a group; "" for all registered shapes, "bounded" for finite ones."""

    def draw(rng: Rng) -> tuple[Setting, Shapes]:
        frame = setting(rng)
        types = bounded_types() if group == "bounded" else shape_types(group)
        return frame, random_shapes(rng, frame, types, at_most)

    return draw


def in_random_setting(shapes: Callable[[Rng, Setting], Shapes]) -> RandomScene:
    def draw(rng: Rng) -> tuple[Setting, Shapes]:
        frame = random_setting(rng)
        return frame, shapes(rng, frame)

    return draw


def shared_edges(rng: Rng, setting: Setting) -> Shapes:
    if rng.random() < 0.5:
        return triangle_fan(rng, setting)
    return random_shapes(rng, setting, shape_types("mesh"), 2)


def tiny_or_huge(rng: Rng) -> Setting:
    """Sizes from 1e-100 to 1e17: squares of numbers that leave the range of float64, or nearly so."""
    size = log_uniform(rng, 1e-100, 1e-20) if rng.random() < 0.5 else log_uniform(rng, 1e10, 1e17)
    return Setting(size, condition=10.0)


def stretched(rng: Rng) -> Setting:
    return Setting(condition=1e6)


def far_from_origin(rng: Rng) -> Setting:
    """1e3 to 1e9 sizes away."""
    size = log_uniform(rng, 1e-3, 1e3)
    away = size * log_uniform(rng, 1e3, 1e9) * rng.normal(size=3)
    return Setting(size, vector(away), 10.0)


def small_on_film(rng: Rng) -> Setting:
    """Shapes a few pixels wide."""
    return Setting(0.25, condition=10.0) if rng.random() < 0.6 else random_lattice_setting(rng)


def clutter(rng: Rng) -> tuple[Setting, Shapes]:
    """Many small primitives through each other: deep trees, crowded tiles."""
    setting = random_lattice_setting(rng) if rng.random() < 0.3 else Setting(condition=10.0)
    kinds = list(shape_types("small"))
    if rng.random() < 0.5:
        kinds = [str(rng.choice(kinds))]  # so that its tree is deep
    count = int(rng.integers(10, 30))
    return setting, [random_shape(rng, str(rng.choice(kinds)), setting) for _ in range(count)]


def surroundings(rng: Rng) -> tuple[Setting, Shapes]:
    """Eight to thirteen shapes, all but one of few primitives."""
    setting = random_setting(rng, condition=10.0)
    kinds = [*rng.choice(shape_types("small"), int(rng.integers(7, 13))), rng.choice(bounded_types())]
    return setting, [random_shape(rng, str(kind), setting) for kind in kinds]


def put_around_the_eye(rng: Rng, setting: Setting, data: dict[str, Any]) -> dict[str, Any]:
    """The scene with the origin of each shape behind the eye, half of the time, or above, below or beside it.

    Each is so far away that it covers a few pixels: of a larger one, the bounding sphere would hold eye or pole.
    In half of the scenes a sphere is around them all.
    """
    eye, forward, up = (np.array(data["camera"][name]) for name in ("eye", "direction", "up"))
    right = np.cross(forward, up)
    around = np.array([*[-forward] * 4, up, -up, right, -right])
    shapes = []
    for shape, placed in zip(data["shape"], scene_of(data).shapes, strict=True):
        away = 4.0 * around[rng.integers(len(around))] + rng.integers(-4, 5, 3) / 8.0
        move = eye + setting.size * away - placed.matrix[:3, 3]
        shapes.append(shape | {"to_world": [*shape.get("to_world", ()), {"translate": vector(move)}]})
    walls: Shapes = [{"type": "sphere", "center": vector(eye), "radius": 8.0 * setting.size}]
    return data | {"shape": [*shapes, *(walls if coin_flip(rng) else [])]}


def nearly_similar(rng: Rng, setting: Setting) -> Shapes:
    """Matrices within 10^-1 to 10^-16 of a similarity: stretched, sheared, or any way off; some shapes come twice."""
    shapes = []
    for shape in random_shapes(rng, setting, shape_types("quadric"), 3):
        off = rng.normal(size=(3, 3)) * 10.0 ** -float(rng.integers(1, 17))
        off *= (np.eye(3), 1.0 - np.eye(3), np.ones((3, 3)))[int(rng.integers(3))]
        size = setting.size * float(rng.choice([1.0, 0.5, -0.25]))
        similar = size * (np.eye(3) if setting.lattice else random_rotation(rng))
        move = setting.on_lattice(np.array(setting.center) + 1.5 * setting.size * rng.normal(size=3))
        for share in (1.0, 1.0, 0.0)[: int(rng.integers(1, 4))]:
            rows = matrix_rows(similar @ (np.eye(3) + share * off), move)
            shapes.append({**shape, "to_world": [{"matrix": rows}]})
    return shapes


def any_magnitude(rng: Rng) -> tuple[Setting, Shapes]:
    """Sizes of 2^-300 to 2^300; without faces where those are rejected."""
    exponent = int(rng.integers(-MAX_EXPONENT, MAX_EXPONENT + 1))
    setting = Setting(2.0**exponent, condition=10.0, lattice=coin_flip(rng))
    types = shape_types("quadric") if exponent > LARGEST_EXPONENT_OF_FACES else bounded_types()
    return setting, random_shapes(rng, setting, types, 3)


def options(rng: Rng) -> tuple[Setting, Shapes]:
    """Of two kinds at most in half of the scenes, so that most kinds come twice."""
    setting = random_setting(rng, decades_of_size=1.0)
    kinds = rng.choice(shape_types(), 2) if rng.random() < 0.5 else shape_types()
    return setting, [random_shape(rng, str(rng.choice(kinds)), setting) for _ in range(int(rng.integers(1, 5)))]


# Products of three lengths stay below 2^1024 and, where they are not cancelled by 2^120, above 2^-1022. Faces with a
# vertex beyond 2^60.6 are rejected (caster.geometry.world_space.LARGEST_COORDINATE), and shapes have some sizes.
MAX_EXPONENT, LARGEST_EXPONENT_OF_FACES = 300, 55

ANY_SHAPES = shapes_of(random_setting, "", 5)

FAMILIES: tuple[Family, ...] = (
    Family("any", "all shapes, all ways to aim", ANY_SHAPES),
    Family(
        "edges",
        "shared edges and corners of meshes",
        in_random_setting(shared_edges),
        (adversarial_rays.at_features, adversarial_rays.along_axes, adversarial_rays.between_two_points),
    ),
    Family(
        "tangents",
        "rays that touch spheres, ellipsoids, cylinders and rims",
        shapes_of(random_setting, "quadric", 4),
        (adversarial_rays.tangents, adversarial_rays.at_features),
    ),
    Family("ties", "surfaces that coincide, or nearly so", in_random_setting(coincident_shapes)),
    Family(
        "surfaces",
        "rays that start on a surface",
        ANY_SHAPES,
        (adversarial_rays.from_surface, adversarial_rays.between_two_points, adversarial_rays.tangents),
    ),
    Family(
        "planes",
        "rays in the planes of flat shapes",
        shapes_of(random_setting, "flat", 4),
        (adversarial_rays.through_two_points, adversarial_rays.along_axes, adversarial_rays.tangents),
    ),
    Family(
        "lattice", "whole coordinates, axis directions, zeros of either sign", shapes_of(random_lattice_setting, "", 4)
    ),
    Family("slivers", "needles, caps, and faces without an area", in_random_setting(slivers)),
    Family(
        "extremes", "sizes from 1e-100 to 1e17, denormal components", shapes_of(tiny_or_huge, "", 3), fits_float32=False
    ),
    Family(
        "transforms", "stretched, sheared and mirrored shapes, condition up to 1e6", shapes_of(stretched, "bounded", 4)
    ),
    Family(
        "offsets",
        "far from the origin, with rays from near and far",
        shapes_of(far_from_origin, "", 4),
        (adversarial_rays.at_features, adversarial_rays.from_afar, adversarial_rays.anywhere),
    ),
    Family("clutter", "many primitives through each other", clutter),
    Family(
        "pictures",
        "small shapes on larger films, by cameras that rasterize",
        shapes_of(small_on_film, "bounded", 4),
        cameras=("pinhole", "orthographic"),
        films=((16, 12), (13, 13)),
    ),
    Family(
        "surroundings",
        "things all around the eye, at the poles and across the seam, by cameras that see more than a frame",
        surroundings,
        cameras=("panorama", "panorama", "fisheye", "parabolic"),
        films=((48, 8), (16, 16)),
        view=view_from_within,
        finish=put_around_the_eye,
    ),
    Family("similarities", "matrices within 10^-1 to 10^-16 of a similarity", in_random_setting(nearly_similar)),
    Family(
        "magnitudes",
        "scenes and directions of 2^-300 to 2^300",
        any_magnitude,
        tuple(adversarial_rays.of_any_length(aim, MAX_EXPONENT) for aim in adversarial_rays.ALL_AIMS),
        fits_float32=False,
    ),
    Family(
        "options",
        "everything a scene file can say: films, crops, cameras, lights, materials",
        options,
        cameras=(*["pinhole"] * 4, "orthographic", "fisheye", "panorama", "parabolic", "ray"),  # by their options
        finish=with_options,
        always_judged=True,
    ),
)
BY_NAME = {family.name: family for family in FAMILIES}


@dataclass(frozen=True)
class Example:
    """Example number of a seed: a scene as a scene file describes it, and its rays; always the same."""

    seed: int
    number: int
    family: Family
    setting: Setting
    data: dict[str, Any]

    @property
    def options(self) -> str:
        """The options that reproduce it."""
        return f"--seed {self.seed} --family {self.family.name} --examples {self.number}..{self.number}"

    def random(self, stream: int) -> Rng:
        """Random numbers of the example, independent for each stream."""
        return np.random.default_rng([self.seed, self.number, seed_of_name(self.family.name), stream])

    def rays(self, packed: Packed, count: int = RAYS_PER_EXAMPLE) -> RayBatch:
        return aimed_rays(self.random(AIM_STREAM), Targets(packed), self.setting, count, self.family.aims)


def example(seed: int, number: int, families: Sequence[Family]) -> Example:
    """Families take turns, so a family that is selected alone has other examples of the same numbers."""
    family = families[number % len(families)]
    rng = np.random.default_rng([seed, number, seed_of_name(family.name), SCENE_STREAM])
    setting, shapes = family.draw(rng)
    film, camera = random_camera(rng, setting, family.cameras, family.films, family.view)
    data = family.finish(rng, setting, {"film": film, "camera": camera, "shape": shapes})
    return Example(seed, number, family, setting, data)


def seed_of_name(name: str) -> int:
    """A number that stays the same when others are added before it."""
    return zlib.crc32(name.encode())


def scene_of(data: dict[str, Any]) -> Scene:
    """Raises SceneError or pydantic's ValidationError for an invalid description."""
    scene: Scene = Scene.model_validate(data)
    return scene
