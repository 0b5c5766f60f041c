"""Families in which one quantity gets extreme, in the order of docs/internals/stress.md."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from caster.geometry.packing import Packed
from caster.rendering.casting import find_nearest
from caster.rendering.hits import validated_rays
from mitsuba_ref.error_model.intersections import Array, Rays, rounded
from mitsuba_ref.hard.family import AimRays, Family, HardScene, plain
from mitsuba_ref.hard.rays import Aim, OriginsAndDirections, Targets, endless
from mitsuba_ref.shapes.shape_reference import Fields
from mitsuba_ref.shapes.targets import Rng, SurfacePoints, random_unit_vectors

CANDIDATES_PER_RAY = 64  # at the extreme end of a sweep few rays go where they were aimed
EYE_DISTANCE = 5.0  # sizes of the shape, from the shape to the rays' origins, unless stressed
SPREAD = 1.4  # sizes of the shape around its centre that rays are aimed at: about half of them hit
TARGET_MISS_SHARE = 0.4  # share of misses among the rays, where there are as many
NO_VIEW: Fields = {  # for rays alone: a camera without a Mitsuba sensor
    "film": {"width": 1, "height": 1},
    "camera": {"type": "fisheye", "eye": [0.0, 0.0, 0.0], "direction": [0.0, 0.0, 1.0]},
}


# ---- rays


def unit(v: Array) -> Array:
    """Each row divided by its length."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def perpendicular(rng: Rng, n: Array) -> Array:
    """(m, 3) random unit vectors perpendicular to the rows of n."""
    return unit(np.cross(n, random_unit_vectors(rng, len(n))))


def turn(rng: Rng) -> Fields:
    """A random rotation step of to_world, so that no coordinate is a round number."""
    return {"rotate": {"axis": random_unit_vectors(rng, 1)[0], "degrees": rng.uniform(20.0, 340.0)}}


def near_origin(rng: Rng) -> Array:
    return rng.normal(scale=0.3, size=3)


def towards(o: Array, p: Array) -> OriginsAndDirections:
    """Rays from o to p, d of length 1, aimed from the rounded o."""
    start = rounded(o)
    return start, unit(p - start)


def batch(o: Array, d: Array) -> Rays:
    """The rays, rounded to float32 numbers."""
    with np.errstate(over="ignore"):
        return endless(rounded(o), rounded(d))


def balanced(draw: Aim, shape: Fields, candidates: int = CANDIDATES_PER_RAY) -> HardScene:
    """A shape, and rays chosen from the drawn ones so that hits and misses are balanced.

    Our caster only chooses the rays; exact arithmetic decides later which of them hit.
    """

    def aim(rng: Rng, packed: Packed, count: int) -> Rays:
        rays = batch(*draw(Targets(packed, rng), candidates * count))
        hit = find_nearest(packed, validated_rays(rays.o, rays.d, 0.0, np.inf)).prim >= 0
        hits, misses = np.flatnonzero(hit), np.flatnonzero(~hit)
        few = min(len(misses), max(count - len(hits), round(TARGET_MISS_SHARE * count)))
        return rays.take(np.sort(np.concatenate([hits[: count - few], misses[:few]])))

    return hard_scene(aim, shape)


def hard_scene(aim: AimRays, *shapes: Fields, **more: Any) -> HardScene:
    return HardScene(plain({**NO_VIEW, "shape": shapes, **more}), aim)


def points_around(targets: Targets, count: int) -> SurfacePoints:
    """Surface points, moved towards the centre or away from it: of a flat shape, within its plane."""
    at = targets.points(count, "inside")
    center = at.p.mean(axis=0)
    return at._replace(p=center + SPREAD * np.sqrt(targets.rng.random((count, 1))) * (at.p - center))


def seen_from(distance: float, shape: Fields) -> HardScene:
    """A shape, and rays from all directions at a distance."""

    def draw(targets: Targets, count: int) -> OriginsAndDirections:
        p = points_around(targets, count).p
        return towards(p + distance * random_unit_vectors(targets.rng, count), p)

    return balanced(draw, shape)


