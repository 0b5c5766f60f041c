"""What descriptions are made of: validated fields, base classes of shapes, cameras and lights, and `to_world`."""

import contextlib
import math
import numbers
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from caster.description import transform
from caster.description.errors import (
    SceneError,
    diagnostics_of,
    expectation_error,
    field_error,
    format_value,
    join_words,
)

__all__ = ["Camera", "Count", "Description", "Index", "Positive", "RowOf", "Shape"]

# ---- numbers and vectors ----

HEX_FLOAT = r"^[+-]?0[xX][0-9a-fA-F]+(\.[0-9a-fA-F]*)?([pP][+-]?[0-9]+)?$"


class Quantity:
    """A finite float in a range. Hex-float strings ("0x1.8p-3") are accepted; other strings and booleans are not."""

    def __init__(self, signed_zero: bool = False, **limits: Any) -> None:
        """signed_zero: whether -0.0 stays; else it is 0.0, so that equal scenes have equal text.

        limits: of Pydantic's floats: gt, ge, lt, le.
        """
        self.signed_zero, self.limits = signed_zero, limits

    def _read(self, value: Any) -> float:
        hint = ""
        with contextlib.suppress(OverflowError, ValueError):
            if isinstance(value, str) and not re.match(HEX_FLOAT, value):
                hint = ": leave out the quotes" if math.isfinite(float(value)) else ""
            elif not isinstance(value, bool) and isinstance(value, (str, numbers.Real)):
                number = float.fromhex(value) if isinstance(value, str) else float(value)
                return number if self.signed_zero else number + 0.0
        raise expectation_error("a finite number", value, hint=hint)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        number = core_schema.float_schema(allow_inf_nan=False, **self.limits)
        written = core_schema.union_schema([number, core_schema.str_schema(pattern=HEX_FLOAT)])
        return core_schema.no_info_before_validator_function(self._read, number, json_schema_input_schema=written)


class FixedArray(np.ndarray):
    """A read-only array of numbers, equal to another if all numbers are."""

    def __eq__(self, other: object) -> Any:
        return other is not None and np.array_equal(np.asarray(self), np.asarray(other))

    def __hash__(self) -> int:  # type: ignore[override]  # other arrays have none
        return hash(self.tobytes())


@dataclass(frozen=True)
class ArrayOf:
    """A list of many items, numbers or rows of them, kept as a FixedArray of a dtype. Arrays are copied."""

    item: Any
    dtype: type[np.generic] = np.float64

    def _read(self, value: Any, validate: ValidatorFunctionWrapHandler) -> FixedArray:
        if isinstance(value, np.ndarray):
            with contextlib.suppress(ValidationError):  # the limits of all items, if those of their extremes
                if value.dtype.kind in "iuf" and value.size:
                    validate([value.min(axis=0).tolist(), value.max(axis=0).tolist()])
                    return self._kept(value)
            value = value.tolist()
        return self._kept(validate(value))

    def _kept(self, items: Any) -> FixedArray:
        try:
            array = np.array(items, self.dtype) + 0  # no -0.0, as of a Quantity
        except ValueError:
            lengths = sorted({len(row) for row in items})
            raise ValueError(f"must have rows of the same length, got {lengths}") from None
        array.flags.writeable = False
        return array.view(FixedArray)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        items = handler.generate_schema(Annotated[list[self.item], FailFast(), Field(min_length=1)])  # type: ignore[name-defined]  # a value
        as_list = core_schema.plain_serializer_function_ser_schema(np.ndarray.tolist)
        return core_schema.no_info_wrap_validator_function(self._read, items, serialization=as_list)


def plain(value: Any) -> Any:
    """An array as lists of numbers; anything else unchanged."""
    return value.tolist() if isinstance(value, np.ndarray) else value


@dataclass(frozen=True)
class RowOf:
    """A list of `count` items, kept as a tuple; Any for type checkers: tuples, lists and arrays alike."""

    item: Any
    count: int
    what: str  # in messages

    def _items(self, value: Any) -> Any:
        items = plain(value)
        if not isinstance(items, (list, tuple)):
            raise expectation_error(self.what, value)
        if len(items) != self.count:
            raise field_error(f"must be {self.what}, got {len(items)}: {format_value(items)}")
        return items

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        items = handler.generate_schema(tuple.__class_getitem__((self.item,) * self.count))
        return core_schema.no_info_before_validator_function(self._items, items)


def _unit(v: tuple[float, float, float]) -> tuple[float, float, float]:
    try:
        return transform.unit(v)
    except ValueError:
        raise expectation_error("a direction, so not all zero", v) from None


