"""A few mesh files to draw from: shared edges and corners, slivers, faces without an area."""

import atexit
import functools
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.cameras import CAMERAS
from caster.description.errors import SceneError
from caster.geometry.procedural import icosphere
from caster.shapes import SHAPES
from mitsuba_ref.fuzz.settings import (
    LATTICE_STEPS,
    Rng,
    Setting,
    log_uniform,
    random_directions,
    random_to_world,
)

MeshArrays = tuple[np.ndarray, np.ndarray]  # vertices (n, 3), faces (m, 3)


def octahedron() -> MeshArrays:
    """Eight faces, all numbers whole."""
    vertices = np.vstack([np.eye(3), -np.eye(3)])
    signs = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]
    faces = [f if sum(v >= 3 for v in f) % 2 == 0 else (f[0], f[2], f[1]) for f in signs]
    return vertices, np.array(faces)


def dented_icosphere() -> MeshArrays:
    ball = icosphere(0)
    shares = np.random.default_rng(5).uniform(0.6, 1.0, (len(ball.vertices), 1))
    return ball.vertices * shares, ball.faces


def fan_of_slivers() -> MeshArrays:
    """Twelve needles around one corner, the thinnest 1e-9 wide."""
    angles = np.concatenate([[0.0], np.cumsum(10.0 ** np.linspace(-9.0, 0.0, 12))])
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    faces = [(0, i, i + 1) for i in range(1, len(angles))]
    return np.vstack([np.zeros((1, 3)), rim]), np.array(faces)


def pinched_sheet() -> MeshArrays:
    """A 3 x 3 sheet of lattice squares, with faces that are a line or a point among its triangles."""
    y, x = np.divmod(np.arange(9), 3)
    vertices = np.column_stack([x - 1.0, y - 1.0, np.zeros(9)])
    squares = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (3, 4, 7), (3, 7, 6), (4, 5, 8), (4, 8, 7)]
    return vertices, np.array([*squares, (0, 4, 8), (4, 4, 5), (7, 7, 7), (0, 1, 2)])


