"""Text of scene files: parsing, positions of values, and excerpts for error messages."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from caster.description.errors import DataPath, Diagnostic, FileMissing, SceneError, diagnostics_of, error_prefix

__all__ = ["model_of_text"]

M = TypeVar("M", bound=BaseModel)


class Span(NamedTuple):
    """A range of characters in a line; line and column are 1-based."""

    line: int
    column: int
    length: int


class Positions:
    """The positions of all values in a valid TOML or JSON text; the position of a value is that of its key."""

    def __init__(self, text: str, kind: str) -> None:
        import tree_sitter
        import tree_sitter_json
        import tree_sitter_toml

        if kind == "json":  # whose grammar has no NaN and Infinity: numbers of the same length
            number = {"NaN": "111", "Infinity": "11111111"}
            words = r'"(?:[^"\\]|\\.)*"|NaN|Infinity'
            text = re.sub(words, lambda found: number.get(found[0], found[0]), text)
        self._lines = text.encode().split(b"\n")
        grammar = tree_sitter_toml if kind == "toml" else tree_sitter_json
        tree = tree_sitter.Parser(tree_sitter.Language(grammar.language())).parse(text.encode()).root_node
        found = () if tree.has_error else list(_located(tree))
        self._nodes = {path: (first, last) for path, first, last in found}
        for path, first, last in found:  # an implicit table begins at its first key
            for steps in range(1, len(path)):
                self._nodes.setdefault(path[:steps], (first, last))

    def of(self, path: DataPath) -> Span:
        """The span of a path through the data, or of the nearest enclosing table."""
        while path and path not in self._nodes:
            path = path[:-1]
        if not path:
            return Span(1, 1, 1)
        first, last = self._nodes[path]
        row, start = first.start_point
        end = last.end_point[1] if last.end_point[0] == row else len(self._lines[row])
        before, inside = self._lines[row][:start].decode(), self._lines[row][start:end].decode()
        return Span(row + 1, len(before) + 1, max(len(inside.rstrip("\r")), 1))


LocatedNodes = Iterator[tuple[DataPath, Any, Any]]  # a path, and the first and last node of its position


def _located(document: Any) -> LocatedNodes:
    last: dict[DataPath, int] = {}  # index of the last table of each [[array]]
    for node in _without_comments(document):
        if node.type == "pair":
            yield from _pair(node, ())
        elif node.type in ("table", "table_array_element"):
            header, *pairs = _without_comments(node)
            path = _header_path(_keys(header), node.type == "table_array_element", last)
            yield path, node, header.next_sibling  # with its brackets
            for pair in pairs:
                yield from _pair(pair, path)
        else:  # the value that is a JSON document
            yield from _inside(node, ())


def _without_comments(node: Any) -> list[Any]:
    return [child for child in node.named_children if child.type != "comment"]


def _header_path(keys: list[str], is_array: bool, last: dict[DataPath, int]) -> DataPath:
    path: DataPath = ()
    for i, key in enumerate(keys):
        path = (*path, key)
        if is_array and i == len(keys) - 1:
            last[path] = last.get(path, -1) + 1
        if path in last:
            path = (*path, last[path])
    return path


def _keys(node: Any) -> list[str]:
    """The parts of a dotted key, unquoted: three for a."b c".d."""
    if node.type == "bare_key":
        return [node.text.decode()]
    if node.type == "string":  # in JSON
        return [json.loads(node.text)]
    table: Any = tomllib.loads(f"{node.text.decode()} = 0")
    keys = []
    while isinstance(table, dict):
        ((key, table),) = table.items()
        keys.append(key)
    return keys


def _pair(pair: Any, path: DataPath) -> LocatedNodes:
    """A key with its value, in TOML or JSON, and what is inside it."""
    key, value = _without_comments(pair)
    path = (*path, *_keys(key))
    yield path, key, key
    yield from _inside(value, path)


def _inside(value: Any, path: DataPath) -> LocatedNodes:
    if value.type in ("inline_table", "object"):
        for pair in _without_comments(value):
            yield from _pair(pair, path)
    elif value.type == "array":
        for i, item in enumerate(_without_comments(value)):
            yield (*path, i), item, item
            yield from _inside(item, (*path, i))


MAX_LINE_CHARACTERS = 100  # of a line in an excerpt
MAX_ERRORS_LISTED = 50  # the others are only counted


MAX_KEY_PARTS = 32  # of a dotted key in TOML, whose parser takes time and memory by the square of them
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
LONG_KEY = re.compile(rf"(?m)^[ \t\[]*+{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_KEY_PARTS}}}")


def parse(text: str, kind: str, origin: str) -> Any:
    """Parse TOML or JSON. Raises SceneError."""
    long_key = LONG_KEY.search(text) if kind == "toml" else None
    if long_key:
        line = text.count("\n", 0, long_key.start()) + 1
        raise SceneError(f"{origin}:{line}: expected keys of at most {MAX_KEY_PARTS} parts, got more")
    try:
        if kind == "toml":
            return tomllib.loads(text)
        with error_prefix(origin):
            data = json.loads(text, object_pairs_hook=_table)
    except ValueError as error:
        raise SceneError(_syntax_error(error, text, kind, origin)) from None
    if isinstance(data, dict):
        data.pop("$schema", None)  # read by editors only
    return data


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        again = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise SceneError(f"not valid JSON: a table has the key '{again}' twice")
    return table


def model_of_text(model: type[M], text: str, kind: str, origin: str, context: Any = None) -> M:
    """The model that a TOML or JSON text describes. Raises SceneError with every error and its line."""
    try:
        data = parse(text, kind, origin)
        try:
            return model.model_validate(data, context=context)
        except ValidationError as error:
            raise located_error(diagnostics_of(error, data, model), Positions(text, kind).of, text, origin) from None
    except RecursionError:
        raise SceneError(f"{origin}: lists or tables are nested too deeply to be read") from None


def located_error(
    problems: Sequence[Diagnostic], place: Callable[[DataPath], Span], text: str, origin: str
) -> SceneError:
    """The first diagnostics, each with its line, and how many more; FileMissing if nothing else is wrong."""
    located = sorted(((place(each.path), each) for each in problems), key=lambda found: found[0])
    last = located[:MAX_ERRORS_LISTED][-1][0]
    messages = sorted((span, each.message()) for span, each in located if span <= last)
    lines = text.split("\n")
    excerpts = [format_excerpt(*found, lines, origin) for found in messages[:MAX_ERRORS_LISTED]]
    kind = FileMissing if all(each.missing for each in problems) else SceneError
    return kind(list_errors(excerpts, len(problems), origin))


def list_errors(errors: Sequence[str], count: int, origin: str) -> str:
    """The first of `count` errors, or notes, each on its lines, and how many more there are."""
    listed = [*errors[:MAX_ERRORS_LISTED]]
    if count > len(listed):
        listed.append(f"{origin}: and {count - len(listed)} more")
    return "\n".join(listed)


def _syntax_error(error: ValueError, text: str, kind: str, origin: str) -> str:
    lines = text.split("\n")
    found = re.fullmatch(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", str(error), re.DOTALL)
    if isinstance(error, json.JSONDecodeError):
        line, column, message = error.lineno, error.colno, error.msg
    elif found and found[2]:
        line, column, message = int(found[2]), int(found[3]), found[1]
    else:
        written = text.rstrip().split("\n")
        line, column, message = len(written), len(written[-1]) + 1, found[1] if found else str(error)
    hint = ": a number needs a digit before its point" if re.match(r"[+-]?\.\d", lines[line - 1][column - 1 :]) else ""
    sentence = f"not valid {kind.upper()}: {message[0].lower()}{message[1:]}{hint}"
    return format_excerpt(Span(line, column, 1), sentence, lines, origin)


def format_excerpt(span: Span, sentence: str, lines: Sequence[str], origin: str) -> str:
    """`file:line:column: message`, followed by the line and a marker below the span; lines: of the whole text."""
    line = lines[span.line - 1].rstrip("\r") if span.line <= len(lines) else ""
    start = max(0, span.column - 1 - MAX_LINE_CHARACTERS // 2) if len(line) > MAX_LINE_CHARACTERS else 0
    part = line[start : start + MAX_LINE_CHARACTERS]
    before = re.sub(r"[^\t]", " ", line[start : span.column - 1])  # tabs are kept for alignment
    marks = "^" * min(span.length, max(len(part) - len(before), 1))
    number = f"{span.line:3}"
    head = f"{origin}:{span.line}:{span.column}: {sentence}"
    return f"{head}\n{number} | {part}\n{' ' * len(number)} | {before}{marks}"
