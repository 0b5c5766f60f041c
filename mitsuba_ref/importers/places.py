"""Where something stands in the files that were read, and what there is to say about it."""

from typing import NamedTuple

from caster.locate import Span
from caster.scene_text import shown


class Place(NamedTuple):
    """The start of an element; line and column count from 1."""

    file: str  # as its user or its include named it
    line: int
    column: int


class Remark(NamedTuple):
    """A sentence about a place: an error, or what was left out."""

    place: Place
    text: str

    def line(self) -> str:
        """ "file:line:column: left out: ..." """
        return f"{self.place.file}:{self.place.line}:{self.place.column}: left out: {self.text}"


def told(errors: list[Remark], texts: dict[str, str]) -> str:
    """All of them, each with the line itself. texts: by file."""
    return "\n".join(
        shown(Span(place.line, place.column, 1), text, texts.get(place.file, ""), place.file)
        for place, text in dict.fromkeys(errors)
    )
