"""What a 6.837 scene text is made of, once it is read: blocks, their fields, and faults with their places."""

from dataclasses import dataclass, field
from typing import NamedTuple

from caster.classroom.tokens import Token

START = Token("", 1, 1)


class Fault(NamedTuple):
    """What is wrong, and where."""

    at: Token
    text: str


class Field(NamedTuple):
    """A word and what follows it."""

    name: str
    at: Token
    numbers: tuple[float, ...]
    word: Token | None  # of a field that is a word

    @property
    def words(self) -> str:
        return " ".join(
            [self.name, *(f"{x:g}" for x in self.numbers), *([self.word.text] if self.word else [])]
        )


@dataclass
class Node:
    """A block: its fields and blocks in the order of the file."""

    kind: str
    at: Token
    items: list["Field | Node"] = field(default_factory=list)
    tried: set[str] = field(default_factory=set)  # names of fields that are there, also misspelt inside
    unknown: int = 0  # blocks of no kind that is known

    def get(self, name: str) -> Field | None:
        """The first field of that name."""
        return next((item for item in self.items if isinstance(item, Field) and item.name == name), None)

    def numbers(self, name: str, default: tuple[float, ...] = ()) -> tuple[float, ...]:
        found = self.get(name)
        return default if found is None else found.numbers

    @property
    def children(self) -> list["Node"]:
        return [item for item in self.items if isinstance(item, Node)]
