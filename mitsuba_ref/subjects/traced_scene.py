"""Packed primitives back into descriptions that pack to the same float32 numbers, bit for bit."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from caster.geometry.packing import Packed, Triangles
from caster.image.atomic_files import check_folder, write_bytes
from caster.scene.model import Scene
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, Spheres
from mitsuba_ref.reference.xml_writer import ply_bytes, safe_name

PrimitiveDescription = dict[str, Any]


def describe_primitive(part: Any, k: int) -> PrimitiveDescription:
    """A description of primitive k of a shape's arrays. Raises LookupError for a kind that has none."""
    if type(part) not in DESCRIBERS:
        raise LookupError(
            f"{type(part).__name__}: nothing is known to describe one by (mitsuba_ref/subjects/traced_scene.py)"
        )
    return DESCRIBERS[type(part)](part, k)


def packs_identically(part: Any, k: int, packed: Packed) -> bool:
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


def describe_triangle(part: Triangles, k: int) -> PrimitiveDescription:
    corners = part.faces[k]
    shape: PrimitiveDescription = {"type": "triangle", "vertices": part.vertices[corners].tolist()}
    if part.smooth[k]:
        shape["normals"] = [unit_vector_rounding_to(n).tolist() for n in part.normals[corners]]
    if part.textured[k]:
        shape["uv"] = part.uv[corners].tolist()
    return shape


def describe_sphere(part: Spheres, k: int) -> PrimitiveDescription:
    return {"type": "sphere", "center": part.center[k].tolist(), "radius": float(part.radius[k])}


def describe_ellipsoid(part: Ellipsoids, k: int) -> PrimitiveDescription:
    return {"type": "sphere", "to_world": unit_shape_matrix(part, k)}


def describe_cylinder(part: Cylinders, k: int) -> PrimitiveDescription:
    return {"type": "cylinder", "to_world": unit_shape_matrix(part, k)}


def describe_disk(part: Disks, k: int) -> PrimitiveDescription:
    return {"type": "disk", "to_world": unit_shape_matrix(part, k)}


def describe_plane(part: Planes, k: int) -> PrimitiveDescription:
    return {
        "type": "plane",
        "normal": unit_vector_rounding_to(part.normal[k]).tolist(),
        "point": part.point[k].tolist(),
    }


def unit_shape_matrix(part: Any, k: int) -> list[PrimitiveDescription]:
    """The to_world that brings the unit shape where the primitive is."""
    rows = np.column_stack([part.to_world[k], part.center[k]])
    return [{"matrix": [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]]}]


# Of half the distance to the next float32: what is so near to the middle may be rounded away from it in float64.
ROUNDING_INTERVAL_FRACTION = 1.0 - 2.0**-20


def unit_vector_rounding_to(n: np.ndarray) -> np.ndarray:
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
    low, high = (single + np.where(n == 0.0, 0.0, ROUNDING_INTERVAL_FRACTION * each) for each in half)
    across = high - low
    a, b, c = across @ across, low @ across, low @ low - 1.0
    s = -c / (b + np.sqrt(max(b * b - a * c, 0.0)))
    return np.copysign(low + min(max(s, 0.0), 1.0) * across, n)


DESCRIBERS: dict[type, Callable[[Any, int], PrimitiveDescription]] = {
    Triangles: describe_triangle,
    Spheres: describe_sphere,
    Ellipsoids: describe_ellipsoid,
    Cylinders: describe_cylinder,
    Disks: describe_disk,
    Planes: describe_plane,
}


# The scene in the very numbers that both sides trace: float32 values, meshes in world space.


def scene_as_traced(scene: Scene, packed: Packed, folder: Path) -> Scene:
    """Film, camera, lights and materials as they were; shapes packed to float32, described anew.

    Everything made of triangles is a `mesh` without a to_world, its PLY file in `folder`/meshes; a ball is a `sphere`
    by centre and radius; stretched balls, tubes and disks are their unit shape under one matrix; planes have a normal
    and a point. packed: by as_float32.
    """
    check_folder(folder / "meshes")
    shapes = [_described(scene, packed, i, folder) for i in range(len(scene.shapes))]
    fields = {name: getattr(scene, name) for name in ("film", "camera", "lights", "materials", "shading")}
    return Scene(**fields, shapes=shapes)


def _described(scene: Scene, packed: Packed, i: int, folder: Path) -> dict[str, Any]:
    part, shape = packed.parts[i], scene.shapes[i]
    if isinstance(part, Triangles):
        path = folder / "meshes" / f"{i:04d}-{safe_name(scene.shape_names()[i])}.ply"
        write_bytes(path, ply_bytes(part))
        found: dict[str, Any] = {"type": "mesh", "file": str(path)}
        if not part.smooth.any():
            found["face_normals"] = True
    elif isinstance(part, Planes):  # any length of the normal is the same plane, so the very numbers will do
        found = {"type": "plane", "normal": part.normal[0].tolist(), "point": part.point[0].tolist()}
    else:
        found = describe_primitive(part, 0)
    return {**found, "name": scene.shape_names()[i], "material": shape.material}
