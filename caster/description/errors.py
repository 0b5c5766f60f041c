"""Exceptions for users, and the formatting of values in their messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic_core import PydanticCustomError

__all__ = ["FileMissing", "SceneError", "join_words", "suggestion"]


class SceneError(Exception):
    """An invalid description, file or ray. str() is the complete message for the user."""

    exit_code = 2


class FileMissing(SceneError):  # noqa: N818 - named after its subject
    """A missing or unreadable file."""

    exit_code = 4


MAX_VALUE_CHARACTERS = 60  # characters of one value in a message


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
    """'a, b or c'."""
    *most, end = names
    return f"{', '.join(most)} {last} {end}" if most else end


def field_error(text: str) -> PydanticCustomError:
    """The error that a field validator raises. The text continues after the field's name: 'must be ...'."""
    from pydantic_core import PydanticCustomError  # deferred, so that `--help` does not load it

    return PydanticCustomError("field", "{text}", {"text": text})


def expectation_error(expected: str, got: Any, hint: str = "") -> PydanticCustomError:
    """The field error 'must be EXPECTED, got GOT'."""
    return field_error(f"must be {expected}, got {format_value(got)}{hint}")
