"""Packed primitives back into descriptions that pack to the same float32 numbers, bit for bit."""

from collections.abc import Callable
from typing import Any

import numpy as np

from caster.packing import Packed, Triangles
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, Spheres

Described = dict[str, Any]


def rebuilt(part: Any, k: int) -> Described:
    """A description of primitive k of a shape's arrays. Raises LookupError for a kind that has none."""
    if type(part) not in WRITERS:
        raise LookupError(
            f"{type(part).__name__}: nothing is known to describe one by (mitsuba_ref/rebuilding.py)"
        )
    return WRITERS[type(part)](part, k)


def same_numbers(part: Any, k: int, packed: Packed) -> bool:
    """Whether a scene packs to primitive k of these arrays and nothing else; a sphere's turn, for uv, apart."""
    if len(packed.parts) != 1 or type(packed.parts[0]) is not type(part):
        return False
    there, here = numbers_of(packed.parts[0], 0), numbers_of(part, k)
    return all(np.array_equal(a, b) for a, b in zip(there, here, strict=True))


def numbers_of(part: Any, k: int) -> list[np.ndarray]:
    """What is cast and judged of one primitive."""
    if isinstance(part, Triangles):
        corners = part.faces[k]
        smooth, textured = part.smooth[k], part.textured[k]
        rest = [part.normals[corners]] if smooth else []
        return [part.vertices[corners], smooth, textured, *rest, *([part.uv[corners]] if textured else [])]
    return [a[k] for name, a in part._asdict().items() if name != "turn"]


def triangle(part: Triangles, k: int) -> Described:
    corners = part.faces[k]
    shape: Described = {"type": "triangle", "vertices": part.vertices[corners].tolist()}
    if part.smooth[k]:
        shape["normals"] = [of_unit_length(n).tolist() for n in part.normals[corners]]
    if part.textured[k]:
        shape["uv"] = part.uv[corners].tolist()
    return shape


def sphere(part: Spheres, k: int) -> Described:
    return {"type": "sphere", "center": part.center[k].tolist(), "radius": float(part.radius[k])}


def ellipsoid(part: Ellipsoids, k: int) -> Described:
    return {"type": "sphere", "to_world": placed(part, k)}


def cylinder(part: Cylinders, k: int) -> Described:
    return {"type": "cylinder", "to_world": placed(part, k)}


def disk(part: Disks, k: int) -> Described:
    return {"type": "disk", "to_world": placed(part, k)}


def plane(part: Planes, k: int) -> Described:
    return {
        "type": "plane",
        "normal": of_unit_length(part.normal[k]).tolist(),
        "point": part.point[k].tolist(),
    }


def placed(part: Any, k: int) -> list[Described]:
    """The to_world that brings the unit shape where the primitive is."""
    rows = np.column_stack([part.to_world[k], part.center[k]])
    return [{"matrix": [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]]}]


# Of half the distance to the next float32: what is so near to the middle may be rounded away from it in float64.
INSIDE = 1.0 - 2.0**-20


def of_unit_length(n: np.ndarray) -> np.ndarray:
    """A vector of unit length, to float64, whose components round to the float32 numbers n (3,).

    Descriptions bring normals to unit length, and rounding them to float32 gave n; so there is such a vector in the box
    of all that round to n. On the way from the box's corner that is nearest to 0 to the farthest, lengths grow, and
    somewhere they are 1.
    """
    if abs(float(n @ n) - 1.0) <= 2.0**-52:
        return n
    single = np.abs(n).astype(np.float32)
    half = [
        0.5 * (np.nextafter(single, np.float32(end)).astype(np.float64) - single) for end in (0.0, np.inf)
    ]
    low, high = (single + np.where(n == 0.0, 0.0, INSIDE * each) for each in half)
    across = high - low
    a, b, c = across @ across, low @ across, low @ low - 1.0
    s = -c / (b + np.sqrt(max(b * b - a * c, 0.0)))
    return np.copysign(low + min(max(s, 0.0), 1.0) * across, n)


WRITERS: dict[type, Callable[[Any, int], Described]] = {
    Triangles: triangle,
    Spheres: sphere,
    Ellipsoids: ellipsoid,
    Cylinders: cylinder,
    Disks: disk,
    Planes: plane,
}
