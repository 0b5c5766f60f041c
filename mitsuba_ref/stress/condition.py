"""Transform condition: a ball that is flattened more and more."""

import numpy as np

from caster.shapes import Sphere
from mitsuba_ref.stress.aiming import Rays, chosen, directions, part_of, scene_of, towards, turn, unit
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # of the largest half axis
CONDITIONS = (1.0, 3.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6)


def make(rng: Rng, condition: float, count: int) -> Setting:
    """Half axes 1, condition^-1/2 and 1/condition, turned; a second stretch keeps condition 1 an ellipsoid."""
    stretch = {"scale": [1.0, condition**-0.5, 1.0 / condition]}
    almost = {"scale": [1.0, 1.0, 0.999]}
    place = [stretch, almost, turn(rng), {"translate": rng.normal(scale=0.3, size=3)}]
    scene = scene_of(Sphere(to_world=place))
    part = part_of(scene)

    def candidates(many: int) -> Rays:
        aim = (
            part.center[0] + 1.4 * np.sqrt(rng.random((many, 1))) * directions(rng, many) @ part.to_world[0].T
        )
        return towards(part.center[0] + DISTANCE * directions(rng, many), aim)

    def hits(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
        return np.linalg.norm(np.cross(f, unit(e)), axis=1) < 1.0

    return Setting(condition, scene, *chosen(candidates, hits, count))


FAMILY = Family(
    "condition",
    "how much the transform of an ellipsoid stretches",
    "condition of to_world",
    CONDITIONS,
    CONDITIONS[0],
    make,
)
