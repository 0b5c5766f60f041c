"""Random cameras of every kind in the registry."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from caster.cameras import CAMERAS
from caster.wording import SceneError
from mitsuba_ref.fuzz.setting import Rng, Setting, decades, directions

Fields = dict[str, Any]
TYPES: tuple[str, ...] = tuple(cls.model_fields["type"].default for cls in CAMERAS)

FILMS = ((5, 5), (6, 4), (4, 4), (7, 3))  # pixels; odd sides have a pixel in the middle of the view


def pinhole(rng: Rng, setting: Setting) -> Fields:
    planes = {"near": float(setting.size * rng.uniform(0.0, 1.5))} if rng.random() < 0.3 else {}
    if rng.random() < 0.2:
        planes["far"] = float(setting.size * rng.uniform(2.0, 9.0))
    fov = float(rng.choice([90.0, rng.uniform(5.0, 150.0)]))
    return {**view(rng, setting), "fov": fov, **planes}


def orthographic(rng: Rng, setting: Setting) -> Fields:
    """On the lattice a pixel is an eighth to a half of a shape wide, so that many rays meet edges exactly."""
    width = setting.size * float(2.0 ** rng.integers(-1, 3))
    near = {"near": float(setting.size * rng.uniform(0.0, 1.5))} if rng.random() < 0.2 else {}
    return {**view(rng, setting), "width": width, **near}


def fisheye(rng: Rng, setting: Setting) -> Fields:
    return {**view(rng, setting), "fov": float(rng.uniform(60.0, 360.0))}


def view(rng: Rng, setting: Setting) -> Fields:
    """Looks at the middle, from within it up to far away; on the lattice along an axis."""
    if setting.lattice:
        away = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        shift = rng.integers(-8, 9, 3) / 8.0
        eye = np.array(setting.middle) + setting.size * (int(rng.integers(0, 9)) * away + shift)
        return {"eye": eye.tolist(), "direction": (-away).tolist(), "up": across(away)}
    away = directions(rng, 1)[0]
    distance = setting.size * decades(rng, 0.1, 1e4 if rng.random() < 0.2 else 10.0)
    eye = np.array(setting.middle) + distance * away
    return {"eye": eye.tolist(), "direction": (-away).tolist(), "up": across(away)}


def across(away: np.ndarray) -> list[float]:
    """An axis that is not along the view."""
    return np.eye(3)[np.argmin(np.abs(away))].tolist()


def one_ray(rng: Rng, setting: Setting) -> Fields:
    seen = view(rng, setting)
    return {"origin": seen["eye"], "direction": seen["direction"]}


DRAW: dict[str, Callable[[Rng, Setting], Fields]] = {
    "pinhole": pinhole,
    "orthographic": orthographic,
    "fisheye": fisheye,
    "panorama": view,
    "parabolic": view,
    "ray": one_ray,
}


def drawn(
    rng: Rng,
    setting: Setting,
    kinds: Sequence[str] = TYPES,
    films: Sequence[tuple[int, int]] = FILMS,
) -> tuple[Fields, Fields]:
    """(film, camera) as a scene file describes them; the camera of one of these types."""
    kind = str(rng.choice(kinds))
    if kind not in DRAW:
        raise SceneError(
            f"fuzz: no random cameras of type {kind}: add a line {kind!r}: (a function of a random generator "
            "and a Setting that gives its fields) to DRAW in mitsuba_ref/fuzz/cameras.py"
        )
    width, height = films[int(rng.integers(len(films)))]
    return {"width": width, "height": height}, {"type": kind, **DRAW[kind](rng, setting)}