Number = Annotated[float, Quantity()]  # a finite number
SignedNumber = Annotated[float, Quantity(signed_zero=True)]  # a finite number; zeros keep their signs
Positive = Annotated[float, Quantity(gt=0.0)]  # a number > 0
NonNegative = Annotated[float, Quantity(ge=0.0)]  # a number >= 0
RefractiveIndex = Annotated[float, Quantity(ge=1.0, le=4.0)]  # a number from 1 to 4, which is germanium's
Fraction01 = Annotated[float, Quantity(ge=0.0, le=1.0)]  # a number from 0 to 1
FieldOfView = Annotated[float, Quantity(gt=0.0, lt=180.0)]  # degrees, 0 to 180, both excluded
WideFieldOfView = Annotated[float, Quantity(gt=0.0, le=360.0)]  # degrees, 0 (excluded) to 360
Flag = Annotated[bool, Field(strict=True)]  # true or false

Vec2 = Annotated[Any, RowOf(Number, 2, "2 numbers [x, y]")]  # 2 numbers
Vec3 = Annotated[Any, RowOf(Number, 3, "3 numbers [x, y, z]")]  # 3 numbers
SignedVec3 = Annotated[Any, RowOf(SignedNumber, 3, "3 numbers [x, y, z]")]  # 3 numbers, zeros with their signs
RGB = Annotated[Any, RowOf(NonNegative, 3, "3 numbers [r, g, b]")]  # 3 numbers >= 0
Reflectance = Annotated[Any, RowOf(Fraction01, 3, "3 numbers [r, g, b]")]  # 3 numbers from 0 to 1
UnitVec3 = Annotated[Vec3, AfterValidator(_unit)]  # 3 numbers, made unit length

Row = Annotated[Any, RowOf(Number, 4, "4 numbers")]  # 4 numbers
Count = Annotated[int, Field(strict=True, gt=0, lt=2**31)]  # a whole number > 0
Index = Annotated[int, Field(strict=True, ge=0, lt=2**31)]  # a whole number >= 0
Face = Annotated[Any, RowOf(Index, 3, "3 vertex numbers [i, j, k]")]
Scales = Annotated[Any, RowOf(Positive, 3, "3 lengths [x, y, z]")]

Points = Annotated[transform.Floats, ArrayOf(Vec3)]  # (n, 3) float64
UVs = Annotated[transform.Floats, ArrayOf(Vec2)]  # (n, 2) float64
Faces = Annotated[NDArray[np.int64], ArrayOf(Face, np.int64)]  # (m, 3) int64
Counts = Annotated[NDArray[np.int64], ArrayOf(Count, np.int64)]  # (m,) int64 > 0
Lengths = Annotated[transform.Floats, ArrayOf(Positive)]  # (n,) float64 > 0
LengthTriples = Annotated[transform.Floats, ArrayOf(Scales)]  # (n, 3) float64 > 0
Quaternions = Annotated[transform.Floats, ArrayOf(Row)]  # (n, 4) float64, x, y, z, w


# ---- descriptions ----


