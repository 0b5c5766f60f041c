"""A scene with one ray, or with the picture of its camera: what is shrunk, kept and tried again."""

import copy
import traceback
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from caster.scene import Scene
from caster.wording import SceneError
from mitsuba_ref.exact import OutsideDomain
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.example import scene_of
from mitsuba_ref.fuzz.finding import Finding, Tally
from mitsuba_ref.fuzz.picture_check import check_picture
from mitsuba_ref.fuzz.rays_check import check_rays, subject_of


class Case(NamedTuple):
    """Parts of a scene as a scene file has them."""

    film: dict[str, Any]
    camera: dict[str, Any]
    shapes: list[dict[str, Any]]
    ray: Shots | None = None  # one row; None: the rays of the camera

    def scene_data(self) -> dict[str, Any]:
        """The scene; with a ray of its own, that ray is its camera's, its t_min apart."""
        if self.ray is None:
            return {"film": self.film, "camera": self.camera, "shape": self.shapes}
        camera: dict[str, Any] = {
            "type": "ray",
            "origin": self.ray.o[0].tolist(),
            "direction": self.ray.d[0].tolist(),
        }
        if 0.0 < self.ray.t_max[0] < np.inf:
            camera["t_max"] = float(self.ray.t_max[0])
        return {"film": {"width": 1, "height": 1}, "camera": camera, "shape": self.shapes}

    def scene(self) -> Scene:
        return scene_of(self.scene_data())

    def to_data(self) -> dict[str, Any]:
        """Plain data, for the shrinker."""
        data = {"film": self.film, "camera": self.camera, "shape": self.shapes}
        if self.ray is not None:
            (o,), (d,), (t_min,), (t_max,) = (a.tolist() for a in self.ray)
            data["ray"] = {"o": o, "d": d, "t_min": t_min, "t_max": t_max}
        return copy.deepcopy(data)

    @classmethod
    def of(cls, data: dict[str, Any]) -> "Case":
        return cls(
            data["film"], data["camera"], data["shape"], one_ray(**data["ray"]) if "ray" in data else None
        )


def one_ray(o: list[float], d: list[float], t_min: float, t_max: float) -> Shots:
    return Shots(np.array([o]), np.array([d]), np.array([t_min]), np.array([t_max]))


NO_SCENE = (SceneError, ValidationError, OutsideDomain)  # what a scene that nobody can be asked about raises


def findings_of(case: Case) -> list[Finding]:
    """All that is wrong with it, apart from what only Mitsuba can tell; nothing, where it is no scene."""
    try:
        subject = subject_of(case.scene())
    except NO_SCENE:
        return []
    except Exception as error:
        return [raised(error)]
    try:
        if case.ray is not None:
            return check_rays(subject, case.ray, Tally())
        return check_picture(subject, Tally())
    except Exception as error:
        return [raised(error)]


def raised(error: Exception) -> Finding:
    """The finding that something raised an exception."""
    (place, *_) = traceback.extract_tb(error.__traceback__)[::-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Finding("error", f"{type(error).__name__} at {where}: {error}")
