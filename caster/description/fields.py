"""Base classes of shapes, cameras and lights. Re-exports what their descriptions are written with."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from caster.description import transform
from caster.description.errors import (
    FileMissing,
    SceneError,
    expectation_error,
    field_error,
    format_value,
    suggestion,
)
from caster.description.quantities import (
    RGB,
    Description,
    FieldOfView,
    Fraction01,
    NonNegative,
    Number,
    Positive,
    PositiveNumber,
    Reflectance,
    UnitVec3,
    Vec2,
    Vec3,
    WideFieldOfView,
)
from caster.description.to_world import Transform, check_elsewhere, check_up, matrix_of

__all__ = [
    "RGB",
    "Camera",
    "Description",
    "FieldOfView",
    "FileMissing",
    "Fraction01",
    "Light",
    "Name",
    "NonNegative",
    "Number",
    "Positive",
    "PositiveNumber",
    "Reflectance",
    "SceneError",
    "Shape",
    "Transform",
    "UnitVec3",
    "Vec2",
    "Vec3",
    "WideFieldOfView",
    "expectation_error",
    "field_error",
    "format_value",
    "suggestion",
]


def _printable(name: str) -> str:
    if not name.isprintable():
        raise expectation_error("printable characters", name)
    return name


Name = Annotated[str, AfterValidator(_printable)]


class Shape(Description):
    """Base of all shapes: name, material and transform."""

    type: str
    name: Name = ""
    material: str = ""
    to_world: Transform = ()

    MINIMAL: ClassVar[Mapping[str, Any]] = {}  # fields without which there is no instance

    @cached_property
    def matrix(self) -> transform.Matrix:
        """Object-to-world transform: 4x4 float64, read-only."""
        matrix = matrix_of(self.to_world)
        matrix.flags.writeable = False
        return matrix

    def pack(self, rounded: Callable[[np.ndarray], np.ndarray]) -> Any:
        """World-space arrays for kernels; `rounded` is applied to each number that defines the geometry."""
        raise NotImplementedError


class Camera(Description):
    """Base of all cameras: position and orientation."""

    type: str
    eye: Vec3
    look_at: Vec3 | None = None
    direction: Annotated[UnitVec3 | None, Field(validate_default=True)] = None
    up: Annotated[Vec3, Field(validate_default=True)] = (0.0, 1.0, 0.0)

    shares_origin: ClassVar[bool] = False  # whether all rays start in one point, which saves work
    MINIMAL: ClassVar[Mapping[str, Any]] = {"eye": (0.0, 0.0, 9.0), "look_at": (0.0, 0.0, 0.0)}

    @field_validator("look_at")
    @classmethod
    def _is_elsewhere(cls, look_at: Any, info: Any) -> Any:
        return check_elsewhere(look_at, "eye", info.data)

    @field_validator("direction")
    @classmethod
    def _looks_one_way(cls, direction: Any, info: Any) -> Any:
        if "look_at" in info.data and (direction is None) == (info.data["look_at"] is None):
            got = "neither" if direction is None else "both"
            raise field_error(f"or look_at is required, exactly one of the two, got {got}")
        return direction

    @field_validator("up")
    @classmethod
    def _is_across(cls, up: Any, info: Any) -> Any:
        if {"eye", "look_at", "direction"} <= info.data.keys():
            check_up(up, _view(**{key: info.data[key] for key in ("eye", "look_at", "direction")}))
        return up

    @cached_property
    def frame(self) -> tuple[transform.Vector, transform.Vector, transform.Vector]:
        """(right, up, forward), orthonormal float64: right and up in the image, right = forward x up."""
        view = transform.unit(_view(self.eye, self.look_at, self.direction))
        return transform.frame(view, self.up)

    def pack(self, width: int, height: int) -> Any:
        """The camera's parameters for kernels, for a film of this size in pixels."""
        raise NotImplementedError


def _view(eye: Any, look_at: Any, direction: Any) -> transform.Vector:
    return direction if look_at is None else transform.subtract(look_at, eye)


class Light(Description):
    """Base of all lights."""

    type: str

    def pack(self) -> Any:
        """The light's parameters for kernels."""
        raise NotImplementedError(f"a light of type {self.type} has no direction")
