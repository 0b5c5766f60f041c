"""A few mesh files to draw from: shared edges and corners, slivers, faces without an area."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from caster.cameras import CAMERAS
from caster.description.errors import SceneError
from mitsuba_ref.fuzz.settings import Setting, log_uniform, random_to_world
from mitsuba_ref.shapes import REFERENCES
from mitsuba_ref.shapes.targets import Rng, random_directions

# Random shapes: of every kind in the registry, each with a function that draws what is its own.


Fields = dict[str, Any]


def shape_types(group: str = "") -> tuple[str, ...]:
    """The registered shapes' types, of all or of one group."""
    return tuple(each.type_name for each in REFERENCES.values() if not group or group in each.groups)


def bounded_types() -> tuple[str, ...]:
    """The types of shapes that end somewhere."""
    return tuple(each.type_name for each in REFERENCES.values() if "unbounded" not in each.groups)


def random_shape(rng: Rng, kind: str, setting: Setting) -> Fields:
    """A shape of this type as a scene file describes it, placed at random."""
    (reference,) = (each for each in REFERENCES.values() if each.type_name == kind)
    steps = random_to_world(rng, setting)
    fields = reference.random_fields(rng, setting.lattice)
    return {"type": kind, **fields} | ({"to_world": steps} if steps else {})


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
