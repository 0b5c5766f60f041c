"""Declarations of shapes and primitive kinds on the judge's side (docs/adding-a-shape.md).

A shape is what a scene file describes (`type = "disk"`); a primitive kind is the NamedTuple of arrays that shapes pack
to (`Disks`). caster declares both in caster/shapes/<kind>.py. Everything the judge, the fuzzer, the reports and the
importer need beyond that is declared here, as one `ShapeReference` for a shape and one `PrimitiveReference` for a kind,
and registered in mitsuba_ref/shapes/__init__.py.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from caster.description.fields import Shape
from caster.description.transform import dot_rows, is_mirrored
from mitsuba_ref.error_model.defect_conditions import DefectView, KnownDefect
from mitsuba_ref.error_model.independent_transform import ExpectedPacking
from mitsuba_ref.error_model.intersections import ErrorModel, GroupKey, single_group
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes.targets import Rng, SurfacePoints

MIRROR_Z = {"scale": [1.0, 1.0, -1.0]}


class XmlShape(Protocol):
    """One <shape>, with the transforms of the instance that it is a part of."""

    instanced: bool  # whether an instance places it
    steps: list[dict[str, Any]]  # of its to_world, its own and the instance's

    @property
    def matrix(self) -> np.ndarray | None:
        """The product of the steps, 4x4; None if they are invalid, which the scene's validation reports."""

    def number(self, name: str, default: float) -> float: ...
    def vector(self, name: str, default: tuple[float, ...]) -> list[float]: ...
    def boolean(self, name: str) -> bool: ...
    def text(self, name: str) -> str: ...

    def required_text(self, name: str) -> str:
        """A text that has to be there; "" and an error in the import where it is not."""

    def note(self, text: str) -> None:
        """Report a property that the shape does not keep."""


ImportShape = Callable[[XmlShape], dict[str, Any]]


def to_world_fields(xml: XmlShape) -> dict[str, Any]:
    return {"to_world": xml.steps} if xml.steps else {}


def unit_shape_importer(type_name: str) -> ImportShape:
    """For a unit shape that is the same on both sides."""

    def import_unit_shape(xml: XmlShape) -> dict[str, Any]:
        note_normal_side(xml, xml.boolean("flip_normals"))
        return {"type": type_name} | to_world_fields(xml)

    return import_unit_shape


def note_normal_side(xml: XmlShape, flipped: bool) -> None:
    matrix = xml.matrix
    if flipped:
        xml.note("flip_normals: the normal is not flipped here")
    elif matrix is not None and is_mirrored(matrix[:3, :3]):
        xml.note("the side of its normal: Mitsuba's mirrored geometric and shading normals point to different sides")


Fields = dict[str, Any]  # of a shape, as a scene file gives them

# (arrays, k (m,), Mitsuba's barycentrics (m, 3) and position (m, 3)) -> (m, 3) magnitudes that it adds up to each
# coordinate of its position
PositionTerms = Callable[[Any, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def as_packed(part: Any, o: np.ndarray, d: np.ndarray) -> Any:
    """Mitsuba traces the packed numbers themselves."""
    return part


def all_numbers(part: Any, k: int) -> list[np.ndarray]:
    """Row k of every array."""
    return [array[k] for array in part]


def plain_view(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float) -> DefectView:
    """The view of a kind without known defects of its own."""
    return DefectView()


def no_fields(rng: Rng, lattice: bool) -> Fields:
    """A shape that its to_world alone varies."""
    return {}


@dataclass(frozen=True)
class PrimitiveReference:
    """A primitive kind: error model, exact arithmetic, and what else belongs to the kind."""

    arrays: type[Any]  # caster's NamedTuple; its name stands in reports

    # predicted intersections with error bounds, boxes, exact arithmetic
    model: ErrorModel = field(repr=False)

    # (arrays, k) -> the fields of a shape that packs to the very numbers of primitive k
    describe: Callable[[Any, int], Fields]

    # (arrays, k (m,), random generator, one of targets.SORTS) -> points where rays are likely to be judged wrongly
    surface_points: Callable[[Any, np.ndarray, Rng, str], SurfacePoints]

    # (arrays, k) -> the same surface, where the packed bits do not matter; None: as `describe`
    describe_surface: Callable[[Any, int], Fields] | None = None

    # (arrays, PLY file to write) -> the fields of one shape for all primitives, in order; None: each is described as a
    # shape of its own
    describe_all: Callable[[Any, Path], Fields] | None = None

    # (arrays, k) -> the numbers that are cast and judged
    numbers: Callable[[Any, int], list[np.ndarray]] = all_numbers

    # arrays that packing derives from its rounded numbers, and does not round
    derived: tuple[str, ...] = ()

    # ways in which one rounding of the reference may be common to many pixels; by its LLVM variant, None: the same
    rounding_groups: Sequence[GroupKey] = (single_group,)
    rounding_groups_llvm: Sequence[GroupKey] | None = None

    # of a kind that Mitsuba traces as triangles: its positions are tested for a bias; None: its t are
    position_terms: PositionTerms | None = None

    # what Mitsuba is known to get wrong about this kind, and the measurements by which it is recognised
    known_defects: tuple[KnownDefect, ...] = ()
    defect_view: Callable[[Any, int, np.ndarray, np.ndarray, float], DefectView] = plain_view

    @property
    def name(self) -> str:
        """The kind's name in reports."""
        return self.arrays.__name__


@dataclass(frozen=True)
class ShapeReference:
    """A shape: its XML, its packing computed a second time, its random instances, its importers."""

    describes: type[Shape]

    # (writer, description, float32 arrays) -> the elements of the shape, the last with its id
    to_xml: Callable[[ShapeWriter, Any, Any], list[XmlElement]]

    # every kind of primitive that the shape packs to
    kinds: tuple[PrimitiveReference, ...]

    # (description, its packed arrays) -> the numbers expected of them, computed a second time
    expected: ExpectedPacking

    # (random generator, whether coordinates are on the fuzzer's lattice) -> the shape's own fields, about unit size
    random_fields: Callable[[Rng, bool], Fields] = no_fields

    # the groups that the fuzzer draws it in: "quadric", "flat", "mesh", "small" (few primitives)
    groups: frozenset[str] = frozenset()

    # Mitsuba intersects it with code of its own, which is float64 in its scalar variant only
    analytic: bool = False

    # (float32 arrays, rays o, d) -> what Mitsuba traces in place of what it cannot express, and a remark about that
    stand_in: Callable[[Any, np.ndarray, np.ndarray], Any] = as_packed
    stand_in_note: str = ""

    # name of a plugin of Mitsuba's -> (its <shape>) -> the shape's fields
    importers: Mapping[str, ImportShape] = field(default_factory=dict)

    def model_of(self, part: Any) -> ErrorModel:
        """The error model of what the shape packed to."""
        return next(kind.model for kind in self.kinds if kind.arrays is type(part))

    @property
    def type_name(self) -> str:
        """What a scene file calls it."""
        name: str = self.describes.model_fields["type"].default
        return name


# ---- packed numbers back into the fields of a scene file, to the bit ----


def unit_shape_matrix(part: Any, k: int) -> list[dict[str, Any]]:
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
