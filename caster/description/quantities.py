"""Numbers and vectors as scene files spell them, each checked for what it means."""

import math
import numbers
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    ValidationError,
)
from pydantic_core import CoreSchema, core_schema

from caster.description import transform
from caster.description.diagnostics import diagnostics_of
from caster.description.errors import SceneError, complain, refuse, show

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
        """The number, or an error that says `what` was expected."""
        number = _as_float(value, self.what)
        if not (math.isfinite(number) and self._holds(number)):
            raise refuse(self.what, value)
        return number + 0.0  # -0.0 becomes 0.0: equal scenes are to be written alike

    def _holds(self, x: float) -> bool:
        above = (self.gt is None or x > self.gt) and (self.ge is None or x >= self.ge)
        return above and (self.lt is None or x < self.lt) and (self.le is None or x <= self.le)

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
        raise refuse(what, value, ": leave out the quotes" if _is_quoted_number(value) else "")
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


def row(count: int, what: str) -> Callable[[Any], Any]:
    """A check for `count` items, made before they are looked at one by one."""

    def check(value: Any) -> Any:
        items = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(items, (list, tuple)):
            raise refuse(what, value)
        if len(items) != count:
            raise complain(f"must be {what}, got {len(items)}: {show(items)}")
        return items

    return check


def _unit(v: tuple[float, float, float]) -> tuple[float, float, float]:
    try:
        return transform.unit(v)
    except ValueError:
        raise refuse("a direction, so not all zero", v) from None


Number = Annotated[float, Quantity("a finite number")]
Positive = Annotated[float, Quantity("a length > 0", gt=0.0)]
PositiveNumber = Annotated[float, Quantity("a number > 0", gt=0.0)]
NonNegative = Annotated[float, Quantity("a number >= 0", ge=0.0)]
Fraction01 = Annotated[float, Quantity("a number from 0 to 1", ge=0.0, le=1.0)]
FieldOfView = Annotated[float, Quantity("an angle > 0 and < 180 degrees", gt=0.0, lt=180.0)]
WideFieldOfView = Annotated[float, Quantity("an angle > 0 and <= 360 degrees", gt=0.0, le=360.0)]

Vec2 = Annotated[tuple[Number, Number], BeforeValidator(row(2, "2 numbers [x, y]"))]
Vec3 = Annotated[tuple[Number, Number, Number], BeforeValidator(row(3, "3 numbers [x, y, z]"))]
UnitVec3 = Annotated[Vec3, AfterValidator(_unit)]

_rgb = row(3, "3 numbers [r, g, b]")
RGB = Annotated[tuple[NonNegative, NonNegative, NonNegative], BeforeValidator(_rgb)]
Reflectance = Annotated[tuple[Fraction01, Fraction01, Fraction01], BeforeValidator(_rgb)]


# The base of everything a scene is described with.


def _take_as_given(schema: Any) -> None:
    """Let whole numbers and booleans be nothing else: no true for 1, no 3.0 for 3, no "yes" for true."""
    if isinstance(schema, dict):
        if schema.get("type") in ("int", "bool"):
            schema["strict"] = True
        for part in schema.values():
            _take_as_given(part)
    elif isinstance(schema, (list, tuple)):
        for part in schema:
            _take_as_given(part)


def _plain(value: Any) -> Any:
    """NumPy's arrays and scalars as Python's own."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


class Description(BaseModel):
    """An element of a scene, as its author wrote it: immutable, with known keys only.

    Raises SceneError with everything about it that cannot be used.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    # How many steps of a path name an element that messages speak about: shapes[3] is two, camera is one.
    ELEMENTS: ClassVar[Mapping[str, int]] = {}

    def __init__(self, **data: Any) -> None:
        data = {key: _plain(value) for key, value in data.items()}
        try:
            super().__init__(**data)
        except ValidationError as error:
            problems = diagnostics_of(error, data, type(self))
            raise SceneError("\n".join(problem.text for problem in problems)) from None

    # Tells Pydantic that a nested description needs no call of __init__, so that it can collect all errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # on a function

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        _take_as_given(handler.resolve_ref_schema(schema))
        return schema

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other values, checked like the first ones. Nothing computed from those comes along."""
        kept = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**(kept | dict(update or {})))
