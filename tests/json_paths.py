"""Every place of a JSON document."""

from collections.abc import Iterator
from typing import Any


def paths_of(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Of all values that hold no others, and of all lists and tables."""
    yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from paths_of(child, (*path, key))


def holder(value: Any, path: tuple[Any, ...]) -> Any:
    """The list or table that the value at a path is in."""
    for step in path[:-1]:
        value = value[step]
    return value
