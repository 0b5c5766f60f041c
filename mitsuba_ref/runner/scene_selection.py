"""Selection of scenes by an expression over their names; files and folders: caster/cli/shared_arguments.py."""

import re
from collections.abc import Callable, Sequence

from caster.description.errors import SceneError

TOKENS = re.compile(r"\s*([()]|[^\s()]+)")

MAX_DEPTH = 50  # nested parentheses
MAX_SHOWN = 200  # characters of an expression in its error

Predicate = Callable[[str], bool]


def matching(expression: str | None) -> Predicate:
    """A predicate on names by an expression of parts of names, `and`, `or`, `not` and parentheses.

    Raises SceneError for a malformed expression.
    """
    if expression is None:
        return lambda name: True
    return _Reader(expression).read()


class _Reader:
    """Recursive descent: or of ands of nots of words."""

    def __init__(self, expression: str):
        self.expression = expression
        self.tokens: Sequence[str] = TOKENS.findall(expression)
        self.place, self.depth = 0, 0

    def read(self) -> Predicate:
        predicate = self._any()
        if self.place < len(self.tokens):
            raise self._error(f"'{self.tokens[self.place]}' is one too many")
        return predicate

    def _any(self) -> Predicate:
        choices = [self._all()]
        while self._take("or"):
            choices.append(self._all())
        return lambda name: any(choice(name) for choice in choices)

    def _all(self) -> Predicate:
        parts = [self._one()]
        while self._take("and"):
            parts.append(self._one())
        return lambda name: all(part(name) for part in parts)

    def _one(self) -> Predicate:
        negated = False
        while self._take("not"):
            negated = not negated
        inner = self._atom()
        return (lambda name: not inner(name)) if negated else inner

    def _atom(self) -> Predicate:
        if self._take("("):
            self.depth += 1
            if self.depth > MAX_DEPTH:
                raise self._error(f"more than {MAX_DEPTH} parentheses are nested")
            inner = self._any()
            self.depth -= 1
            if not self._take(")"):
                raise self._error("a ')' is missing")
            return inner
        if self.place >= len(self.tokens) or self.tokens[self.place] in ("and", "or", ")"):
            raise self._error("a part of a name is missing")
        word = self.tokens[self.place]
        self.place += 1
        return lambda name: word in name

    def _take(self, token: str) -> bool:
        taken = self.place < len(self.tokens) and self.tokens[self.place] == token
        self.place += taken
        return taken

    def _error(self, what: str) -> SceneError:
        return SceneError(
            f"-k {self.expression[:MAX_SHOWN]!r}: expected parts of names with and, or, not and parentheses; {what}"
        )