def doubled_square() -> MeshArrays:
    """The same square three times: as given, turned over, and with its corners written down anew."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = [(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0), (4, 5, 6), (4, 6, 7)]
    return np.vstack([vertices, vertices]), np.array(faces)


MESH_BUILDERS = (octahedron, dented_icosphere, fan_of_slivers, pinched_sheet, doubled_square)


@functools.cache
def mesh_files() -> tuple[str, ...]:
    """These meshes as OBJ files, in a folder that goes away with this process."""
    folder = Path(tempfile.mkdtemp(prefix="mitsuba-ref-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return tuple(_write_obj(folder / f"{make.__name__}.obj", *make()) for make in MESH_BUILDERS)


def _write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


# Random shapes: of every kind in the registry, each with a function that draws what is its own.


Fields = dict[str, Any]
SHAPE_TYPES: tuple[str, ...] = tuple(cls.model_fields["type"].default for cls in SHAPES)


def random_point(rng: Rng, setting: Setting) -> list[float]:
    """Within the cube [-1, 1]^3, in units of the shape."""
    if setting.lattice:
        return [float(x) for x in rng.integers(-LATTICE_STEPS, LATTICE_STEPS + 1, 3) / LATTICE_STEPS]
    return [float(x) for x in rng.uniform(-1.0, 1.0, 3)]


def random_length(rng: Rng, setting: Setting) -> float:
    if setting.lattice:
        return float(rng.integers(1, LATTICE_STEPS + 1)) / LATTICE_STEPS
    return float(10.0 ** rng.uniform(-1.5, 0.0))


def coin_flip(rng: Rng) -> bool:
    return bool(rng.random() < 0.5)


def sphere(rng: Rng, setting: Setting) -> Fields:
    return (
        {"center": random_point(rng, setting), "radius": random_length(rng, setting)}
        if coin_flip(rng)
        else {}
    )


def plane(rng: Rng, setting: Setting) -> Fields:
    normal = random_directions(rng, 1)[0].tolist()
    if coin_flip(rng):
        return {"normal": normal, "point": random_point(rng, setting)}
    return {"normal": normal, "offset": random_point(rng, setting)[0]}


def triangle(rng: Rng, setting: Setting) -> Fields:
    return {"vertices": [random_point(rng, setting) for _ in range(3)]}


def mesh(rng: Rng, setting: Setting) -> Fields:
    return {"file": str(rng.choice(mesh_files())), "face_normals": coin_flip(rng)}


def no_fields(rng: Rng, setting: Setting) -> Fields:
    return {}


def cylinder(rng: Rng, setting: Setting) -> Fields:
    if coin_flip(rng):
        return {}
    p0, p1 = random_point(rng, setting), random_point(rng, setting)
    if p0 == p1:
        p1[2] += 1.0
    return {"p0": p0, "p1": p1, "radius": random_length(rng, setting)}


def random_icosphere(rng: Rng, setting: Setting) -> Fields:
    return {"subdivisions": int(rng.integers(0, 2)), "face_normals": coin_flip(rng)}


def torus(rng: Rng, setting: Setting) -> Fields:
    counts = {"segments": int(rng.integers(3, 7)), "sides": int(rng.integers(3, 6))}
    return {"major_radius": 0.75, "minor_radius": 0.25, "face_normals": coin_flip(rng), **counts}


def heightfield(rng: Rng, setting: Setting) -> Fields:
    amplitude = float(rng.choice([0.0, 0.25]))
    counts = {"resolution": int(rng.integers(1, 5)), "waves": 2, "seed": int(rng.integers(100))}
    return {"amplitude": amplitude, "face_normals": coin_flip(rng), **counts}


def teapot(rng: Rng, setting: Setting) -> Fields:
    return {"subdivisions": 1, "face_normals": coin_flip(rng)}


RANDOM_SHAPE_FIELDS: dict[str, Callable[[Rng, Setting], Fields]] = {
    "sphere": sphere,
    "plane": plane,
    "triangle": triangle,
    "mesh": mesh,
    "rectangle": no_fields,
    "disk": no_fields,
    "cube": no_fields,
    "cylinder": cylinder,
    "icosphere": random_icosphere,
    "torus": torus,
    "heightfield": heightfield,
    "teapot": teapot,
}

QUADRIC_TYPES = ("sphere", "cylinder", "disk")
FLAT_TYPES = ("triangle", "rectangle", "disk", "plane", "cube")
MESH_TYPES = ("mesh", "cube", "icosphere", "torus", "heightfield", "teapot")


def random_shape(rng: Rng, kind: str, setting: Setting) -> Fields:
    """A shape of this type as a scene file describes it, placed at random."""
    if kind not in RANDOM_SHAPE_FIELDS:
        raise SceneError(
            f"fuzz: no random shapes of type {kind}: add a line {kind!r}: (a function of a random generator "
            "and a Setting that gives the shape's own fields, about unit size) to OWN in mitsuba_ref/fuzz/kinds.py"
        )
    steps = random_to_world(rng, setting)
    return {"type": kind, **RANDOM_SHAPE_FIELDS[kind](rng, setting)} | ({"to_world": steps} if steps else {})


def triangle_of(corners: np.ndarray) -> Fields:
    """A triangle with these very corners (3, 3), in scene units."""
    return {"type": "triangle", "vertices": np.asarray(corners, np.float64).tolist()}


# Random cameras of every kind in the registry.


CameraFields = dict[str, Any]
CAMERA_TYPES: tuple[str, ...] = tuple(camera.model_fields["type"].default for camera in CAMERAS)

FILM_SIZES = ((5, 5), (6, 4), (4, 4), (7, 3))  # pixels; odd sides have a pixel in the middle of the view


def pinhole(rng: Rng, setting: Setting) -> CameraFields:
    planes = {"near": float(setting.size * rng.uniform(0.0, 1.5))} if rng.random() < 0.3 else {}
    if rng.random() < 0.2:
        planes["far"] = float(setting.size * rng.uniform(2.0, 9.0))
    fov = float(rng.choice([90.0, rng.uniform(5.0, 150.0)]))
    return {**random_view(rng, setting), "fov": fov, **planes}


def orthographic(rng: Rng, setting: Setting) -> CameraFields:
    """On the lattice a pixel is an eighth to a half of a shape wide, so that many rays meet edges exactly."""
    width = setting.size * float(2.0 ** rng.integers(-1, 3))
    near = {"near": float(setting.size * rng.uniform(0.0, 1.5))} if rng.random() < 0.2 else {}
    return {**random_view(rng, setting), "width": width, **near}


def fisheye(rng: Rng, setting: Setting) -> CameraFields:
    return {**random_view(rng, setting), "fov": float(rng.uniform(60.0, 360.0))}


def random_view(rng: Rng, setting: Setting) -> CameraFields:
    """Looks at the middle, from within it up to far away; on the lattice along an axis."""
    if setting.lattice:
        away = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        shift = rng.integers(-8, 9, 3) / 8.0
        eye = np.array(setting.middle) + setting.size * (int(rng.integers(0, 9)) * away + shift)
        return {"eye": eye.tolist(), "direction": (-away).tolist(), "up": up_axis(away)}
    away = random_directions(rng, 1)[0]
    distance = setting.size * log_uniform(rng, 0.1, 1e4 if rng.random() < 0.2 else 10.0)
    eye = np.array(setting.middle) + distance * away
    return {"eye": eye.tolist(), "direction": (-away).tolist(), "up": up_axis(away)}


def up_axis(away: np.ndarray) -> list[float]:
    """An axis that is not along the view."""
    return np.eye(3)[np.argmin(np.abs(away))].tolist()


def random_ray_camera(rng: Rng, setting: Setting) -> CameraFields:
    seen = random_view(rng, setting)
    return {"origin": seen["eye"], "direction": seen["direction"]}


RANDOM_CAMERA_FIELDS: dict[str, Callable[[Rng, Setting], CameraFields]] = {
    "pinhole": pinhole,
    "orthographic": orthographic,
    "fisheye": fisheye,
    "panorama": random_view,
    "parabolic": random_view,
    "ray": random_ray_camera,
}


def random_camera(
    rng: Rng,
    setting: Setting,
    kinds: Sequence[str] = CAMERA_TYPES,
    films: Sequence[tuple[int, int]] = FILM_SIZES,
) -> tuple[CameraFields, CameraFields]:
    """(film, camera) as a scene file describes them; the camera of one of these types."""
    kind = str(rng.choice(kinds))
    if kind not in RANDOM_CAMERA_FIELDS:
        raise SceneError(
            f"fuzz: no random cameras of type {kind}: add a line {kind!r}: (a function of a random generator "
            "and a Setting that gives its fields) to DRAW in mitsuba_ref/fuzz/kinds.py"
        )
    width, height = films[int(rng.integers(len(films)))]
    return {"width": width, "height": height}, {"type": kind, **RANDOM_CAMERA_FIELDS[kind](rng, setting)}
