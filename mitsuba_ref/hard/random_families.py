"""Families of random scenes with rays at their corners, edges, rims and tangents: no quantity is swept."""

import copy
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from mitsuba_ref import cameras
from mitsuba_ref.hard import rays
from mitsuba_ref.hard.family import Family, HardScene, plain, scene_of
from mitsuba_ref.hard.random_parts import (
    LIGHT_FIELDS,
    SPECULAR,
    log_uniform,
    matrix_step,
    random_frame,
    random_lattice_frame,
    random_rotation,
    random_shape,
    random_shapes,
    random_view,
    shape_types,
    triangle_of,
    with_options,
)
from mitsuba_ref.hard.rays import Aim, Frame, Targets, aimed_rays, perturbed_by_ulps
from mitsuba_ref.shapes.shape_reference import Fields
from mitsuba_ref.shapes.targets import Rng, coin_flip

Shapes = list[Fields]
Draw = Callable[[Rng, Frame], Shapes]
FILM_SIZES = ((5, 5), (6, 4), (4, 4), (7, 3))  # pixels; odd sides have a pixel in the centre of the view
CAMERAS = {each.type_name: each for each in cameras.REFERENCES.values()}


def random_family(
    name: str,
    title: str,
    frame_of: Callable[[Rng], Frame],
    draw: Draw,
    aims: Sequence[Aim] = rays.ALL_AIMS,
    *,
    cameras: Sequence[str] = tuple(CAMERAS),
    films: Sequence[tuple[int, int]] = FILM_SIZES,
    finish: Callable[[Rng, Frame, Fields], Fields] = lambda rng, frame, data: data,
    **more: Any,
) -> Family:
    """cameras: their types. finish: may change the whole scene."""

    def make(rng: Rng, _: float) -> HardScene:
        frame = frame_of(rng)
        shapes = draw(rng, frame)
        kind = str(rng.choice(cameras))
        width, height = films[int(rng.integers(len(films)))]
        camera = CAMERAS[kind].random_fields(rng, frame.size, lambda: random_view(rng, frame))
        film = {"width": width, "height": height}
        data = finish(rng, frame, {"film": film, "camera": {"type": kind, **camera}, "shape": shapes})
        return HardScene(plain(data), lambda rng, packed, count: aimed_rays(Targets(packed, rng, frame), count, aims))

    return Family(name, title, make, **more)


# ---- shapes that are hard together ----


def triangle_fan(rng: Rng, frame: Frame) -> Shapes:
    """A closed fan of 3 to 8 triangles; in a quarter of them the corners of triangles differ by an ulp."""
    count = rng.integers(3, 9)
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count
    rim = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, count)])
    turn = np.eye(3) if frame.lattice else random_rotation(rng)
    rim, tip = frame.placed(rim @ turn.T), frame.placed(np.zeros(3))
    faces = [np.array([tip, rim[i], rim[(i + 1) % count]]) for i in range(count)]
    if rng.random() < 0.25:
        faces = [np.where(face == 0.0, 0.0, perturbed_by_ulps(rng, face, 1)) for face in faces]  # no denormals
    return [triangle_of(np.roll(face, rng.integers(3), axis=0)) for face in faces]


def coincident_shapes(rng: Rng, frame: Frame) -> Shapes:
    """A few coincident shapes in random order, half of the time together with another shape."""
    shapes = COINCIDENT_GROUPS[rng.integers(len(COINCIDENT_GROUPS))](rng, frame)
    if rng.random() < 0.5:
        shapes.append(random_shape(rng, frame, shape_types()))
    return [shapes[i] for i in rng.permutation(len(shapes))]


def copies(rng: Rng, frame: Frame) -> Shapes:
    """The same shape two to six times."""
    shape = random_shape(rng, frame, shape_types())
    return [copy.deepcopy(shape) for _ in range(rng.integers(2, 7))]


def nearly_equal_spheres(rng: Rng, frame: Frame) -> Shapes:
    """Concentric spheres whose radii differ by one ulp or not at all."""
    center = frame.center + frame.size * frame.on_lattice(rng.uniform(-1.0, 1.0, 3))
    radius = frame.size * rng.choice([1.0, 0.625, rng.uniform(0.1, 1.0)])
    radii = [float(perturbed_by_ulps(rng, radius, 1)) for _ in range(rng.integers(2, 7))]
    return [{"type": "sphere", "center": center, "radius": each} for each in radii]


def coincident_squares(rng: Rng, frame: Frame) -> Shapes:
    """The square [-1, 1]^2 as a rectangle, two triangles, a plane, the side of a cube, and with a disk in it."""
    center = frame.center
    step = [{"scale": frame.size}, {"translate": center}]
    corners = frame.center + frame.size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    shapes: Shapes = [
        {"type": "rectangle", "to_world": step},
        {"type": "disk", "to_world": step},
        {"type": "cube", "to_world": [{"translate": [0.0, 0.0, -1.0]}, *step]},
        {"type": "plane", "normal": [0.0, 0.0, 1.0], "point": center},
        {"type": "plane", "normal": [0.0, 0.0, -1.0], "point": corners[1]},
        triangle_of(corners[[0, 1, 2]]),
        triangle_of(corners[[3, 2, 0]]),
    ]
    return [shapes[i] for i in rng.choice(len(shapes), rng.integers(2, 6), replace=False)]


