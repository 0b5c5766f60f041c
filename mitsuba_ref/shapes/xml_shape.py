"""Reading of <shape> elements of Mitsuba's XML: the interface by which shapes import themselves, and shared parts."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

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
    elif matrix is not None and np.linalg.det(matrix[:3, :3]) < 0.0:
        xml.note(
            "the side of its normal: Mitsuba's mirrored geometric and shading normals point to different sides"
        )
