"""Validated field types (numbers, vectors, colours), and the base class of all descriptions."""

import contextlib
import math
import numbers
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from caster.description import transform
from caster.description.errors import SceneError, diagnostics_of, expectation_error, field_error, format_value

HEX_FLOAT = r"^[+-]?0[xX][0-9a-fA-F]+(\.[0-9a-fA-F]*)?([pP][+-]?[0-9]+)?$"


@dataclass(frozen=True)
class Quantity:
    """A finite float in a range. Hex-float strings ("0x1.8p-3") are numbers too; "0.5" and true are not."""

    what: str
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def read(self, value: Any) -> float:
        """Parse a number; raises an error that names `what` was expected."""
        number = _as_float(value, self.what)
        if not (math.isfinite(number) and self.holds(number)):
            raise expectation_error(self.what, value)
        return number + 0.0  # -0.0 becomes 0.0, so that equal scenes have equal text

    def holds(self, x: float | np.ndarray) -> bool:
        """Whether a number, or each of an array, is in the range."""
        above = (self.gt is None or np.all(x > self.gt)) and (self.ge is None or np.all(x >= self.ge))
        below = (self.lt is None or np.all(x < self.lt)) and (self.le is None or np.all(x <= self.le))
        return bool(above and below)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, core_schema.float_schema())

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        keys = ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum")
        limits = zip(keys, (self.gt, self.ge, self.lt, self.le), strict=True)
        number = {"type": "number"} | {key: limit for key, limit in limits if limit is not None}
        return {"anyOf": [number, {"type": "string", "pattern": HEX_FLOAT}]}


def _as_float(value: Any, what: str) -> float:
    if isinstance(value, str) and re.match(HEX_FLOAT, value):
        return _or_inf(float.fromhex, value)
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise expectation_error(what, value, ": leave out the quotes" if _is_quoted_number(value) else "")
    return _or_inf(float, value)


def _or_inf(convert: Callable[[Any], float], value: Any) -> float:
    try:
        return convert(value)
    except OverflowError:
        return math.inf


def _is_quoted_number(value: Any) -> bool:
    try:
        return isinstance(value, str) and math.isfinite(float(value))
    except ValueError:
        return False


@dataclass(frozen=True)
class NumberList:
    """A list of many numbers, or of rows of them, checked as one array and kept as tuples.

    what: of the list, in messages; each: its numbers; width: numbers of a row, 0 for a list of plain numbers.
    """

    what: str
    each: Quantity
    width: int = 0

    def read(self, value: Any) -> tuple[Any, ...]:
        """Parse a list; raises an error that gives the index of the first bad item."""
        items = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(items, (list, tuple)) or not items:
            raise expectation_error(f"a list of {self.what}", value)
        if self._are_plain(items):
            with contextlib.suppress(OverflowError):  # a whole number beyond float64
                array = np.array(items, np.float64) + 0.0  # as Quantity.read
                if np.isfinite(array).all() and self.each.holds(array):
                    rows = array.tolist()
                    return tuple(map(tuple, rows)) if self.width else tuple(rows)
        return tuple(self._item(items, i) for i in range(len(items)))

    def _are_plain(self, items: Sequence[Any]) -> bool:
        """Whether these are rows of the right length of Python's own numbers, no strings, no booleans."""
        if not self.width:
            return set(map(type, items)) <= {int, float}
        if not set(map(type, items)) <= {list, tuple} or set(map(len, items)) != {self.width}:
            return False
        return set(map(type, chain.from_iterable(items))) <= {int, float}

    def _item(self, items: Sequence[Any], i: int) -> Any:
        value = items[i].tolist() if isinstance(items[i], np.ndarray) else items[i]
        try:
            if not self.width:
                return self.each.read(value)
            if isinstance(value, (list, tuple)) and len(value) == self.width:
                return tuple(map(self.each.read, value))
        except PydanticCustomError:
            pass  # the message below says what the whole list has to be
        raise field_error(f"must be a list of {self.what}, got {format_value(value)} as number {i}")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, core_schema.any_schema())

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        item = self.each.__get_pydantic_json_schema__(schema, handler)
        if self.width:
            item = {"type": "array", "items": item, "minItems": self.width, "maxItems": self.width}
        return {"type": "array", "items": item, "minItems": 1}


