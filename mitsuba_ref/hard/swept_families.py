"""Families in which one quantity gets extreme, in the order of docs/stress.md."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from caster.cameras import Pinhole
from caster.geometry.packing import Packed, Triangles
from caster.rendering.images import camera_rays
from mitsuba_ref.hard.family import AimRays, Family, Fields, HardScene, scene_of
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.shapes.targets import Rng

EyesAndPoints = tuple[np.ndarray, np.ndarray]  # float32 origins and directions, (n, 3) each
Crosses = Callable[[Any, np.ndarray, np.ndarray], np.ndarray]  # whether lines meet a part, (n,) bool

CANDIDATES_PER_RAY = 64  # at the extreme end of a sweep few rays go where they were aimed
EYE_DISTANCE = 5.0  # sizes of the shape, from the shape to the rays' origins, unless stressed
MIN_ABS_COS = 0.3  # least |cos| between rays and the normal of a triangle that is not to be grazed
AIM_RADIUS = 1.4  # radii around the centre that rays are aimed at: about half of them hit
TARGET_MISS_SHARE = 0.4  # share of misses among the rays, where there are as many
NO_VIEW: Fields = {  # for rays alone: a camera without a Mitsuba sensor
    "film": {"width": 1, "height": 1},
    "camera": {"type": "fisheye", "eye": [0.0, 0.0, 0.0], "direction": [0.0, 0.0, 1.0]},
}


def hard_scene(aim: AimRays, *shapes: Fields, **view: Fields) -> HardScene:
    return HardScene({**NO_VIEW, **view, "shape": list(shapes)}, aim)


# ---- rays


def unit(v: np.ndarray) -> np.ndarray:
    """Each row divided by its length."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def directions(rng: Rng, count: int) -> np.ndarray:
    """(count, 3) unit vectors, uniformly distributed."""
    return unit(rng.normal(size=(count, 3)))


def perpendicular(rng: Rng, n: np.ndarray) -> np.ndarray:
    """(m, 3) random unit vectors perpendicular to the rows of n."""
    return unit(np.cross(n, directions(rng, len(n))))


def turn(rng: Rng) -> Fields:
    """A random rotation step of to_world, so that no coordinate is a round number."""
    return {"rotate": {"axis": directions(rng, 1)[0].tolist(), "degrees": float(rng.uniform(20.0, 340.0))}}


def float32(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a, np.float32)


def towards(o: np.ndarray, p: np.ndarray) -> EyesAndPoints:
    """float32 rays from o to p, d of about unit length, aimed from the rounded o."""
    start = float32(o)
    return start, float32(unit(p - start.astype(np.float64)))


def batch(o: np.ndarray, d: np.ndarray) -> RayBatch:
    with np.errstate(over="ignore"):
        o, d = (float32(a).astype(np.float64) for a in (o, d))
    return RayBatch(o, d, np.zeros(len(o)), np.full(len(o), np.inf))


def balanced(rays: EyesAndPoints, inside: np.ndarray, count: int) -> RayBatch:
    """`count` of the rays: misses up to their share, else hits. inside: (m,) whether a ray hits in float64.

    Float64 only chooses rays here; hits and misses are decided by exact arithmetic later.
    """
    hits, misses = np.flatnonzero(inside), np.flatnonzero(~inside)
    few = min(len(misses), max(count - len(hits), round(TARGET_MISS_SHARE * count)))
    rows = np.sort(np.concatenate([hits[: count - few], misses[:few]]))
    return batch(*(a[rows] for a in rays))


def selecting(draw: Callable[[Rng, Any, int], EyesAndPoints], crosses: Crosses) -> AimRays:
    """Rays by `draw` at the first shape, hits and misses balanced over all shapes."""

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        rays = draw(rng, packed.parts[0], CANDIDATES_PER_RAY * count)
        o, d = (a.astype(np.float64) for a in rays)
        inside = np.any([crosses(part, o, d) for part in packed.parts], axis=0)
        return balanced(rays, inside, count)

    return aim


