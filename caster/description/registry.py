"""Registries of shapes and cameras, and plug-ins that add to them.

A plug-in is a module that calls `caster.shapes.SHAPES.register`, `caster.cameras.CAMERAS.register` or
`caster.aovs.register`. Programs import it; scenes also load every plug-in that an installed distribution names as an
entry point of the group "caster.plugins".
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import TypeVar

from caster.description.fields import Description

__all__ = ["load_plugins"]

Entry = TypeVar("Entry", bound=Description)


class Registry(list[type[Entry]]):
    """Classes of descriptions that scene files select by `type`, in the order of registration."""

    changed: Callable[[], None] = staticmethod(lambda: None)  # called after each change

    def __init__(self, *entries: type[Entry]) -> None:
        for entry in entries:
            self.register(entry)

    def register(self, entry: type[Entry]) -> type[Entry]:
        """Add a class; also a decorator. Raises ValueError for a class without `type`, or one whose `type` is taken."""
        field = entry.model_fields.get("type")
        if field is None or not isinstance(field.default, str):
            raise ValueError(
                f"{entry.__name__}: needs a field `type: Literal[NAME] = NAME` that scene files select it by"
            )
        if field.default in [each.model_fields["type"].default for each in self]:
            raise ValueError(f"{entry.__name__}: the type {field.default!r} is registered already")
        self.append(entry)
        self.changed()
        return entry


def load_plugins(group: str) -> None:
    """Import the modules of an entry-point group. Raises ImportError that names the plug-in."""
    for plugin in sorted(entry_points(group=group), key=lambda each: each.name):
        try:
            plugin.load()
        except Exception as error:
            origin = f" of {plugin.dist.name}" if plugin.dist is not None else ""
            raise ImportError(f"plug-in {plugin.name}{origin} ({plugin.value}): {error}") from error