Round = Callable[[Rng, Array, float], Fields]  # a shape of this centre and radius


def ball(rng: Rng, center: Array, radius: float) -> Fields:
    return {"type": "sphere", "center": center, "radius": radius}


def icosphere(rng: Rng, center: Array, radius: float) -> Fields:
    """80 triangles, rotated."""
    place = [{"scale": radius}, turn(rng), {"translate": center}]
    return {"type": "icosphere", "subdivisions": 1, "face_normals": True, "to_world": place}


# ---- families


def scaled(shape: Round, rng: Rng, scale: float) -> HardScene:
    return seen_from(EYE_DISTANCE * scale, shape(rng, scale * near_origin(rng), scale))


def offset(shape: Round, rng: Rng, away: float) -> HardScene:
    return seen_from(EYE_DISTANCE, shape(rng, rounded(away * random_unit_vectors(rng, 1)[0]), 1.0))


def distant_triangle(rng: Rng, distance: float) -> HardScene:
    """A triangle of about unit size, never the same."""
    corners = np.array([[1.0, 0.1, 0.2], [-0.6, 0.8, -0.3], [-0.4, -0.9, 0.1]]) + rng.normal(scale=0.1, size=(3, 3))
    return seen_from(distance, {"type": "triangle", "vertices": corners})


def of_length(shape: Round, rng: Rng, length: float) -> HardScene:
    """Directions scaled by `length` and rounded to float32 again, which changes them slightly."""
    made = scaled(shape, rng, 1.0)

    def aim(rng: Rng, packed: Packed, count: int) -> Rays:
        rays = made.aim(rng, packed, count)
        return batch(rays.o, length * rays.d)

    return made._replace(aim=aim)


def grazing(kind: str, rng: Rng, angle: float) -> HardScene:
    """Rays to points of a flat shape and around it, at an angle to it."""

    def draw(targets: Targets, count: int) -> OriginsAndDirections:
        p, _, across = points_around(targets, count)
        n, rng = unit(across), targets.rng
        back = np.cos(angle) * perpendicular(rng, n) + rng.choice([-1.0, 1.0], (count, 1)) * np.sin(angle) * n
        return towards(p + EYE_DISTANCE * back, p)

    return balanced(draw, {"type": kind, "to_world": [turn(rng), {"translate": near_origin(rng)}]})


def sliver(rng: Rng, aspect: float) -> HardScene:
    """aspect: height over a base of 1. Rotated, so that rounding moves its corners in all directions."""
    corners = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [rng.uniform(-0.2, 0.2), aspect, 0.0]]
    return seen_from(EYE_DISTANCE, {"type": "triangle", "vertices": corners, "to_world": [turn(rng)]})


# Rays that rounding moved further are dropped: half a decade to each side, where the next gap begins.
GAP_TOLERANCE = (0.3, 3.0)
TANGENT_CANDIDATES_PER_RAY = 400  # at the narrowest gap one in fifty stays in it


def tangency(rng: Rng, gap: float) -> HardScene:
    """Rays that pass the centre at r (1 - gap) or r (1 + gap)."""

    def draw(targets: Targets, count: int) -> OriginsAndDirections:
        (part,), rng = targets.packed.parts, targets.rng
        center, r, v = part.center[0], part.radius[0], random_unit_vectors(rng, count)
        beside = center + r * (1.0 + gap * rng.choice([-1.0, 1.0], (count, 1))) * perpendicular(rng, v)
        o, d = towards(beside - EYE_DISTANCE * v, beside)
        off = np.abs(np.linalg.norm(np.cross(center - o, unit(rounded(d))), axis=1) / r - 1.0)
        kept = (off >= GAP_TOLERANCE[0] * gap) & (off <= GAP_TOLERANCE[1] * gap)
        return o[kept], d[kept]

    return balanced(draw, ball(rng, near_origin(rng), 1.0), TANGENT_CANDIDATES_PER_RAY)


