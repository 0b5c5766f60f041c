"""Declarations of shapes and primitive kinds for the judge (docs/internals/adding-a-shape.md).

A shape is described by a scene file (`type = "disk"`); a primitive kind is the NamedTuple of arrays that shapes pack to
(`Disks`). caster declares both in caster/shapes/<kind>.py. The judge, the fuzzer and reports need more:
one `ShapeReference` for each shape and one `PrimitiveReference` for each kind, registered in
mitsuba_ref/shapes/__init__.py.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.fields import Shape
from caster.description.transform import dot_rows
from mitsuba_ref.error_model.defect_conditions import DefectView, KnownDefect
from mitsuba_ref.error_model.independent_transform import ExpectedPacking
from mitsuba_ref.error_model.intersections import Array, ErrorModel, GroupKey, single_group
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes.targets import PointsFunction, Rng

Fields = dict[str, Any]  # of a scene, a shape, a camera, a light or a film, as a scene file gives them
RandomFields = Callable[[Rng, bool], Fields]

# (arrays, k (m,), Mitsuba's barycentrics (m, 3) and position (m, 3)) -> (m, 3) sum of the magnitudes of the terms of
# each coordinate of that position
PositionTerms = Callable[[Any, Array, Array, Array], Array]


@dataclass(frozen=True)
class PrimitiveReference:
    """A primitive kind: error model, exact arithmetic, and everything else that the judge needs for the kind."""

    arrays: type[Any]  # caster's NamedTuple; reports show its name

    # predicted intersections with error bounds, boxes, exact arithmetic
    model: ErrorModel = field(repr=False)

    # (arrays, k) -> fields of a shape that packs to exactly the numbers of primitive k; others for other numbers
    describe: Callable[[Any, int], Fields]

    # points where hits are hard to decide
    surface_points: PointsFunction

    # (arrays, k) -> fields of the same surface, if the packed bits do not matter; None: as `describe`
    describe_surface: Callable[[Any, int], Fields] | None = None

    # (arrays, PLY file to write) -> fields of one shape with all primitives, in order; None: one shape for each
    describe_all: Callable[[Any, Path], Fields] | None = None

    # names of arrays that packing derives from its rounded numbers, and does not round
    derived: tuple[str, ...] = ()

    # ways in which pixels may share a rounding of the reference; in its LLVM variant (None: the same)
    rounding_groups: Sequence[GroupKey] = (single_group,)
    rounding_groups_llvm: Sequence[GroupKey] | None = None

    # for kinds that Mitsuba traces as triangles: positions are tested for a bias; None: t is
    position_terms: PositionTerms | None = None

    # known defects of Mitsuba for this kind, and the measurements that identify them
    known_defects: tuple[KnownDefect, ...] = ()
    defect_view: Callable[[Any, int, Array, Array, float], DefectView] = lambda prims, k, o, d, t: DefectView()

    @property
    def name(self) -> str:
        """The kind's name in reports."""
        return self.arrays.__name__


@dataclass(frozen=True)
class ShapeReference:
    """A shape: its XML, the packed numbers expected of it, random instances."""

    describes: type[Shape]

    # (writer, description, float32 arrays) -> the elements of the shape, the last with its id
    to_xml: Callable[[ShapeWriter, Any, Any], list[XmlElement]]

    # every kind of primitive that the shape packs to
    kinds: tuple[PrimitiveReference, ...]

    # (description, its packed arrays) -> the expected numbers, computed independently
    expected: ExpectedPacking

    # (random generator, whether coordinates are on the fuzzer's lattice) -> the shape's own fields, of about unit size;
    # without any, the shape varies by its to_world alone
    random_fields: RandomFields = lambda rng, lattice: {}

    # the groups that the fuzzer draws it in: "quadric", "flat", "mesh", "small" (few primitives)
    groups: tuple[str, ...] = ()

    # instead of being in a group: the type of a shape in whose place the fuzzer draws it once in four times
    drawn_for: str = ""

    # Mitsuba intersects it analytically: in float64 in the scalar variant, in float32 in the LLVM variant
    analytic: bool = False

    # (float32 arrays, rays o, d) -> stand-in that Mitsuba traces if it lacks the shape, and a remark about it
    stand_in: Callable[[Any, Array, Array], Any] = lambda part, o, d: part
    stand_in_note: str = ""

    @property
    def type_name(self) -> str:
        """The `type` in scene files."""
        return self.describes.model_fields["type"].default


# ---- packed numbers back into the fields of a scene file, to the bit ----


def describe_unit_shape(type_name: str, **fields: Any) -> Callable[[Any, int], Fields]:
    """`describe` of primitives that are a unit shape, one of these fields, under a matrix."""

    def describe(part: Any, k: int) -> Fields:
        rows = np.column_stack([part.to_world[k], part.center[k]]).tolist()
        return {"type": type_name, **fields, "to_world": [{"matrix": [*rows, [0.0, 0.0, 0.0, 1.0]]}]}

    return describe


# Fraction of half the distance to the next float32 in which numbers surely round to it, also after float64 roundings.
ROUNDING_INTERVAL_FRACTION = 1.0 - 2.0**-20


def unit_vector_rounding_to(n: Array) -> Array:
    """A unit vector (up to float64 rounding) whose components round to the float32 values n (3,).

    n was rounded from a unit vector, so the box of all vectors that round to n contains one. Lengths grow along the
    diagonal from the box's corner nearest to 0 to the farthest, and are 1 somewhere.
    """
    if abs(float(dot_rows(n[None], n)[0]) - 1.0) <= 2.0**-52:
        return n
    single = np.abs(n).astype(np.float32)
    half = [0.5 * (np.nextafter(single, np.float32(end)).astype(np.float64) - single) for end in (0.0, np.inf)]
    low, high = (single + np.where(n == 0.0, 0.0, ROUNDING_INTERVAL_FRACTION * each) for each in half)
    across = high - low
    a, b, c = dot_rows(np.array([across, low, low]), np.array([across, across, low])).tolist()
    c -= 1.0
    s = -c / (b + np.sqrt(max(b * b - a * c, 0.0)))
    return np.copysign(low + min(max(s, 0.0), 1.0) * across, n)