def crosses_triangles(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    found = np.zeros(len(o), bool)
    for triangle in part.vertices[part.faces]:
        a, b, c = (corner - o for corner in triangle)
        sides = [np.einsum("ij,ij->i", d, np.cross(p, q)) for p, q in ((c, b), (a, c), (b, a))]
        found |= (np.min(sides, axis=0) >= 0.0) | (np.max(sides, axis=0) <= 0.0)
    return found


def crosses_sphere(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    return passing_distance(part, o, d) < part.radius[0]


def passing_distance(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) between a sphere's centre and each ray's line."""
    return np.linalg.norm(np.cross(part.center[0] - o, unit(d)), axis=1)


def in_object_space(part: Any, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T


def unit_corners(rng: Rng) -> np.ndarray:
    """A triangle of about unit size, never the same."""
    return np.array([[1.0, 0.1, 0.2], [-0.6, 0.8, -0.3], [-0.4, -0.9, 0.1]]) + rng.normal(scale=0.1, size=(3, 3))


def rays_to_triangle(distance: float, rng: Rng, part: Any, count: int) -> EyesAndPoints:
    """From this distance to points of the part's first triangle, and to points just beside it."""
    corners = part.vertices[part.faces[0]]
    n = unit(np.cross(corners[1] - corners[0], corners[2] - corners[0])[None])[0]
    v = directions(rng, count)
    v[np.abs(v @ n) < MIN_ABS_COS] = n
    aim = (rng.dirichlet(np.ones(3), count) * 1.4 - 0.4 / 3.0) @ corners
    return towards(aim + distance * v, aim)


def aim_around(center: np.ndarray, radius: float, distance: float, crosses: Crosses) -> AimRays:
    """From all directions, at a distance, to a sphere."""

    def draw(rng: Rng, part: Any, count: int) -> EyesAndPoints:
        around = directions(rng, count)
        p = center + AIM_RADIUS * radius * np.sqrt(rng.random((count, 1))) * directions(rng, count)
        return towards(center + distance * around, p)

    return selecting(draw, crosses)


Round = Callable[[Rng, np.ndarray, float], tuple[Fields, Crosses]]  # a shape of this centre and radius


def ball(rng: Rng, center: np.ndarray, radius: float) -> tuple[Fields, Crosses]:
    return {"type": "sphere", "center": center.tolist(), "radius": radius}, crosses_sphere


def icosphere(rng: Rng, center: np.ndarray, radius: float) -> tuple[Fields, Crosses]:
    """80 triangles, rotated."""
    place = [{"scale": radius}, turn(rng), {"translate": center.tolist()}]
    return {"type": "icosphere", "subdivisions": 1, "face_normals": True, "to_world": place}, crosses_triangles


# ---- families


def scaled(shape: Round, rng: Rng, scale: float) -> HardScene:
    center = scale * rng.normal(scale=0.3, size=3)
    fields, crosses = shape(rng, center, scale)
    return hard_scene(aim_around(center, scale, EYE_DISTANCE * scale, crosses), fields)


def offset(shape: Round, rng: Rng, away: float) -> HardScene:
    center = float32(away * directions(rng, 1)[0]).astype(np.float64)
    fields, crosses = shape(rng, center, 1.0)
    return hard_scene(aim_around(center, 1.0, EYE_DISTANCE, crosses), fields)


def distant_triangle(rng: Rng, distance: float) -> HardScene:
    corners = {"type": "triangle", "vertices": unit_corners(rng).tolist()}
    return hard_scene(selecting(partial(rays_to_triangle, distance), crosses_triangles), corners)


def distant_sphere(rng: Rng, distance: float) -> HardScene:
    center = rng.normal(scale=0.3, size=3)
    return hard_scene(aim_around(center, 1.0, distance, crosses_sphere), ball(rng, center, 1.0)[0])


def of_length(shape: Round, rng: Rng, length: float) -> HardScene:
    """Directions scaled by `length` and rounded to float32 again, which changes them slightly."""
    made = scaled(shape, rng, 1.0)

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        rays = made.aim(rng, packed, count)
        return batch(rays.o, length * rays.d)

    return HardScene(made.data, aim)


def grazing(kind: str, rng: Rng, angle: float) -> HardScene:
    """Rays to points of a flat shape and around it, at an angle to it; four in ten pass the rim."""

    def draw(rng: Rng, part: Any, count: int) -> EyesAndPoints:
        if kind == "disk":
            center, axes = part.center[0], part.to_world[0].T
        else:
            corners = part.vertices
            center, first, second = corners.mean(axis=0), corners[1] - corners[0], corners[3] - corners[0]
            axes = np.stack([0.5 * first, 0.5 * second, np.cross(first, second)])
        p = center + rng.uniform(-1.3, 1.3, (count, 2)) @ axes[:2]
        n = np.tile(axes[2] / np.linalg.norm(axes[2]), (count, 1))
        back = np.cos(angle) * perpendicular(rng, n) + rng.choice([-1.0, 1.0], (count, 1)) * np.sin(angle) * n
        return towards(p + EYE_DISTANCE * back, p)

    def crosses_disk(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = in_object_space(part, o, d)
        with np.errstate(all="ignore"):
            q = f - (f[:, 2:] / e[:, 2:]) * e
        return np.hypot(q[:, 0], q[:, 1]) <= 1.0

    place = [turn(rng), {"translate": rng.normal(scale=0.3, size=3).tolist()}]
    crosses = crosses_disk if kind == "disk" else crosses_triangles
    return hard_scene(selecting(draw, crosses), {"type": kind, "to_world": place})


def sliver(rng: Rng, aspect: float) -> HardScene:
    """aspect: height over a base of 1. Rotated, so that rounding moves its corners in all directions."""
    corners = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [float(rng.uniform(-0.2, 0.2)), aspect, 0.0]]
    shape = {"type": "triangle", "vertices": corners, "to_world": [turn(rng)]}
    return hard_scene(selecting(partial(rays_to_triangle, EYE_DISTANCE), crosses_triangles), shape)


# Rays that rounding moved further are dropped: half a decade to each side, where the next gap begins.
GAP_TOLERANCE = (0.3, 3.0)
TANGENT_CANDIDATES_PER_RAY = 400  # at the narrowest gap one in fifty stays in it


def tangency(rng: Rng, gap: float) -> HardScene:
    """Rays that pass the centre at r (1 - gap) or r (1 + gap)."""

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        part, many = packed.parts[0], TANGENT_CANDIDATES_PER_RAY * count
        center, r, v = part.center[0], part.radius[0], directions(rng, many)
        beside = center + r * (1.0 + gap * rng.choice([-1.0, 1.0], (many, 1))) * perpendicular(rng, v)
        rays = towards(beside - EYE_DISTANCE * v, beside)
        off = passing_distance(part, *(a.astype(np.float64) for a in rays)) / r - 1.0
        kept = (np.abs(off) >= GAP_TOLERANCE[0] * gap) & (np.abs(off) <= GAP_TOLERANCE[1] * gap)
        o, d = (a[kept] for a in rays)
        return balanced((o, d), off[kept] < 0.0, count)

    return hard_scene(aim, ball(rng, rng.normal(scale=0.3, size=3), 1.0)[0])


LENGTH_TIMES_ANGLE = 4.0  # radii: a ray from the axis reaches the wall after a quarter of the cylinder


def along_cylinder(rng: Rng, angle: float) -> HardScene:
    """Rays inside a cylinder: half start far enough from its end to hit the wall, half leave by the end."""

    def draw(rng: Rng, part: Any, count: int) -> EyesAndPoints:
        turned = rng.uniform(0.0, 2.0 * np.pi, count)
        height = np.where(rng.random(count) < 0.6, rng.uniform(0.05, 0.5, count), rng.uniform(0.7, 0.95, count))
        start = np.column_stack([*rng.uniform(-0.3, 0.3, (2, count)), height])
        lean = np.column_stack([np.cos(turned), np.sin(turned), np.full(count, 1.0 / LENGTH_TIMES_ANGLE)])
        matrix = part.to_world[0].T
        return float32(part.center[0] + start @ matrix), float32(unit(lean @ matrix))

    def reaches_wall(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = in_object_space(part, o, d)
        a, b = (e[:, :2] ** 2).sum(axis=1), (f[:, :2] * e[:, :2]).sum(axis=1)
        c = (f[:, :2] ** 2).sum(axis=1) - 1.0
        with np.errstate(all="ignore"):
            z = f[:, 2] + (np.sqrt(b * b - a * c) - b) / a * e[:, 2]
        found: np.ndarray = (z >= 0.0) & (z <= 1.0)
        return found

    axis = perpendicular(rng, np.array([[0.3, 0.5, 0.8]]))[0] * (LENGTH_TIMES_ANGLE / angle)
    shape = {"type": "cylinder", "p0": (-0.5 * axis).tolist(), "p1": (0.5 * axis).tolist(), "radius": 1.0}
    return hard_scene(selecting(draw, reaches_wall), shape)


def stretched_sphere(rng: Rng, condition: float) -> HardScene:
    """Half axes 1, condition^-1/2 and 1/condition, rotated; a second stretch keeps condition 1 an ellipsoid."""

    def draw(rng: Rng, part: Any, count: int) -> EyesAndPoints:
        p = AIM_RADIUS * np.sqrt(rng.random((count, 1))) * directions(rng, count) @ part.to_world[0].T
        return towards(part.center[0] + EYE_DISTANCE * directions(rng, count), part.center[0] + p)

    def crosses(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = in_object_space(part, o, d)
        return np.linalg.norm(np.cross(f, unit(e)), axis=1) < 1.0

    stretch = [{"scale": [1.0, condition**-0.5, 1.0 / condition]}, {"scale": [1.0, 1.0, 0.999]}]
    place = [*stretch, turn(rng), {"translate": rng.normal(scale=0.3, size=3).tolist()}]
    return hard_scene(selecting(draw, crosses), {"type": "sphere", "to_world": place})


VIEW_SIDE = 20  # pixels of an image whose rays are cast
SQUARE_SHARE = 0.7  # of the image's width


def own_rays(rng: Rng, camera: Pinhole, shape: Fields, **film: Any) -> HardScene:
    """The camera's own rays, rounded to float32."""
    data = {"film": film, "camera": camera.model_dump(exclude_none=True), "shape": [shape]}

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        rays = camera_rays(scene_of(data))
        rows = np.unique(np.linspace(0, len(rays.t_max) - 1, count).astype(int))
        return batch(rays.o[rows], rays.d[rows])

    return HardScene(data, aim)


def random_view(rng: Rng, fov: float) -> tuple[np.ndarray, Pinhole]:
    """A float32 eye, and a camera there."""
    view = rng.normal(size=3)
    eye = float32(rng.normal(scale=0.3, size=3)).astype(np.float64)
    return eye, Pinhole(eye=tuple(eye), direction=tuple(view / np.linalg.norm(view)), fov=fov)


def field_of_view(rng: Rng, tangent: float) -> HardScene:
    """A tilted square that fills most of the image."""
    eye, camera = random_view(rng, math.degrees(2.0 * math.atan(tangent)))
    steps = [
        {"rotate": {"axis": [0.0, 0.0, 1.0], "degrees": 20.0}},
        {"scale": SQUARE_SHARE * tangent},
        {"look_at": {"origin": (eye + camera.frame[2]).tolist(), "target": eye.tolist(), "up": list(camera.frame[1])}},
    ]
    return own_rays(rng, camera, {"type": "rectangle", "to_world": steps}, width=VIEW_SIDE, height=VIEW_SIDE)


def film_size(rng: Rng, width: float) -> HardScene:
    """A crop window around a point of a sphere's silhouette, in a square film of this width."""
    eye, camera = random_view(rng, 45.0)
    turned, side = rng.uniform(0.0, 2.0 * math.pi), min(int(width), VIEW_SIDE)
    share = math.tan(math.asin(1.0 / EYE_DISTANCE)) / math.tan(math.radians(camera.fov / 2.0))
    middle = [0.5 * (1.0 + share * math.cos(turned)), 0.5 * (1.0 - share * math.sin(turned))]
    start = [min(max(round(m * width - side / 2), 0), int(width) - side) for m in middle]
    crop = [*start, start[0] + side, start[1] + side]
    sphere = ball(rng, eye + EYE_DISTANCE * np.array(camera.frame[2]), 1.0)[0]
    return own_rays(rng, camera, sphere, width=int(width), height=int(width), crop=crop)


def coincident_triangles(rng: Rng, gap: float) -> HardScene:
    """A large triangle and its copy, moved along the normal; the copy is in front for half of the rays."""
    corners = unit_corners(rng)
    n = unit(np.cross(corners[1] - corners[0], corners[2] - corners[0])[None])[0]
    shapes = [{"type": "triangle", "vertices": each.tolist()} for each in (corners, corners + gap * n)]
    return hard_scene(selecting(partial(rays_to_triangle, EYE_DISTANCE), crosses_triangles), *shapes)


def coincident_spheres(rng: Rng, gap: float) -> HardScene:
    """Two concentric spheres; the second is the larger one."""
    center = rng.normal(scale=0.3, size=3)
    shapes = [ball(rng, center, radius)[0] for radius in (1.0, 1.0 + gap)]
    return hard_scene(aim_around(center, 1.2 / AIM_RADIUS, EYE_DISTANCE, crosses_sphere), *shapes)


def leaving(shape: Round, rng: Rng, away: float) -> HardScene:
    """Rays from p + away n on a surface: half outwards, half inwards."""

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        part = packed.parts[0]
        if hasattr(part, "radius"):
            n = directions(rng, count)
            p = part.center[0] + part.radius[0] * n
        else:
            corners = part.vertices[part.faces[rng.integers(len(part.faces), size=count)]]
            p = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), count), corners)
            n = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        d = directions(rng, count)
        outwards = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
        return batch(p + away * n, d * (np.sign(np.einsum("ij,ij->i", d, n)) * outwards)[:, None])

    return hard_scene(aim, shape(rng, rng.normal(scale=0.3, size=3), 1.0)[0])


SUBDIVISIONS = 4  # 5,120 faces
RAYS_PER_EYE = 500
MAX_EYE_RADIUS = 0.5  # radii: how far from the centre rays start


def watertight(at: str, rng: Rng, away: float) -> HardScene:
    """Rays from inside a closed mesh at its edges or vertices; every other d is p - eye, the rest of length 1."""
    move = away * directions(rng, 1)[0]

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        part = packed.parts[0]
        check_closed(part.faces)
        eyes = -(-count // RAYS_PER_EYE)
        within = MAX_EYE_RADIUS * rng.random((eyes, 1)) * directions(rng, eyes)
        o = float32(np.repeat(move + within, RAYS_PER_EYE, axis=0)[:count])
        d = points(rng, part, count) - o.astype(np.float64)
        d[1::2] = unit(d[1::2])
        return batch(o, d)

    def points(rng: Rng, part: Triangles, count: int) -> np.ndarray:
        if at == "vertices":
            return part.vertices[rng.integers(len(part.vertices), size=count)]
        corners = part.vertices[part.faces[rng.integers(len(part.faces), size=count)]]
        return corners[:, 0] + rng.random((count, 1)) * (corners[:, 1] - corners[:, 0])

    place = [turn(rng), {"translate": move.tolist()}]
    mesh = {"type": "icosphere", "subdivisions": SUBDIVISIONS, "face_normals": True, "to_world": place}
    return hard_scene(aim, mesh)


def check_closed(faces: np.ndarray) -> None:
    """Raise ValueError unless every edge occurs once in each direction: no ray from inside then leaves the mesh."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    directed = {tuple(edge) for edge in ends}
    if len(directed) != len(ends) or any((b, a) not in directed for a, b in directed):
        raise ValueError("the mesh is not closed, so a ray may get out of it")


def decades(*exponents: int) -> tuple[float, ...]:
    return tuple(float(f"1e{exponent}") for exponent in exponents)


def tangent_of(degrees: float) -> float:
    """Half the width of the image at distance 1."""
    return math.tan(math.radians(degrees / 2.0))


TENFOLD = decades(0, 1, 2, 3, 4, 5, 6, 7)
TINY = decades(-8, -7, -6, -5, -4, -3, -2, -1)
MESH_SCALES = decades(-20, -16, -14, -13, -12, -11, -9, -6, -3, 0, 3, 6, 9, 11, 12, 13, 14, 16, 18)
SPHERE_SCALES = decades(-30, -24, -20, -19, -17, -15, -12, -8, -4, 0, 4, 8, 12, 15, 17, 18, 19, 20, 24, 30)
LENGTHS = decades(-36, -30, -25, -20, -15, -10, -5, -3, 0, 3, 5, 10, 15, 18, 20, 25, 30, 36)
FOV_DEGREES = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 45.0, 90.0, 120.0, 150.0, 170.0, 179.0, 179.9, 179.99)
GAPS = (0.0, *TINY)
ANGLE = "angle between ray and surface, radians"

Make = Callable[[Rng, float], HardScene]


def swept(
    name: str, title: str, quantity: str, values: Sequence[float], easiest: float, make: Make, **more: Any
) -> Family:
    return Family(name, title, make, quantity, tuple(values), easiest, **more)


def watertight_family(at: str) -> Family:
    title = f"rays from inside a closed mesh of 5,120 faces, aimed at its {at}"
    values = (0.0, 1e1, 1e3, 1e4, 1.5e5, 1e6)  # of the centre from the origin; the radius is 1
    quantity = "offset from the origin over radius"
    return swept(f"watertight-{at}", title, quantity, values, 0.0, partial(watertight, at), closed=True)


SWEPT: tuple[Family, ...] = (
    swept(
        "scale-mesh",
        "the size of a whole scene of triangles",
        "radius, scene units",
        MESH_SCALES,
        1.0,
        partial(scaled, icosphere),
    ),
    swept(
        "scale-sphere",
        "the size of a whole scene of a sphere",
        "radius of the sphere, scene units",
        SPHERE_SCALES,
        1.0,
        partial(scaled, ball),
    ),
    swept(
        "offset-mesh",
        "how far from the origin a sphere of triangles is",
        "offset over radius",
        (*TENFOLD[:-1], 3e6, 1e7),
        1.0,
        partial(offset, icosphere),
    ),
    swept(
        "offset-sphere",
        "how far from the origin a sphere is",
        "offset over radius",
        TENFOLD,
        1.0,
        partial(offset, ball),
    ),
    swept(
        "distance-triangle",
        "how far rays come to a triangle",
        "distance over size",
        (*TENFOLD[1:], 1e8),
        10.0,
        distant_triangle,
    ),
    swept(
        "distance-sphere",
        "how far rays come to a sphere",
        "distance over radius",
        (*TENFOLD[1:], 1e8),
        10.0,
        distant_sphere,
    ),
    swept(
        "grazing-rectangle",
        "rays that run nearly along two triangles",
        ANGLE,
        (*TINY, 1.0),
        1.0,
        partial(grazing, "rectangle"),
    ),
    swept("grazing-disk", "rays that run nearly along a disk", ANGLE, (*TINY, 1.0), 1.0, partial(grazing, "disk")),
    swept("sliver", "how thin a triangle is", "height over base", (*TINY[1:], 1.0), 1.0, sliver),
    swept(
        "tangency",
        "how nearly rays touch a sphere's silhouette",
        "distance from the silhouette over radius",
        TINY,
        0.1,
        tangency,
    ),
    watertight_family("edges"),
    watertight_family("vertices"),
    swept("length-mesh", "how long d is, at triangles", "length of d", LENGTHS, 1.0, partial(of_length, icosphere)),
    swept("length-sphere", "how long d is, at a sphere", "length of d", LENGTHS, 1.0, partial(of_length, ball)),
    swept(
        "axis",
        "rays inside a cylinder, nearly along its axis",
        "angle between ray and axis, radians",
        (*TINY[1:], 1.0),
        1.0,
        along_cylinder,
    ),
    swept(
        "condition",
        "how much the transform of an ellipsoid stretches",
        "condition of to_world",
        (1.0, 3.0, *TENFOLD[1:-1]),
        1.0,
        stretched_sphere,
    ),
    swept(
        "field-of-view",
        "the field of view of a pinhole camera",
        "tan(fov / 2)",
        tuple(map(tangent_of, FOV_DEGREES)),
        tangent_of(90.0),
        field_of_view,
    ),
    swept(
        "film-size",
        "how many pixels wide the film is: the window at a silhouette narrows",
        "width of the film, pixels",
        tuple(4.0**k for k in range(2, 9)),
        16.0,
        film_size,
    ),
    swept(
        "coincident-triangles",
        "how close two triangles lie to each other",
        "gap over size",
        GAPS,
        0.1,
        coincident_triangles,
    ),
    swept(
        "coincident-spheres",
        "how close two concentric spheres lie to each other",
        "gap over radius",
        GAPS,
        0.1,
        coincident_spheres,
    ),
    swept(
        "shadow-sphere",
        "how far off a sphere the rays start that leave it",
        "offset of the start over radius",
        GAPS,
        0.1,
        partial(leaving, ball),
        unit=1.0,
    ),
    swept(
        "shadow-mesh",
        "how far off a sphere of triangles the rays start that leave it",
        "offset of the start over radius",
        GAPS,
        0.1,
        partial(leaving, icosphere),
        unit=1.0,
    ),
)
