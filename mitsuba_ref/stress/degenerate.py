"""Families of nearly degenerate intersections: grazing, slivers, tangency, cylinder axes, stretched spheres."""

from typing import Any

import numpy as np

from caster.shapes import Cylinder, Disk, Rectangle, Sphere, Triangle
from mitsuba_ref.stress.family import (
    EYE_DISTANCE,
    Family,
    Rays,
    Rng,
    Setting,
    balanced_selection,
    float32,
    hits_triangles,
    impact_parameter,
    part_of,
    random_directions,
    random_perpendicular,
    random_turn,
    rays_to_triangle,
    scene_of,
    select_rays,
    sphere_scene,
    towards,
    unit,
    unit_normal,
)

GRAZING_ANGLES = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
AIM_HALF_SIDES = 1.3  # half sides around the centre that rays are aimed at: four in ten pass the rim


def grazing_rays(rng: Rng, angle: float, axes: np.ndarray, center: np.ndarray, number: int) -> Rays:
    """Rays to points of the plane through `center` that axes[0], axes[1] span, at an angle to it."""
    aim = center + rng.uniform(-AIM_HALF_SIDES, AIM_HALF_SIDES, (number, 2)) @ axes[:2]
    n = np.tile(axes[2] / np.linalg.norm(axes[2]), (number, 1))
    back = np.cos(angle) * random_perpendicular(rng, n) + rng.choice([-1.0, 1.0], (number, 1)) * np.sin(angle) * n
    return towards(aim + EYE_DISTANCE * back, aim)


def grazing_rectangle(rng: Rng, angle: float, count: int) -> Setting:
    scene = scene_of(Rectangle(to_world=random_pose(rng)))
    corners = part_of(scene).vertices
    center = corners.mean(axis=0)
    first, second = 0.5 * (corners[1] - corners[0]), 0.5 * (corners[3] - corners[0])
    axes = np.stack([first, second, np.cross(first, second)])
    hits = hits_triangles(corners[part_of(scene).faces])
    return Setting(
        angle, scene, *select_rays(lambda number: grazing_rays(rng, angle, axes, center, number), hits, count)
    )


def grazing_disk(rng: Rng, angle: float, count: int) -> Setting:
    scene = scene_of(Disk(to_world=random_pose(rng)))
    part = part_of(scene)

    def hits(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
        with np.errstate(all="ignore"):
            q = f - (f[:, 2:] / e[:, 2:]) * e
        return np.hypot(q[:, 0], q[:, 1]) <= 1.0

    axes = part.to_world[0].T
    return Setting(
        angle, scene, *select_rays(lambda number: grazing_rays(rng, angle, axes, part.center[0], number), hits, count)
    )


def random_pose(rng: Rng) -> list[dict[str, Any]]:
    return [random_turn(rng), {"translate": rng.normal(scale=0.3, size=3)}]


GRAZING_RECTANGLE = Family(
    "grazing-rectangle",
    "rays that run nearly along two triangles",
    "angle between ray and surface, radians",
    GRAZING_ANGLES,
    GRAZING_ANGLES[-1],
    grazing_rectangle,
)
GRAZING_DISK = Family(
    "grazing-disk",
    "rays that run nearly along a disk",
    "angle between ray and surface, radians",
    GRAZING_ANGLES,
    GRAZING_ANGLES[-1],
    grazing_disk,
)


ASPECTS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)


def sliver_triangle(rng: Rng, aspect: float, count: int) -> Setting:
    """aspect: height over a base of 1. Rotated, so that rounding moves its corners in all directions."""
    corners = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [rng.uniform(-0.2, 0.2), aspect, 0.0]])
    scene = scene_of(Triangle(vertices=corners, to_world=[random_turn(rng)]))
    part = part_of(scene)
    n = unit_normal(part.vertices)

    def candidates(number: int) -> Rays:
        return rays_to_triangle(rng, part.vertices, n, EYE_DISTANCE, number)

    hits = hits_triangles(part.vertices[part.faces])
    return Setting(aspect, scene, *select_rays(candidates, hits, count))


SLIVER = Family("sliver", "how thin a triangle is", "height over base", ASPECTS, ASPECTS[-1], sliver_triangle)


TANGENCY_GAPS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# gaps: rays that rounding moved further are dropped; half a decade to each side, where the next gap begins
GAP_TOLERANCE = (0.3, 3.0)
TANGENT_CANDIDATES_PER_RAY = 400  # at the narrowest gap one in fifty stays in it


