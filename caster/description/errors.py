"""Exceptions for users, and diagnostics of invalid scenes: paths into the data, messages, Pydantic's errors."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

__all__ = ["FileMissing", "SceneError", "error_prefix", "field_error", "suggestion"]

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic_core import PydanticCustomError

    Model = type[BaseModel]


class SceneError(Exception):
    """An invalid description, file or ray. str() is the complete message for the user."""

    exit_code = 2


class FileMissing(SceneError):  # noqa: N818 - named after its subject
    """A missing or unreadable file."""

    exit_code = 4


@contextlib.contextmanager
def error_prefix(*words: object) -> Iterator[None]:
    """Prefix SceneErrors raised by the body with their origin: an option with its values, or a file."""
    try:
        yield
    except SceneError as error:
        raise type(error)(f"{' '.join(map(str, words))}: {error}") from None


MAX_VALUE_CHARACTERS = 60  # of one value in a message


def suggestion(name: str, known: Iterable[str]) -> str:
    """The end of a message, ", did you mean 'x'?", for the most similar known name; "" if none is similar."""
    close = get_close_matches(name, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def format_value(value: Any) -> str:
    """A value in the syntax of scene files, truncated to one line."""
    text = _spelled(value, 3)
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[: MAX_VALUE_CHARACTERS - 4] + " ..."


def _spelled(value: Any, depth: int) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "nothing"}[value]
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if isinstance(value, str):
        return '"' + value.encode("unicode_escape").decode() + '"'
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, (list, tuple)):
        items = (_spelled(item, depth - 1) for item in value[:MAX_VALUE_CHARACTERS])
        return f"[{', '.join(items)}]" if depth else "[...]"
    if isinstance(value, int) and value.bit_length() > 128:
        return "a huge whole number"
    return str(value)


def join_words(names: Iterable[str], last: str = "or") -> str:
    """Names as text: 'a, b or c'."""
    *most, end = names
    return f"{', '.join(most)} {last} {end}" if most else end


def field_error(text: str, *path: str | int, missing_file: bool = False) -> PydanticCustomError:
    """The error that a validator raises. The text continues after the field's name: 'must be ...'.

    path: to the field, where the validator is of the whole description. missing_file: a file is missing or unreadable.
    """
    from pydantic_core import PydanticCustomError  # deferred, so that `--help` does not load it

    kind = "missing_file" if missing_file else "field"
    return PydanticCustomError(kind, "{text}", {"text": text, "path": path})


def expectation_error(expected: str, got: Any, *path: str, hint: str = "") -> PydanticCustomError:
    """The field error 'must be EXPECTED, got GOT'."""
    return field_error(f"must be {expected}, got {format_value(got)}{hint}", *path)


DataPath = tuple[str | int, ...]

PLURAL = {"shape": "shapes", "light": "lights", "material": "materials", "check": "checks"}
SINGULAR = {many: one for one, many in PLURAL.items()}


class Diagnostic(NamedTuple):
    """An error of the value at a path through the input data."""

    path: DataPath
    message: Callable[[], str]  # which compares names for suggestions: called for errors that are listed
    missing: bool = False  # a file is missing or unreadable


def format_path(path: DataPath) -> str:
    """A path as text: to_world[1].rotate.axis"""
    steps = (f"[{step}]" if isinstance(step, int) else f".{_bare(step)}" for step in path)
    return "".join(steps).removeprefix(".")


def _bare(key: str) -> str:
    return key if key.replace("-", "_").isidentifier() else format_value(key)


def child_of(value: Any, step: str | int) -> Any:
    """The child of a table, list or description; None if there is none."""
    if isinstance(value, Mapping):
        return value.get(step)
    if isinstance(step, int):
        return value[step] if isinstance(value, (list, tuple)) and step < len(value) else None
    return getattr(value, step, None) if hasattr(value, "model_fields_set") else None


def value_message(path: DataPath, text: str, data: Any, model: Model) -> str:
    """The message on one value: 'shapes[3] (disk "lid"): radius must be ...'; `text` follows the value's name."""
    depth = getattr(model, "ELEMENTS", {}).get(path[0], 0) if path else 0
    depth = depth if depth <= len(path) else 0
    element = data
    for step in path[:depth]:
        element = child_of(element, step)
    kind, name = child_of(element, "type"), child_of(element, "name")
    label = f" {format_value(name)}" if isinstance(name, str) and name else ""
    subject = model.__name__.lower() + label
    if depth:
        details = f"{_bare(kind) if isinstance(kind, str) else ''}{label}".strip()
        place = format_path((PLURAL.get(str(path[0]), path[0]), *path[1:depth]))
        subject = f"{place} ({details})" if details else place
    field = format_path(path[depth:])
    return f"{subject}: {field}{' ' if field else ''}{text}"