def row(count: int, what: str) -> Callable[[Any], Any]:
    """A validator for `count` items, run before those of the items."""

    def check(value: Any) -> Any:
        items = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(items, (list, tuple)):
            raise expectation_error(what, value)
        if len(items) != count:
            raise field_error(f"must be {what}, got {len(items)}: {format_value(items)}")
        return items

    return check


def _unit(v: tuple[float, float, float]) -> tuple[float, float, float]:
    try:
        return transform.unit(v)
    except ValueError:
        raise expectation_error("a direction, so not all zero", v) from None


Number = Annotated[float, Quantity("a finite number")]
Positive = Annotated[float, Quantity("a length > 0", gt=0.0)]
PositiveNumber = Annotated[float, Quantity("a number > 0", gt=0.0)]
NonNegative = Annotated[float, Quantity("a number >= 0", ge=0.0)]
Fraction01 = Annotated[float, Quantity("a number from 0 to 1", ge=0.0, le=1.0)]
FieldOfView = Annotated[float, Quantity("an angle > 0 and < 180 degrees", gt=0.0, lt=180.0)]
WideFieldOfView = Annotated[float, Quantity("an angle > 0 and <= 360 degrees", gt=0.0, le=360.0)]

Points = Annotated[
    tuple[tuple[float, float, float], ...],
    NumberList("points [x, y, z] of finite numbers", Quantity("a finite number"), width=3),
]
Lengths = Annotated[tuple[float, ...], NumberList("lengths > 0", Quantity("a length > 0", gt=0.0))]
Vec2 = Annotated[tuple[Number, Number], BeforeValidator(row(2, "2 numbers [x, y]"))]
Vec3 = Annotated[tuple[Number, Number, Number], BeforeValidator(row(3, "3 numbers [x, y, z]"))]
UnitVec3 = Annotated[Vec3, AfterValidator(_unit)]

_rgb = row(3, "3 numbers [r, g, b]")
RGB = Annotated[tuple[NonNegative, NonNegative, NonNegative], BeforeValidator(_rgb)]
Reflectance = Annotated[tuple[Fraction01, Fraction01, Fraction01], BeforeValidator(_rgb)]


# By their address, and kept, so that no other gets it: the schema of a scene has those of all shapes, again and again.
_SEEN: dict[int, Any] = {}


def _take_as_given(schema: Any) -> None:
    """Disable conversions to integers and booleans: no true for 1, no 3.0 for 3, no "yes" for true."""
    if isinstance(schema, dict):
        if id(schema) in _SEEN:
            return
        _SEEN[id(schema)] = schema
        if schema.get("type") in ("int", "bool"):
            schema["strict"] = True
        for part in schema.values():
            _take_as_given(part)
    elif isinstance(schema, (list, tuple)):
        for part in schema:
            _take_as_given(part)


def _plain(value: Any) -> Any:
    """NumPy arrays and scalars as lists and Python scalars."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


class Description(BaseModel):
    """Base class of all elements of a scene: immutable; unknown keys are errors.

    Raises SceneError with all validation errors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, defer_build=True)

    # Number of path steps that name an element in messages: two for shapes[3], one for camera.
    ELEMENTS: ClassVar[Mapping[str, int]] = {}

    def __init__(self, **data: Any) -> None:
        data = {key: _plain(value) for key, value in data.items()}
        try:
            super().__init__(**data)
        except ValidationError as error:
            problems = diagnostics_of(error, data, type(self))
            raise SceneError("\n".join(problem.text for problem in problems)) from None

    # Nested descriptions are validated without __init__, so that Pydantic collects all errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # on a function

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        _take_as_given(handler.resolve_ref_schema(schema))
        return schema

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A validated copy with other values. Cached properties are not copied."""
        kept = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**(kept | dict(update or {})))