class Description(BaseModel):
    """Base class of all elements of a scene: immutable; unknown keys are errors.

    Raises SceneError with all validation errors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, defer_build=True)

    # Number of path steps that name an element in messages: two for shapes[3], one for camera.
    ELEMENTS: ClassVar[Mapping[str, int]] = {}

    def __init__(self, **data: Any) -> None:
        data = {key: value.item() if isinstance(value, np.generic) else value for key, value in data.items()}
        try:
            super().__init__(**data)
        except ValidationError as error:
            problems = diagnostics_of(error, {key: plain(value) for key, value in data.items()}, type(self))
            raise SceneError("\n".join(problem.message() for problem in problems)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_"):
            way_out = f"use a copy with another value: model_copy(update={{'{name}': ...}})"
            raise AttributeError(f"{type(self).__name__}.{name}: descriptions are immutable; {way_out}")
        super().__setattr__(name, value)

    def __eq__(self, other: object) -> bool:
        """Equality of all fields; cached data does not count."""
        return type(self) is type(other) and all(getattr(self, n) == getattr(other, n) for n in type(self).model_fields)

    # Nested descriptions are validated without __init__, so that Pydantic collects all errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # on a function

    @model_serializer(mode="wrap")
    def _with_type(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The fields; also without defaults, the `type` that selects the class."""
        fields: dict[str, Any] = handler(self)
        return {"type": kind, **fields} if (kind := getattr(self, "type", None)) else fields

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A validated copy with other values. Cached properties are not copied."""
        kept = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**(kept | dict(update or {})))


def exactly_one(one: str, other: str) -> Any:
    """A validator of descriptions: one of two fields is given, and not both."""

    def check(self: Description) -> Description:
        given = [name for name in (one, other) if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"needs either {one} or {other}, got {'both' if given else 'neither'}")
        return self

    return model_validator(mode="after")(check)


# ---- to_world ----


class Rotation(Description):
    """A rotation about an axis through the origin, counter-clockwise seen from the tip of the axis."""

    axis: UnitVec3
    degrees: Number


class LookAt(Description):
    """The rigid transform that maps the origin to `origin`, +z towards `target`, and +y close to `up`."""

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)

    @model_validator(mode="after")
    def _has_a_frame(self) -> Self:
        checked_frame(self, "origin", "target")
        return self


def checked_frame(view: Any, start: str, target: str) -> transform.Frame:
    """(right, up, forward) of a description with `up`, and with a direction or a target.

    start, target: names of its fields. Raises the error of the field by which the frame is not defined.
    """
    origin, aim, up = getattr(view, start), getattr(view, target), view.up
    direction = view.direction if aim is None else transform.subtract(aim, origin)
    if aim == origin:
        text = f"must differ from {start}, so that the viewing direction is defined, got {format_value(aim)}"
        raise field_error(text, target)
    if not np.isfinite(direction).all():
        raise expectation_error(f"nearer to {start}, at a finite distance", aim, target)
    try:
        return transform.frame(transform.unit(direction), up)
    except ValueError:
        across = f"a direction across the view {format_value(list(direction))}, not along it"
        raise expectation_error(across, up, "up") from None


Rows = Annotated[Any, RowOf(Row, 4, "4 rows of 4 numbers")]  # 4 rows of 4 numbers
_for_all = BeforeValidator(
    lambda value: value if isinstance(value, (list, tuple, np.ndarray)) else (value, value, value),
    json_schema_input_type=Number | Vec3,
)
Factors = Annotated[Vec3, _for_all]  # 3 numbers, or one for all


class Step(Description, json_schema_extra={"minProperties": 1, "maxProperties": 1}):
    """One transform step; exactly one key is set."""

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


Transform: TypeAlias = Any  # for type checkers: a step, a list of steps, or their descriptions
if not TYPE_CHECKING:
    _steps = BeforeValidator(_as_list, json_schema_input_type=Step | tuple[Step, ...])
    Transform = Annotated[
        tuple[Step, ...], _steps, AfterValidator(_invertible)
    ]  # a step or a list of steps: translate, rotate, scale, look_at, matrix


def _printable(name: str) -> str:
    if not name.isprintable():
        raise expectation_error("printable characters", name)
    return name


Name = Annotated[str, AfterValidator(_printable)]  # printable text


# ---- shapes, cameras and lights ----


class Shape(Description):
    """Base of all shapes: name, material and transform."""

    type: str
    name: Name = ""  # in messages; by default its type and number
    material: str = ""  # a name in Scene.materials
    to_world: Transform = ()

    MINIMAL: ClassVar[Mapping[str, Any]] = {}  # the required fields, for a smallest instance

    @cached_property
    def matrix(self) -> transform.Matrix:
        """Object-to-world transform: 4x4 float64, read-only."""
        matrix = matrix_of(self.to_world)
        matrix.flags.writeable = False
        return matrix

    def without_uv(self) -> str:
        """Why the shape cannot have a texture; "" if it can."""
        return ""

    def pack(self, rounded: Callable[[np.ndarray], np.ndarray]) -> Any:
        """World-space arrays for kernels; `rounded` is applied to each number that defines the geometry."""
        raise NotImplementedError


class Camera(Description):
    """Base of all cameras: position and orientation."""

    type: str
    eye: Vec3  # scene units
    look_at: Vec3 | None = None  # scene units
    direction: UnitVec3 | None = None  # in place of look_at
    up: Vec3 = (0.0, 1.0, 0.0)  # a direction across the view

    shares_origin: ClassVar[bool] = False  # whether all rays start at one point, which saves work
    MINIMAL: ClassVar[Mapping[str, Any]] = {"eye": (0.0, 0.0, 9.0), "look_at": (0.0, 0.0, 0.0)}

    @model_validator(mode="after")
    def _has_a_frame(self) -> Self:
        if (self.direction is None) == (self.look_at is None):
            got = "neither" if self.direction is None else "both"
            raise field_error(f"or look_at is required, exactly one of the two, got {got}", "direction")
        checked_frame(self, "eye", "look_at")
        return self

    @cached_property
    def frame(self) -> transform.Frame:
        """(right, up, forward), orthonormal float64: right and up in the image, right = forward x up."""
        return checked_frame(self, "eye", "look_at")

    def pack(self, width: int, height: int) -> Any:
        """The camera's parameters for kernels, for a film of this size in pixels."""
        raise NotImplementedError


class ClippedCamera(Camera):
    """Base of cameras with clipping planes."""

    near: NonNegative = 0.0  # scene units
    far: Annotated[Positive | None, Field(description="None: no limit")] = None  # scene units; None: no limit

    @model_validator(mode="after")
    def _near_is_nearer(self) -> Self:
        if self.far is not None and self.near >= self.far:
            raise ValueError(f"near must be < far, got near {self.near} and far {self.far}")
        return self

    @property
    def clip(self) -> tuple[float, float]:
        """near and far, inf without a limit."""
        return self.near, math.inf if self.far is None else self.far
