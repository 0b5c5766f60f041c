"""Clouds of ellipsoids: Mitsuba's `ellipsoids`, which rays meet from outside only."""

from collections.abc import Iterator
from functools import partial
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from caster.shapes.sphere import EllipsoidCloud, OuterEllipsoids
from mitsuba_ref.error_model.defect_conditions import STRETCHED
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers
from mitsuba_ref.error_model.intersections import ErrorModel, Intersections, UvSpace, by_matrix
from mitsuba_ref.oracle.exact_quadrics import OUTER_ELLIPSOIDS as EXACT
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement, float_columns
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference
from mitsuba_ref.shapes.sphere import DEFECTS, unit_sphere_points, view_ellipsoid
from mitsuba_ref.shapes.surface_errors import intersect_round, ours_through_object_space, sphere_uv_points
from mitsuba_ref.shapes.targets import Rng, on_unit_shape, random_length, random_point

# Properties of Mitsuba's file; it reads those between nz and scale_0 as an attribute `exact` of the shape.
PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *(f"exact_{i}" for i in range(7)),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


def to_xml(out: ShapeWriter, shape: EllipsoidCloud, part: OuterEllipsoids) -> list[XmlElement]:
    """A PLY file of centres, logarithms of the semi-axes, and quaternions.

    Mitsuba takes the exponential of the logarithms in float32, which rounds. When rays are traced, the numbers `exact`
    replace the result (mitsuba_calls.py).
    """
    turn, radii, _ = np.linalg.svd(part.to_world)
    x, y, z, w = as_quaternions(turn * np.linalg.det(turn)[:, None, None]).T  # mirrored, an ellipsoid is the same
    columns = [*part.center.T, *np.zeros((3, len(radii))), *radii.T, x, y, z, w, *np.log(radii).T, w, x, y, z]
    file = out.file("ply", float_columns(dict(zip(PROPERTIES, columns, strict=True))))
    element = Element("shape", type="ellipsoids", id=out.name)
    SubElement(element, "string", name="filename", value=file)
    SubElement(element, "float", name="extent", value="1")
    element.append(out.material(shape))
    return [element]


def as_quaternions(turn: np.ndarray) -> np.ndarray:
    """(n, 4) unit quaternions x, y, z, w of rotation matrices (n, 3, 3)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(turn, 0, 2)
    # four times the outer product of the quaternion with itself
    rows = [
        [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz],
    ]
    return np.asarray(np.linalg.eigh(np.moveaxis(np.array(rows), 2, 0))[1][:, :, -1])


def intersect(*arguments: Any, float32: bool = True) -> tuple[Intersections, ...]:
    """Where ray i enters ellipsoid k[i]. float32: as Mitsuba computes it."""
    return intersect_round(*arguments, ends=False, float32=float32)[:1]


def describe(part: OuterEllipsoids, k: int) -> Fields:
    """A unit sphere under the matrix."""
    rows = np.column_stack([part.to_world[k], part.center[k]]).tolist()
    unit: Fields = {name: [list(row)] for name, (row,) in EllipsoidCloud.MINIMAL.items()}
    return {"type": "ellipsoids", **unit, "to_world": [{"matrix": [*rows, [0.0, 0.0, 0.0, 1.0]]}]}


def expected(shape: EllipsoidCloud, part: OuterEllipsoids) -> Iterator[ExpectedNumbers]:
    """Centres, and A A^T, the ellipsoid itself: it is the same for mirrored axes or in another order."""
    centers, scales, quaternions = shape.ellipsoids()
    linear, move = shape.matrix[:3, :3], shape.matrix[:3, 3]
    size = np.abs(centers) @ np.abs(linear).T + np.abs(move)
    yield ExpectedNumbers("center", part.center, centers @ linear.T + move, size)
    unit = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
    # q p q* of each axis p: p + 2 w (v x p) + 2 v x (v x p)
    v, w = unit[:, None, :3], unit[:, None, 3:]
    once = np.cross(v, np.eye(3))
    axes = (np.eye(3) + 2.0 * (w * once + np.cross(v, once))) * (shape.extent * scales)[:, :, None] @ linear.T
    reach = np.linalg.norm(linear, axis=1) * (shape.extent * scales).max(axis=1)[:, None]
    squares = np.einsum("nki,nkj->nij", axes, axes)
    packed = np.einsum("nik,njk->nij", part.to_world, part.to_world)
    yield ExpectedNumbers("ellipsoid", packed, squares, reach[:, :, None] * reach[:, None, :])


def random_fields(rng: Rng, lattice: bool) -> Fields:
    """One to eight ellipsoids; on the lattice turned by quarters of a turn or not at all."""
    count = int(rng.integers(1, 9))
    turns = [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.0, -1.0, 0.0, 1.0]]
    return {
        "centers": [random_point(rng, lattice) for _ in range(count)],
        "scales": [[random_length(rng, lattice) for _ in range(3)] for _ in range(count)],
        "quaternions": [turns[int(rng.integers(3))] if lattice else rng.normal(size=4).tolist() for _ in range(count)],
    }


ELLIPSOIDS = PrimitiveReference(
    OuterEllipsoids,
    ErrorModel(
        intersect,
        EXACT,
        ours_through_object_space(partial(intersect, float32=False)),
        uv=UvSpace(sphere_uv_points, None),
    ),
    describe,
    on_unit_shape(unit_sphere_points),
    derived=("to_object",),
    rounding_groups=(by_matrix,),
    known_defects=(*DEFECTS, STRETCHED),
    defect_view=view_ellipsoid,
)
REFERENCE = ShapeReference(
    EllipsoidCloud, to_xml, (ELLIPSOIDS,), expected, random_fields, analytic=True, drawn_for="spheres"
)