def permuted_triangles(rng: Rng, frame: Frame) -> Shapes:
    """A triangle with its corners in random orders."""
    corners = frame.placed(rng.uniform(-1.0, 1.0, (3, 3)))
    return [triangle_of(rng.permutation(corners)) for _ in range(rng.integers(2, 7))]


def touching_quadrics(rng: Rng, frame: Frame) -> Shapes:
    """A sphere, a cylinder of its radius and a disk in its equator: they touch in a circle and in points."""
    step = [{"scale": frame.size}, {"translate": frame.center}]
    shapes: Shapes = [{"type": str(kind), "to_world": step} for kind in rng.permutation(["sphere", "cylinder", "disk"])]
    return [*shapes, {"type": "sphere", "to_world": [{"translate": [2.0, 0.0, 0.0]}, *step]}]


COINCIDENT_GROUPS: tuple[Draw, ...] = (
    copies,
    nearly_equal_spheres,
    coincident_squares,
    permuted_triangles,
    touching_quadrics,
)


# ---- families ----


def shapes_of(group: str, most: int) -> Draw:
    """One to `most` shapes of a group; "" for all registered shapes."""
    return lambda rng, frame: random_shapes(rng, frame, shape_types(group), most)


def far_from_origin(rng: Rng) -> Frame:
    """1e3 to 1e9 sizes away."""
    size = log_uniform(rng, 1e-3, 1e3)
    return Frame(size, size * log_uniform(rng, 1e3, 1e9) * rng.normal(size=3), 10.0)


def clutter(rng: Rng, frame: Frame) -> Shapes:
    """Many small primitives through each other: deep trees, crowded tiles."""
    kinds = shape_types("small")
    if rng.random() < 0.5:
        kinds = (rng.choice(kinds),)  # so that its tree is deep
    return random_shapes(rng, frame, kinds, 29, 10)


def surroundings(rng: Rng, frame: Frame) -> Shapes:
    """Eight to thirteen shapes, all but one of few primitives."""
    return [*random_shapes(rng, frame, shape_types("small"), 12, 7), random_shape(rng, frame, shape_types("bounded"))]


def put_around_the_eye(rng: Rng, frame: Frame, data: Fields) -> Fields:
    """Move each shape behind the eye (half of them), above, below or beside it.

    The distance is such that a shape covers a few pixels; the bounding sphere of a larger one would contain the eye or
    a pole. Half of the scenes are enclosed in a sphere.
    """
    eye, forward, up = (np.array(data["camera"][name]) for name in ("eye", "direction", "up"))
    right = np.cross(forward, up)
    around = np.array([*[-forward] * 4, up, -up, right, -right])
    shapes = []
    for shape, placed in zip(data["shape"], scene_of(data).shapes, strict=True):
        away = 4.0 * around[rng.integers(len(around))] + rng.integers(-4, 5, 3) / 8.0
        move = eye + frame.size * away - placed.matrix[:3, 3]
        shapes.append(shape | {"to_world": [*shape.get("to_world", ()), {"translate": move}]})
    walls: Shapes = [{"type": "sphere", "center": eye, "radius": 8.0 * frame.size}]
    return data | {"shape": [*shapes, *(walls if coin_flip(rng) else [])]}


def nearly_similar(rng: Rng, frame: Frame) -> Shapes:
    """Matrices within 10^-1 to 10^-16 of a similarity: stretched, sheared, or perturbed; some shapes twice."""
    shapes = []
    for shape in random_shapes(rng, frame, shape_types("quadric"), 3):
        off = rng.normal(size=(3, 3)) * 10.0 ** -float(rng.integers(1, 17))
        off *= (np.eye(3), 1.0 - np.eye(3), 1.0)[rng.integers(3)]
        size = frame.size * rng.choice([1.0, 0.5, -0.25])
        similar = size * (np.eye(3) if frame.lattice else random_rotation(rng))
        move = frame.on_lattice(frame.near(rng, 1.5))
        for share in (1.0, 1.0, 0.0)[: rng.integers(1, 4)]:
            shapes.append({**shape, "to_world": [matrix_step(similar @ (np.eye(3) + share * off), move)]})
    return shapes


def of_few_kinds(rng: Rng, frame: Frame) -> Shapes:
    """Shapes of at most two kinds in half of the scenes, so that most kinds occur twice."""
    kinds = tuple(rng.choice(shape_types(), 2)) if rng.random() < 0.5 else shape_types()
    return random_shapes(rng, frame, kinds, 4)


