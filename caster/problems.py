"""What is wrong with a scene: where in its data, and a sentence for the user."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pydantic import BaseModel

from caster.wording import show

Path = tuple[str | int, ...]
Model = type[BaseModel]

PLURAL = {"shape": "shapes", "light": "lights", "material": "materials", "check": "checks"}
SINGULAR = {many: one for one, many in PLURAL.items()}


class Problem(NamedTuple):
    """A sentence, and the path through the data, as it was written, to the value it is about."""

    path: Path
    text: str


def speak(path: Path, text: str, data: Any, model: Model) -> Problem:
    """'shapes[3] (disk "lid"): radius must be ...': the text goes on after the name of the value."""
    return Problem(path, _sentence(path, text, data, model))


def remark(path: Path, text: str, data: Any, model: Model) -> Problem:
    """'shapes[3] (disk "lid"): needs ...': about the table that the last step of the path is a key of."""
    return Problem(path, _sentence(path[:-1], text, data, model))


def spelled(path: Path) -> str:
    """to_world[1].rotate.axis"""
    steps = (f"[{step}]" if isinstance(step, int) else f".{_bare(step)}" for step in path)
    return "".join(steps).removeprefix(".")


def _bare(key: str) -> str:
    return key if key.replace("-", "_").isidentifier() else show(key)


def item_of(value: Any, step: str | int) -> Any:
    """The value one step down in data or in a description, None where there is none."""
    if isinstance(value, Mapping):
        return value.get(step)
    if isinstance(step, int):
        return value[step] if isinstance(value, (list, tuple)) and step < len(value) else None
    return getattr(value, step, None) if isinstance(value, BaseModel) else None


def _sentence(path: Path, text: str, data: Any, model: Model) -> str:
    depth = getattr(model, "ELEMENTS", {}).get(path[0], 0) if path else 0
    depth = depth if depth <= len(path) else 0
    name = spelled(path[depth:])
    return f"{_subject(path[:depth], data, model)}: {name}{' ' if name else ''}{text}"


def _subject(path: Path, data: Any, model: Model) -> str:
    """The element a message is about: shapes[3] (disk "lid")."""
    item = data
    for step in path:
        item = item_of(item, step)
    kind, name = item_of(item, "type"), item_of(item, "name")
    label = f" {show(name)}" if isinstance(name, str) and name else ""
    if not path:
        return model.__name__.lower() + label
    where = spelled((PLURAL.get(str(path[0]), path[0]), *path[1:]))
    details = f"{_bare(kind) if isinstance(kind, str) else ''}{label}".strip()
    return f"{where} ({details})" if details else where
