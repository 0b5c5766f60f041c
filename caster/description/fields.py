"""Base classes of shapes, cameras and lights, and their `to_world`; re-exports what descriptions are written with."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator, model_validator
from pydantic_core import CoreSchema

from caster.description import transform
from caster.description.errors import (
    FileMissing,
    SceneError,
    expectation_error,
    field_error,
    format_value,
    join_words,
    suggestion,
)
from caster.description.quantities import (
    HEX_FLOAT,
    RGB,
    Description,
    FieldOfView,
    Fraction01,
    Lengths,
    NonNegative,
    Number,
    Points,
    Positive,
    PositiveNumber,
    Reflectance,
    UnitVec3,
    Vec2,
    Vec3,
    WideFieldOfView,
    row,
)

__all__ = [
    "RGB",
    "Camera",
    "Description",
    "FieldOfView",
    "FileMissing",
    "Fraction01",
    "Lengths",
    "Light",
    "Name",
    "NonNegative",
    "Number",
    "Points",
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


class Rotation(Description):
    """A rotation about an axis through the origin, counter-clockwise seen from the tip of the axis."""

    axis: UnitVec3
    degrees: Number


class LookAt(Description):
    """The rigid transform that maps the origin to `origin`, +z towards `target`, and +y close to `up`."""

    origin: Vec3
    target: Vec3
    up: Annotated[Vec3, Field(validate_default=True)] = (0.0, 1.0, 0.0)

    @field_validator("target")
    @classmethod
    def _is_elsewhere(cls, target: Any, info: Any) -> Any:
        return check_elsewhere(target, "origin", info.data)

    @field_validator("up")
    @classmethod
    def _is_across(cls, up: Any, info: Any) -> Any:
        if {"origin", "target"} <= info.data.keys():
            check_up(up, transform.subtract(info.data["target"], info.data["origin"]))
        return up


def check_elsewhere(target: Any, start: str, values: Mapping[str, Any]) -> Any:
    """Validate that the direction from a field of `values` to the target is defined."""
    if target is not None and start in values:
        if target == values[start]:
            raise expectation_error(f"another point than {start}, so that the viewing direction is defined", target)
        if not np.isfinite(transform.subtract(target, values[start])).all():
            raise expectation_error(f"nearer to {start}, at a finite distance", target)
    return target


def check_up(up: Any, view: Any) -> None:
    """Validate that `up` is not parallel to the view."""
    try:
        transform.frame(transform.unit(view), up)
    except ValueError:
        raise expectation_error(f"a direction across the view {format_value(list(view))}, not along it", up) from None


class _OrNumber:
    """JSON Schema: a number is accepted in place of a vector."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": HEX_FLOAT}, handler(schema)]}


class _OrOneStep:
    """JSON Schema: a single step is accepted in place of a list."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        steps = handler(schema)
        return {"anyOf": [steps["items"], steps]}


def _three(value: Any) -> Any:
    return value if isinstance(value, (list, tuple, np.ndarray)) else (value, value, value)


Row = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(row(4, "4 numbers"))]
Rows = Annotated[tuple[Row, Row, Row, Row], BeforeValidator(row(4, "4 rows of 4 numbers"))]
Factors = Annotated[Vec3, BeforeValidator(_three), _OrNumber()]


class Step(Description):
    """One transform step; exactly one key is set."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    translate: Vec3 | None = None
    rotate: Rotation | None = None
    scale: Factors | None = None
    look_at: LookAt | None = None
    matrix: Rows | None = None

    @field_validator("matrix")
    @classmethod
    def _is_affine(cls, rows: Any) -> Any:
        if rows is not None and rows[3] != (0.0, 0.0, 0.0, 1.0):
            raise field_error(f"must end in the row [0, 0, 0, 1], got {format_value(rows[3])}")
        return rows

    @model_validator(mode="after")
    def _is_one_step(self) -> Self:
        given = [key for key in type(self).model_fields if getattr(self, key) is not None]
        if not given:
            raise field_error(f"needs one of the keys {join_words(type(self).model_fields)}")
        if len(given) > 1:
            raise field_error(f"must have one key, got {join_words(given, 'and')}: write a list of steps instead")
        return self

    def as_matrix(self) -> transform.Matrix:
        """The step as a 4x4 float64 matrix."""
        if self.translate is not None:
            return transform.translate(self.translate)
        if self.rotate is not None:
            return transform.rotate(self.rotate.axis, self.rotate.degrees)
        if self.scale is not None:
            return transform.scale(self.scale)
        if self.look_at is not None:
            return transform.look_at(self.look_at.origin, self.look_at.target, self.look_at.up)
        return np.array(self.matrix, np.float64)


def matrix_of(steps: tuple[Step, ...]) -> transform.Matrix:
    """The composition of the steps, in their order, as one 4x4 float64 matrix."""
    return transform.compose(step.as_matrix() for step in steps)


def _as_list(value: Any) -> Any:
    if isinstance(value, (Mapping, Step)):
        return (value,)
    if not isinstance(value, (list, tuple)):
        raise expectation_error("a list of steps such as {translate = [1, 0, 0]}", value)
    return value


def _invertible(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    matrix = matrix_of(steps)
    if not np.isfinite(matrix).all():
        raise field_error("must stay finite, but its steps together overflow")
    if not transform.is_invertible(matrix):
        raise field_error("must be invertible, but its matrix is singular")
    return steps


Transform = Annotated[tuple[Step, ...], BeforeValidator(_as_list), AfterValidator(_invertible), _OrOneStep()]


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
