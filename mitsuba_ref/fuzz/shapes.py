"""Random shapes: of every kind in the registry, each with a function that draws what is its own."""

from collections.abc import Callable
from typing import Any

import numpy as np

from caster.shapes import SHAPES
from caster.wording import SceneError
from mitsuba_ref.fuzz.meshes import mesh_files
from mitsuba_ref.fuzz.placement import placed
from mitsuba_ref.fuzz.setting import GRID, Rng, Setting, directions

Fields = dict[str, Any]
TYPES: tuple[str, ...] = tuple(cls.model_fields["type"].default for cls in SHAPES)


def point(rng: Rng, setting: Setting) -> list[float]:
    """Within the cube [-1, 1]^3, in units of the shape."""
    if setting.lattice:
        return [float(x) for x in rng.integers(-GRID, GRID + 1, 3) / GRID]
    return [float(x) for x in rng.uniform(-1.0, 1.0, 3)]


def length(rng: Rng, setting: Setting) -> float:
    if setting.lattice:
        return float(rng.integers(1, GRID + 1)) / GRID
    return float(10.0 ** rng.uniform(-1.5, 0.0))


def flat(rng: Rng) -> bool:
    return bool(rng.random() < 0.5)


def sphere(rng: Rng, setting: Setting) -> Fields:
    return {"center": point(rng, setting), "radius": length(rng, setting)} if flat(rng) else {}


def plane(rng: Rng, setting: Setting) -> Fields:
    normal = directions(rng, 1)[0].tolist()
    if flat(rng):
        return {"normal": normal, "point": point(rng, setting)}
    return {"normal": normal, "offset": point(rng, setting)[0]}


def triangle(rng: Rng, setting: Setting) -> Fields:
    return {"vertices": [point(rng, setting) for _ in range(3)]}


def mesh(rng: Rng, setting: Setting) -> Fields:
    return {"file": str(rng.choice(mesh_files())), "face_normals": flat(rng)}


def nothing(rng: Rng, setting: Setting) -> Fields:
    return {}


def cylinder(rng: Rng, setting: Setting) -> Fields:
    if flat(rng):
        return {}
    p0, p1 = point(rng, setting), point(rng, setting)
    if p0 == p1:
        p1[2] += 1.0
    return {"p0": p0, "p1": p1, "radius": length(rng, setting)}


def icosphere(rng: Rng, setting: Setting) -> Fields:
    return {"subdivisions": int(rng.integers(0, 2)), "face_normals": flat(rng)}


def torus(rng: Rng, setting: Setting) -> Fields:
    counts = {"segments": int(rng.integers(3, 7)), "sides": int(rng.integers(3, 6))}
    return {"major_radius": 0.75, "minor_radius": 0.25, "face_normals": flat(rng), **counts}


def heightfield(rng: Rng, setting: Setting) -> Fields:
    amplitude = float(rng.choice([0.0, 0.25]))
    counts = {"resolution": int(rng.integers(1, 5)), "waves": 2, "seed": int(rng.integers(100))}
    return {"amplitude": amplitude, "face_normals": flat(rng), **counts}


def teapot(rng: Rng, setting: Setting) -> Fields:
    return {"subdivisions": 1, "face_normals": flat(rng)}


OWN: dict[str, Callable[[Rng, Setting], Fields]] = {
    "sphere": sphere,
    "plane": plane,
    "triangle": triangle,
    "mesh": mesh,
    "rectangle": nothing,
    "disk": nothing,
    "cube": nothing,
    "cylinder": cylinder,
    "icosphere": icosphere,
    "torus": torus,
    "heightfield": heightfield,
    "teapot": teapot,
}

QUADRICS = ("sphere", "cylinder", "disk")
FLAT = ("triangle", "rectangle", "disk", "plane", "cube")
MESHES = ("mesh", "cube", "icosphere", "torus", "heightfield", "teapot")


def drawn(rng: Rng, kind: str, setting: Setting) -> Fields:
    """A shape of this type as a scene file describes it, placed at random."""
    if kind not in OWN:
        raise SceneError(
            f"fuzz: no random shapes of type {kind}: add a line {kind!r}: (a function of a random generator "
            "and a Setting that gives the shape's own fields, about unit size) to OWN in mitsuba_ref/fuzz/shapes.py"
        )
    steps = placed(rng, setting)
    return {"type": kind, **OWN[kind](rng, setting)} | ({"to_world": steps} if steps else {})


def triangle_of(corners: np.ndarray) -> Fields:
    """A triangle with these very corners (3, 3), in scene units."""
    return {"type": "triangle", "vertices": np.asarray(corners, np.float64).tolist()}
