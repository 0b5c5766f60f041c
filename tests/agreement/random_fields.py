"""Random values for what describes a shape or a camera.

Which values a field may take is read from two tables. A shape or camera that brings a new field needs one
line in one of them; whoever forgets that is told so.
"""

import atexit
import functools
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np

from caster.description.fields import Camera, Shape
from caster.shapes.icosphere import tessellate_icosphere

Rng = np.random.Generator
Draw = Callable[[Rng, float], Any]  # the random numbers, and the size of the scene in scene units

PLACED_BY_SCENE = {"type", "name", "material", "to_world", "eye", "look_at", "direction", "up"}


def point(rng: Rng, size: float) -> np.ndarray:
    return size * rng.uniform(-1.0, 1.0, 3)


def direction(rng: Rng, size: float = 1.0) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def length(rng: Rng, size: float) -> float:
    return float(size * 10.0 ** rng.uniform(-1.5, 0.0))


def sometimes(draw: Draw) -> Draw:
    """A field that may also be left out."""
    return lambda rng, size: draw(rng, size) if rng.random() < 0.5 else None


def whole(low: int, high: int) -> Draw:
    return lambda rng, size: int(rng.integers(low, high + 1))


def three(draw: Draw) -> Draw:
    return lambda rng, size: [draw(rng, size) for _ in range(3)]


def between(low: float, high: float) -> Draw:
    return lambda rng, size: float(rng.uniform(low, high))


@functools.cache
def mesh_file() -> str:
    """A dented ball with irrational coordinates, as an OBJ file that goes away with this process."""
    folder = tempfile.mkdtemp(prefix="caster-agreement-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    mesh = tessellate_icosphere(1)
    dented = mesh.vertices * np.random.default_rng(5).uniform(0.6, 1.0, (len(mesh.vertices), 1))
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in dented.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (mesh.faces + 1).tolist()]
    path = Path(folder, "dented.obj")
    path.write_text("\n".join(lines) + "\n")
    return str(path)


# By field, or by type.field where a type wants something else under a common name.
FIELDS: dict[str, Draw] = {
    "center": point,
    "radius": length,
    "p0": point,
    "p1": point,
    "vertices": three(point),
    "normals": sometimes(three(direction)),
    "uv": sometimes(lambda rng, size: rng.random((3, 2))),
    "face_normals": lambda rng, size: bool(rng.random() < 0.5),
    "file": lambda rng, size: mesh_file(),
    "normal": direction,
    "subdivisions": whole(0, 2),
    "teapot.subdivisions": whole(1, 2),
    "major_radius": between(0.6, 1.0),
    "minor_radius": between(0.1, 0.5),
    "segments": whole(3, 12),
    "sides": whole(3, 8),
    "size": between(0.5, 2.0),
    "resolution": whole(1, 9),
    "amplitude": between(0.0, 0.5),
    "waves": whole(1, 5),
    "seed": whole(0, 99),
    "fov": between(20.0, 130.0),
    "fisheye.fov": between(90.0, 360.0),
    "principal_point": lambda rng, size: rng.uniform(-0.2, 0.2, 2),
    "near": lambda rng, size: size * rng.uniform(0.0, 1.5),
    "far": sometimes(lambda rng, size: size * rng.uniform(3.0, 9.0)),
    "width": lambda rng, size: size * rng.uniform(1.0, 6.0),
}

# Fields that exclude or bound each other, by type: which, and how to draw them together.
GROUPS: dict[str, tuple[set[str], Draw]] = {
    "plane": (
        {"point", "offset"},
        lambda rng, size: {"point": point(rng, size)} if rng.random() < 0.5 else {"offset": rng.normal() * size},
    ),
    "spheres": ({"file", "centers", "radii", "radius"}, lambda rng, size: some_spheres(rng, size)),
}


def some_spheres(rng: Rng, size: float) -> dict[str, Any]:
    """One to seven spheres, with a radius each, one for all, or the default."""
    count = int(rng.integers(1, 8))
    centers = {"centers": [point(rng, size) for _ in range(count)]}
    match int(rng.integers(3)):
        case 0:
            return centers | {"radii": [0.4 * length(rng, size) for _ in range(count)]}
        case 1:
            return centers | {"radius": 0.4 * length(rng, size)}
    return centers


def own_fields(cls: type[Shape] | type[Camera], rng: Rng, size: float) -> dict[str, Any]:
    """Random values of what belongs to this very kind of shape or camera."""
    kind = cls.model_fields["type"].default
    grouped, together = GROUPS.get(kind, (set(), lambda rng, size: {}))
    values = together(rng, size)
    for name, field in cls.model_fields.items():
        if name not in PLACED_BY_SCENE | grouped:
            values[name] = draw_of(kind, name, field.annotation)(rng, size)
    return values


def draw_of(kind: str, name: str, annotation: Any) -> Draw:
    """How to draw a field; choices are read from its type."""
    if get_origin(annotation) is Literal:
        return lambda rng, size: str(rng.choice(get_args(annotation)))
    for key in (f"{kind}.{name}", name):
        if key in FIELDS:
            return FIELDS[key]
    raise AssertionError(
        f"{kind}: no random values for its field {name!r}: add a line {name!r}: (a function of a random "
        "generator and the scene's size that gives a value) to FIELDS in tests/agreement/random_fields.py, "
        "or to GROUPS if other fields say which values it may take"
    )
