"""Shapes written anew from what they pack to: meshes as triangles, transforms as one matrix."""

from typing import Any

import numpy as np

from caster.packing import count
from caster.shapes.plane import Planes
from mitsuba_ref.rebuilding import rebuilt

Described = dict[str, Any]


def as_packed(part: Any) -> list[Described]:
    """Shapes that pack to the same primitives in the same order, one each. Raises LookupError for an unknown kind."""
    with np.errstate(all="ignore"):
        return [plane(part, k) if type(part) is Planes else rebuilt(part, k) for k in range(count(part))]


def plane(part: Planes, k: int) -> Described:
    """`rebuilt` looks for a normal that rounds to a float32 one; these are float64."""
    return {"type": "plane", "normal": part.normal[k].tolist(), "point": part.point[k].tolist()}


def moved(shape: Described, by: np.ndarray) -> Described | None:
    """Such a shape moved; None for one that is not as `as_packed` writes it."""
    if "vertices" in shape and "to_world" not in shape:
        return {**shape, "vertices": (np.array(shape["vertices"]) + by).tolist()}
    for key in ("center", "point"):
        if key in shape and "to_world" not in shape:
            return {**shape, key: (np.array(shape[key]) + by).tolist()}
    steps = shape.get("to_world", [])
    if len(steps) == 1 and "matrix" in steps[0]:
        matrix = np.array(steps[0]["matrix"])
        matrix[:3, 3] += by
        return {**shape, "to_world": [{"matrix": matrix.tolist()}]}
    return None
