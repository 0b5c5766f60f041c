"""Errors in the words of the field: what was expected, what was found, what may have been meant."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic_core import PydanticCustomError

__all__ = ["FileMissing", "SceneError", "listed", "suggestion"]


class SceneError(Exception):
    """A description, file or ray that cannot be used. str() is the whole message for the user."""

    exit_code = 2


class FileMissing(SceneError):  # noqa: N818 - the file is the subject
    """A file that is missing or cannot be read."""

    exit_code = 4


MAX_VALUE_CHARACTERS = 60  # characters of one value in a message


def suggestion(name: str, known: Iterable[str]) -> str:
    """A question that ends a message: did you mean the known name most like this one? Else nothing."""
    close = get_close_matches(name, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def show(value: Any) -> str:
    """A value as a scene file would spell it, short enough for one line."""
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


def listed(names: Iterable[str], last: str = "or") -> str:
    """'a, b or c'."""
    *most, end = names
    return f"{', '.join(most)} {last} {end}" if most else end


def complain(text: str) -> PydanticCustomError:
    """What to raise in a check of one field. The text goes on where the field's name ends: 'must be ...'."""
    return PydanticCustomError("field", "{text}", {"text": text})


def refuse(expected: str, got: Any, hint: str = "") -> PydanticCustomError:
    """The usual complaint: 'must be ..., got ...'."""
    return complain(f"must be {expected}, got {show(got)}{hint}")
