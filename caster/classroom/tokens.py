"""A scene text as words, numbers and braces, each with its place."""

import math
import re
from typing import NamedTuple

from caster.locate import Span


class Token(NamedTuple):
    """A word, a number or a brace; line and column count from 1."""

    text: str
    line: int
    column: int

    @property
    def span(self) -> Span:
        return Span(self.line, self.column, len(self.text))

    @property
    def number(self) -> float | None:
        """None for what is no finite number."""
        try:
            value = float(self.text)
        except ValueError:
            return None
        return value if math.isfinite(value) and "_" not in self.text else None


def tokens_of(text: str) -> list[Token]:
    """All of them in order. A brace is one by itself, also where no space parts it from a number."""
    return [
        Token(found[0], number, found.start() + 1)
        for number, line in enumerate(text.split("\n"), 1)
        for found in re.finditer(r"[{}]|[^\s{}]+", line)
    ]