def furnished(rng: Rng, frame: Frame, data: Fields) -> Fields:
    """The scene in a closed room, with lights and materials: two fifths of the shapes are mirrors or glass."""
    materials: Fields = {"plain": {"reflectance": rng.random(3), "two_sided": True}, **SPECULAR}
    shares = [0.6, *[0.4 / len(SPECULAR)] * len(SPECULAR)]
    shapes = [shape | {"material": str(rng.choice(list(materials), p=shares))} for shape in data["shape"]]
    walls = {"type": "cube", "to_world": [{"scale": 12.0 * frame.size}, {"translate": frame.center}]}
    lights = [{"type": kind, **LIGHT_FIELDS[kind](rng, frame)} for kind in ("point", "directional")]
    return data | {"shape": [*shapes, walls | {"material": "plain"}], "light": lights, "material": materials}


# Products of three lengths stay below 2^1024 and, where they are not cancelled by 2^120, above 2^-1022. Faces with a
# vertex beyond 2^60.6 are rejected (caster.geometry.world_space.LARGEST_COORDINATE), and shapes have some sizes.
MAX_EXPONENT, LARGEST_OF_FACES = 300, 2.0**55

ANY_SHAPES = shapes_of("", 5)

RANDOM: tuple[Family, ...] = (
    random_family("any", "all shapes, all ways to aim", random_frame, ANY_SHAPES),
    random_family(
        "edges",
        "shared edges and corners of meshes",
        random_frame,
        lambda rng, frame: (triangle_fan if rng.random() < 0.5 else shapes_of("mesh", 2))(rng, frame),
        (rays.at_features, rays.along_axes, rays.between_two_points),
    ),
    random_family(
        "tangents",
        "rays that touch spheres, ellipsoids, cylinders and rims",
        random_frame,
        shapes_of("quadric", 4),
        (rays.tangents, rays.at_features),
    ),
    random_family("ties", "surfaces that coincide, or nearly so", random_frame, coincident_shapes),
    random_family(
        "surfaces",
        "rays that start on a surface",
        random_frame,
        ANY_SHAPES,
        (rays.from_surface, rays.between_two_points, rays.tangents),
    ),
    random_family(
        "planes",
        "rays in the planes of flat shapes",
        random_frame,
        shapes_of("flat", 4),
        (rays.through_two_points, rays.along_axes, rays.tangents),
    ),
    random_family(
        "lattice", "whole coordinates, axis directions, zeros of either sign", random_lattice_frame, shapes_of("", 4)
    ),
    random_family(
        "transforms",
        "stretched, sheared and mirrored shapes, condition up to 1e6",
        lambda rng: Frame(condition=1e6),
        shapes_of("bounded", 4),
    ),
    random_family(
        "offsets",
        "far from the origin, with rays from near and far",
        far_from_origin,
        shapes_of("", 4),
        (rays.at_features, rays.from_afar, rays.anywhere),
    ),
    random_family(
        "clutter",
        "many primitives through each other",
        lambda rng: random_lattice_frame(rng) if rng.random() < 0.3 else Frame(condition=10.0),
        clutter,
    ),
    random_family(
        "pictures",
        "small shapes on larger films, by cameras that rasterize",
        lambda rng: Frame(0.25, condition=10.0) if rng.random() < 0.6 else random_lattice_frame(rng),
        shapes_of("bounded", 4),
        cameras=("pinhole", "orthographic"),
        films=((16, 12), (13, 13)),
    ),
    random_family(
        "surroundings",
        "things all around the eye, at the poles and across the seam, by cameras that see more than a frame",
        partial(random_frame, condition=10.0),
        surroundings,
        cameras=("panorama", "panorama", "fisheye", "fisheye"),
        films=((48, 8), (16, 16)),
        finish=put_around_the_eye,
    ),
    random_family("similarities", "matrices within 10^-1 to 10^-16 of a similarity", random_frame, nearly_similar),
    random_family(
        "magnitudes",
        "scenes and directions of 2^-300 to 2^300",
        lambda rng: Frame(
            2.0 ** int(rng.integers(-MAX_EXPONENT, MAX_EXPONENT + 1)), condition=10.0, lattice=coin_flip(rng)
        ),
        lambda rng, frame: shapes_of("quadric" if frame.size > LARGEST_OF_FACES else "bounded", 3)(rng, frame),
        tuple(rays.of_any_length(aim, MAX_EXPONENT) for aim in rays.ALL_AIMS),
        fits_float32=False,
    ),
    random_family(
        "options",
        "everything a scene file can say: films, crops, cameras, lights, materials",
        partial(random_frame, decades_of_size=1.0),
        of_few_kinds,
        cameras=(*["pinhole"] * 4, "orthographic", "fisheye", "panorama", "fisheye", "ray"),  # by their options
        finish=with_options,
        always_judged=True,
    ),
)

# For campaigns, which choose the film; `fuzz`, whose examples are small, leaves it out.
FILMS = random_family(
    "furnished",
    "shapes of ordinary size in a lit room, some of them mirrors or glass",
    lambda rng: Frame(condition=10.0),
    shapes_of("bounded", 12),
    cameras=("pinhole", "orthographic", "fisheye", "panorama"),
    films=((224, 224),),
    finish=furnished,
)