CROSS_ELEMENT_ERROR = "cross_element"  # type of the error of a check across several elements


def diagnostics_of(error: ValidationError, data: Any, model: Model) -> list[Diagnostic]:
    """All errors of a validation as diagnostics, and those of checks across elements."""
    found: dict[Any, Diagnostic] = {}
    for finding in error.errors(include_url=False):
        kind = finding["type"]
        if kind != CROSS_ELEMENT_ERROR:  # repeated below on the input data
            path = _path_of(finding, data)
            place = (*path, "type") if kind.startswith("union_tag") else path
            message = partial(_message_of, finding, path, data, model)
            found[place, kind] = Diagnostic(place, message, kind == "missing_file")  # Pydantic may report one twice
    return [*found.values(), *getattr(model, "problems_across", lambda _: [])(data)]


def _path_of(finding: Any, data: Any) -> DataPath:
    """Pydantic's error location without steps that the data does not have, such as the `type` of each union member."""
    path: DataPath = ()
    here = data
    for step in finding["loc"]:
        if isinstance(here, Mapping):
            found = step in here and step != here.get("type")
        else:
            found = isinstance(here, (list, tuple)) and isinstance(step, int)
        path, here = ((*path, step), child_of(here, step)) if found else (path, here)
    if finding["type"] in ("missing", "extra_forbidden") and path[-1:] != finding["loc"][-1:]:
        path = (*path, finding["loc"][-1])
    return (*path, *finding.get("ctx", {}).get("path", ()))


def _models_at(path: DataPath, data: Any, model: Model) -> tuple[Model, ...]:
    """The description classes that the value at a path may have."""
    models: tuple[Model, ...] = (model,)
    for step in path:
        data = child_of(data, step)
        fields = [field for each in models for name, field in each.model_fields.items() if step in (name, field.alias)]
        models = tuple(found for field in fields for found in _models_in(field.annotation)) or models
        models = tuple(each for each in models if _type_of(each) == child_of(data, "type")) or models
    return models


def _type_of(model: Model) -> Any:
    return model.model_fields["type"].default if "type" in model.model_fields else None


def _models_in(annotation: Any) -> tuple[Model, ...]:
    if isinstance(annotation, type) and hasattr(annotation, "model_fields"):
        return (annotation,)
    return tuple(found for part in get_args(annotation) for found in _models_in(part))


def _message_of(finding: Any, path: DataPath, data: Any, model: Model) -> str:
    """The message on a finding of Pydantic about the value at a path."""
    kind = finding["type"]
    if kind == "missing":
        return value_message(path[:-1], f"needs the key '{path[-1]}'", data, model)
    if kind == "extra_forbidden":
        fields = [each.model_fields.items() for each in _models_at(path[:-1], data, model)]
        known = [field.alias or name for items in fields for name, field in items]
        text = f"is an unknown key{suggestion(str(path[-1]), known)}"
    elif kind.startswith("union_tag"):
        known = [str(_type_of(each)) for each in _models_at(path, data, model)]
        noun = SINGULAR.get(str(path[0]), str(path[0])) if len(path) <= 2 else str(path[-1])
        got = child_of(finding["input"], "type")
        if got is None:
            text = f"needs the key 'type': {join_words(known)}"
        else:
            text = f"unknown {noun} type {format_value(got)}{suggestion(str(got), known)} (known: {', '.join(known)})"
    else:
        text = _text(kind, finding["input"], finding.get("ctx", {}))
    return value_message(path, text, data, model)


def _text(kind: str, got: Any, ctx: Mapping[str, Any]) -> str:
    """The message after the value's name."""
    if kind in ("field", "missing_file"):
        return str(ctx["text"])
    if kind == "value_error":  # raised by a validator of the whole description
        return str(ctx["error"])
    if kind == "literal_error":
        words = str(ctx["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        return f"must be {join_words(map(format_value, words))}, got {format_value(got)}{suggestion(str(got), words)}"
    if kind in LIMIT_SIGNS:
        (limit,) = ctx.values()
        return f"must be {LIMIT_SIGNS[kind]} {format_value(limit)}, got {format_value(got)}"
    return f"must be {EXPECTED_TYPES.get(kind, 'something else')}, got {format_value(got)}"


LIMIT_SIGNS = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}
EXPECTED_TYPES = {
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "a string",
    "string_unicode": "a string of Unicode characters",
    "tuple_type": "a list",
    "list_type": "a list",
    "too_short": "a list that is not empty",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