def near_tangent(rng: Rng, gap: float, count: int) -> Setting:
    scene = sphere_scene(1.0, rng.normal(scale=0.3, size=3))
    part = part_of(scene)
    center, r = part.center[0], part.radius[0]
    o, d = near_tangent_rays(rng, gap, (center, r), TANGENT_CANDIDATES_PER_RAY * count)
    off = impact_parameter(center, o.astype(np.float64), d.astype(np.float64)) / r - 1.0
    kept = (np.abs(off) >= GAP_TOLERANCE[0] * gap) & (np.abs(off) <= GAP_TOLERANCE[1] * gap)
    return Setting(gap, scene, *balanced_selection((o[kept], d[kept]), off[kept] < 0.0, count))


def near_tangent_rays(rng: Rng, gap: float, sphere: tuple[np.ndarray, float], number: int) -> Rays:
    """Rays that pass the centre at r (1 - gap) or r (1 + gap)."""
    center, r = sphere
    v = random_directions(rng, number)
    beside = center + r * (1.0 + gap * rng.choice([-1.0, 1.0], (number, 1))) * random_perpendicular(rng, v)
    return towards(beside - EYE_DISTANCE * v, beside)


TANGENCY = Family(
    "tangency",
    "how nearly rays touch a sphere's silhouette",
    "distance from the silhouette over radius",
    TANGENCY_GAPS,
    TANGENCY_GAPS[-1],
    near_tangent,
)


AXIS_ANGLES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
LENGTH_TIMES_ANGLE = 4.0  # radii: a ray from the axis reaches the wall after a quarter of the cylinder


def along_cylinder(rng: Rng, angle: float, count: int) -> Setting:
    """Rays inside a cylinder: half start far enough from its end to hit the wall, half leave by the end."""
    axis = random_perpendicular(rng, np.array([[0.3, 0.5, 0.8]]))[0] * (LENGTH_TIMES_ANGLE / angle)
    scene = scene_of(Cylinder(p0=tuple(-0.5 * axis), p1=tuple(0.5 * axis), radius=1.0))
    part = part_of(scene)

    def candidates(number: int) -> Rays:
        turned = rng.uniform(0.0, 2.0 * np.pi, number)
        height = np.where(rng.random(number) < 0.6, rng.uniform(0.05, 0.5, number), rng.uniform(0.7, 0.95, number))
        start = np.column_stack([*rng.uniform(-0.3, 0.3, (2, number)), height])
        lean = np.column_stack([np.cos(turned), np.sin(turned), np.full(number, 1.0 / LENGTH_TIMES_ANGLE)])
        matrix = part.to_world[0].T
        return float32(part.center[0] + start @ matrix), float32(unit(lean @ matrix))

    return Setting(angle, scene, *select_rays(candidates, lambda o, d: reaches_wall(part, o, d), count))


def reaches_wall(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether rays from inside the cylinder hit its wall before its end."""
    f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
    a, b = (e[:, :2] ** 2).sum(axis=1), (f[:, :2] * e[:, :2]).sum(axis=1)
    c = (f[:, :2] ** 2).sum(axis=1) - 1.0
    with np.errstate(all="ignore"):
        z = f[:, 2] + (np.sqrt(b * b - a * c) - b) / a * e[:, 2]
    found: np.ndarray = (z >= 0.0) & (z <= 1.0)
    return found


AXIS = Family(
    "axis",
    "rays inside a cylinder, nearly along its axis",
    "angle between ray and axis, radians",
    AXIS_ANGLES,
    AXIS_ANGLES[-1],
    along_cylinder,
)


CONDITIONS = (1.0, 3.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6)


def stretched_sphere(rng: Rng, condition: float, count: int) -> Setting:
    """Half axes 1, condition^-1/2 and 1/condition, rotated; a second stretch keeps condition 1 an ellipsoid."""
    stretch = {"scale": [1.0, condition**-0.5, 1.0 / condition]}
    almost = {"scale": [1.0, 1.0, 0.999]}
    place = [stretch, almost, random_turn(rng), {"translate": rng.normal(scale=0.3, size=3)}]
    scene = scene_of(Sphere(to_world=place))
    part = part_of(scene)

    def candidates(number: int) -> Rays:
        aim = (
            part.center[0]
            + 1.4 * np.sqrt(rng.random((number, 1))) * random_directions(rng, number) @ part.to_world[0].T
        )
        return towards(part.center[0] + EYE_DISTANCE * random_directions(rng, number), aim)

    def hits(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
        return np.linalg.norm(np.cross(f, unit(e)), axis=1) < 1.0

    return Setting(condition, scene, *select_rays(candidates, hits, count))


CONDITION = Family(
    "condition",
    "how much the transform of an ellipsoid stretches",
    "condition of to_world",
    CONDITIONS,
    CONDITIONS[0],
    stretched_sphere,
)