LENGTH_TIMES_ANGLE = 4.0  # radii: a ray from the axis reaches the wall after a quarter of the cylinder


def along_cylinder(rng: Rng, angle: float) -> HardScene:
    """Rays inside a cylinder: half start far enough from its end to hit the wall, half leave by the end."""

    def draw(targets: Targets, count: int) -> OriginsAndDirections:
        (part,), rng = targets.packed.parts, targets.rng
        turned = rng.uniform(0.0, 2.0 * np.pi, count)
        height = np.where(rng.random(count) < 0.6, rng.uniform(0.05, 0.5, count), rng.uniform(0.7, 0.95, count))
        start = np.column_stack([*rng.uniform(-0.3, 0.3, (2, count)), height])
        lean = np.column_stack([np.cos(turned), np.sin(turned), np.full(count, 1.0 / LENGTH_TIMES_ANGLE)])
        matrix = part.to_world[0].T
        return part.center[0] + start @ matrix, unit(lean @ matrix)

    axis = perpendicular(rng, np.array([[0.3, 0.5, 0.8]]))[0] * (LENGTH_TIMES_ANGLE / angle)
    return balanced(draw, {"type": "cylinder", "p0": -0.5 * axis, "p1": 0.5 * axis, "radius": 1.0})


def stretched_sphere(rng: Rng, condition: float) -> HardScene:
    """Half axes 1, condition^-1/2 and 1/condition, rotated; a second stretch keeps condition 1 an ellipsoid."""
    stretch = [{"scale": [1.0, condition**-0.5, 1.0 / condition]}, {"scale": [1.0, 1.0, 0.999]}]
    place = [*stretch, turn(rng), {"translate": near_origin(rng)}]
    return seen_from(EYE_DISTANCE, {"type": "sphere", "to_world": place})


def leaving(shape: Round, rng: Rng, away: float) -> HardScene:
    """Rays from p + away n on a surface: half outwards, half inwards."""

    def aim(rng: Rng, packed: Packed, count: int) -> Rays:
        d = random_unit_vectors(rng, count)
        p, _, across = Targets(packed, rng).points(count, "inside")
        n, outwards = unit(across), np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
        return batch(p + away * n, d * (np.sign(np.einsum("ij,ij->i", d, n)) * outwards)[:, None])

    return hard_scene(aim, shape(rng, near_origin(rng), 1.0))


SUBDIVISIONS = 4  # 5,120 faces
RAYS_PER_EYE = 500
MAX_EYE_RADIUS = 0.5  # radii: how far from the centre rays start


