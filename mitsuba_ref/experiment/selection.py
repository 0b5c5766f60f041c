"""Selection of scenes or families by name and by expression."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

from caster.description.errors import SceneError, suggestion
from mitsuba_ref.runner.scene_selection import matching


class Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)


def select(items: Sequence[T], what: str, words: Sequence[str], expression: str | None) -> list[T]:
    """Items by name, or by the part of it before a dash; all of them without words. In the registry's order.

    what: "scene" or "family", for messages. Raises SceneError for a word that is neither, or an invalid expression.
    """
    names = [item.name for item in items]
    known = [*names, *(name.partition("-")[0] for name in names)]
    for word in words:
        if word not in known:
            raise SceneError(f"{what} '{word}': unknown{suggestion(word, known)} (known: {', '.join(names)})")
    matches = matching(expression)
    chosen = (item for item in items if not words or {item.name, item.name.partition("-")[0]} & set(words))
    return [item for item in chosen if matches(item.name)]
