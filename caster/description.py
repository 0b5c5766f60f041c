"""The base of everything a scene is described with."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema

from caster.findings import problems_of
from caster.wording import SceneError


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
            problems = problems_of(error, data, type(self))
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