def watertight(share: float, rng: Rng, away: float) -> HardScene:
    """Rays from inside a closed mesh at its edges; every other d is p - eye, the rest have length 1.

    share: the part of an edge that rays are aimed at, from its start; 0: its start, a vertex.
    """
    move = away * random_unit_vectors(rng, 1)[0]

    def aim(rng: Rng, packed: Packed, count: int) -> Rays:
        (part,), eyes = packed.parts, -(-count // RAYS_PER_EYE)
        within = MAX_EYE_RADIUS * rng.random((eyes, 1)) * random_unit_vectors(rng, eyes)
        o = rounded(np.repeat(move + within, RAYS_PER_EYE, axis=0)[:count])
        start, end, _ = part.vertices[rng.choice(part.faces, count)].swapaxes(0, 1)
        d = start + share * rng.random((count, 1)) * (end - start) - o
        d[1::2] = unit(d[1::2])
        return batch(o, d)

    place = [turn(rng), {"translate": move}]
    mesh = {"type": "icosphere", "subdivisions": SUBDIVISIONS, "face_normals": True, "to_world": place}
    return hard_scene(aim, mesh)


def decades(*exponents: int) -> tuple[float, ...]:
    return tuple(float(f"1e{exponent}") for exponent in exponents)


TENFOLD = decades(*range(8))
TINY = decades(*range(-8, 0))
UP_TO_ONE = (*TINY, 1.0)
MESH_SCALES = decades(-20, -16, -14, -13, -12, -11, -9, -6, -3, 0, 3, 6, 9, 11, 12, 13, 14, 16, 18)
SPHERE_SCALES = decades(-30, -24, -20, -19, -17, -15, -12, -8, -4, 0, 4, 8, 12, 15, 17, 18, 19, 20, 24, 30)
LENGTHS = decades(-36, -30, -25, -20, -15, -10, -5, -3, 0, 3, 5, 10, 15, 18, 20, 25, 30, 36)
START_OFFSETS = (0.0, *TINY)
CENTER_OFFSETS = (0.0, 1e1, 1e3, 1e4, 1.5e5, 1e6)
ANGLE = "angle between ray and surface, radians"
OFFSET, START = "offset over radius", "offset of the start over radius"
CENTER = "offset from the origin over radius"

SWEPT: tuple[Family, ...] = (
    Family(
        "scale-mesh",
        "the size of a whole scene of triangles",
        partial(scaled, icosphere),
        "radius, scene units",
        MESH_SCALES,
        fits_float32=False,  # Mitsuba's normals of smaller triangles than 1e-10 are infinite
    ),
    Family(
        "scale-sphere",
        "the size of a whole scene of a sphere",
        partial(scaled, ball),
        "radius of the sphere, scene units",
        SPHERE_SCALES,
        fits_float32=False,  # Mitsuba takes a sphere of radius 1e-24 for a stretched one
    ),
    Family(
        "offset-mesh",
        "how far from the origin a sphere of triangles is",
        partial(offset, icosphere),
        OFFSET,
        (*TENFOLD[:-1], 3e6, 1e7),
    ),
    Family("offset-sphere", "how far from the origin a sphere is", partial(offset, ball), OFFSET, TENFOLD),
    Family(
        "distance-triangle",
        "how far rays come to a triangle",
        distant_triangle,
        "distance over size",
        (*TENFOLD[1:], 1e8),
        10.0,
    ),
    Family(
        "distance-sphere",
        "how far rays come to a sphere",
        lambda rng, distance: seen_from(distance, ball(rng, near_origin(rng), 1.0)),
        "distance over radius",
        (*TENFOLD[1:], 1e8),
        10.0,
    ),
    Family(
        "grazing-rectangle", "rays that run nearly along two triangles", partial(grazing, "rectangle"), ANGLE, UP_TO_ONE
    ),
    Family("grazing-disk", "rays that run nearly along a disk", partial(grazing, "disk"), ANGLE, UP_TO_ONE),
    Family("sliver", "how thin a triangle is", sliver, "height over base", UP_TO_ONE[1:]),
    Family(
        "tangency",
        "how nearly rays touch a sphere's silhouette",
        tangency,
        "distance from the silhouette over radius",
        TINY,
        0.1,
    ),
    Family(
        "watertight-edges",
        "rays from inside a closed mesh of 5,120 faces, aimed at its edges",
        partial(watertight, 1.0),
        CENTER,
        CENTER_OFFSETS,
        0.0,
        closed=True,
    ),
    Family(
        "watertight-vertices",
        "rays from inside a closed mesh of 5,120 faces, aimed at its vertices",
        partial(watertight, 0.0),
        CENTER,
        CENTER_OFFSETS,
        0.0,
        closed=True,
    ),
    Family("length-mesh", "how long d is, at triangles", partial(of_length, icosphere), "length of d", LENGTHS),
    Family("length-sphere", "how long d is, at a sphere", partial(of_length, ball), "length of d", LENGTHS),
    Family(
        "axis",
        "rays inside a cylinder, nearly along its axis",
        along_cylinder,
        "angle between ray and axis, radians",
        UP_TO_ONE[1:],
    ),
    Family(
        "condition",
        "how much the transform of an ellipsoid stretches",
        stretched_sphere,
        "condition of to_world",
        (1.0, 3.0, *TENFOLD[1:-1]),
    ),
    Family(
        "shadow-sphere",
        "how far off a sphere the rays start that leave it",
        partial(leaving, ball),
        START,
        START_OFFSETS,
        0.1,
        unit=1.0,
    ),
    Family(
        "shadow-mesh",
        "how far off a sphere of triangles the rays start that leave it",
        partial(leaving, icosphere),
        START,
        START_OFFSETS,
        0.1,
        unit=1.0,
    ),
)

# ---- families of surfaces that rays leave, for the origins of these rays

MATERIALS: Fields = {"glass": {"type": "glass", "ior": 1.5}, "mirror": {"type": "mirror"}}
INNER_SHARE = 0.5  # radius of the inner sphere, unless stressed


def leaving_scene(shapes: list[Fields], distance: float, angle: float = 0.0) -> HardScene:
    """Rays from a distance to points of the shapes, from all directions, or at an angle to the surface."""

    def aim(rng: Rng, packed: Packed, count: int) -> Rays:
        p, _, across = Targets(packed, rng).points(count, "inside")
        back = random_unit_vectors(rng, count)
        if angle:
            n = unit(across)
            back = np.cos(angle) * perpendicular(rng, n) + np.sin(angle) * n
        return batch(*towards(p + distance * back, p))

    return hard_scene(aim, *shapes, material=MATERIALS)


def nested(center: Array, radius: float, inner: float) -> list[Fields]:
    """A sphere of glass within another one."""
    sphere: dict[str, Any] = {"type": "sphere", "center": rounded(center), "material": "glass"}
    return [sphere | {"radius": radius}, sphere | {"radius": inner}]


def with_mesh(rng: Rng, center: Array, radius: float) -> list[Fields]:
    """Nested spheres, and triangles of glass beside them."""
    beside = icosphere(rng, center + 2.5 * radius * random_unit_vectors(rng, 1)[0], radius)
    return [*nested(center, radius, INNER_SHARE * radius), beside | {"material": "glass"}]


def grazing_mirrors(rng: Rng, angle: float) -> HardScene:
    """A sphere and two triangles that do not hide each other."""
    place = [turn(rng), {"translate": near_origin(rng)}]
    sphere = {"type": "sphere", "material": "mirror", "to_world": place}
    square = {"type": "rectangle", "material": "mirror", "to_world": [*place, {"translate": [100.0, 0.0, 0.0]}]}
    return leaving_scene([sphere, square], EYE_DISTANCE, angle)


SIZES = decades(-12, -9, -6, -5, -4, -3, -2, -1, 0, 3, 6, 9, 12)

SPAWNED: tuple[Family, ...] = (
    Family(
        "spawn-gap",
        "how near a second surface is: two spheres of glass, one within the other",
        lambda rng, width: leaving_scene(nested(near_origin(rng), 1.0, 1.0 - width), EYE_DISTANCE),
        "distance of the spheres over radius",
        (*TINY[1:4], 4e-5, *TINY[4:]),
        0.1,
    ),
    Family(
        "spawn-scale",
        "the size of a scene that rays leave",
        lambda rng, size: leaving_scene(with_mesh(rng, size * near_origin(rng), size), EYE_DISTANCE * size),
        "radius, scene units",
        SIZES,
        fits_float32=False,  # Mitsuba takes a sphere of radius 5e-13 for a stretched one
    ),
    Family(
        "spawn-offset",
        "how far from the origin rays leave",
        lambda rng, away: leaving_scene(with_mesh(rng, away * random_unit_vectors(rng, 1)[0], 1.0), EYE_DISTANCE),
        OFFSET,
        TENFOLD,
    ),
    Family(
        "spawn-grazing",
        "how nearly rays leave a sphere or two triangles along them",
        grazing_mirrors,
        ANGLE,
        UP_TO_ONE[1:],
    ),
)
