"""What the judge has to know of a shape: how to tell Mitsuba, and how far Mitsuba may be off."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from caster.description.fields import Shape
from mitsuba_ref.error_model.independent_transform import ExpectedPacking
from mitsuba_ref.error_model.intersections import ErrorModel
from mitsuba_ref.reference.xml_writer import ShapeWriter, XmlElement


def as_packed(part: Any, o: np.ndarray, d: np.ndarray) -> Any:
    """Mitsuba traces the very numbers that were packed."""
    return part


@dataclass(frozen=True)
class ShapeReference:
    """One entry of the registry `mitsuba_ref.shapes.REFERENCES`."""

    describes: type[Shape]

    # (writer, description, float32 arrays) -> the elements of the shape, the last with its id
    to_xml: Callable[[ShapeWriter, Any, Any], list[XmlElement]]

    # for each kind of primitive the shape packs to
    models: Mapping[type, ErrorModel] = field(repr=False)

    # (description, its packed arrays) -> what has to hold of them, worked out a second time
    placed: ExpectedPacking

    # Mitsuba intersects it with code of its own, which is float64 in its scalar variant only
    analytic: bool = False

    # (float32 arrays, rays o, d) -> what Mitsuba traces in place of what it cannot express
    stand_in: Callable[[Any, np.ndarray, np.ndarray], Any] = as_packed
