"""Where in the text of a scene file a value is. Used only when there is an error to show."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

Path = tuple[str | int, ...]


class Span(NamedTuple):
    """Part of a line; line and column count characters from 1."""

    line: int
    column: int
    length: int


class Positions:
    """Where each value of a valid TOML or JSON text begins. A key stands for its value."""

    def __init__(self, text: str, kind: str) -> None:
        self._lines = text.encode().split(b"\n")
        tree = _tree(text, kind)
        found = [] if tree.has_error else list((_toml if kind == "toml" else _json)(tree))
        self._nodes = {path: (first, last) for path, first, last in found}
        for path, first, last in found:  # a table that has no header of its own begins with its first key
            for steps in range(1, len(path)):
                self._nodes.setdefault(path[:steps], (first, last))
        times = Counter(path for path, _, _ in found if isinstance(path[-1], str))
        again = {path: None for path, count in times.items() if count > 1}
        self.repeated = [path for path in again if not any(path[:n] in again for n in range(len(path)))]

    def of(self, path: Path) -> Span:
        """The span of a path through the data, or of the nearest table around it."""
        while path and path not in self._nodes:
            path = path[:-1]
        return self._span(*self._nodes[path]) if path else Span(1, 1, 1)

    def _span(self, first: Any, last: Any) -> Span:
        row, start = first.start_point
        end = last.end_point[1] if last.end_point[0] == row else len(self._lines[row])
        before, inside = self._lines[row][:start].decode(), self._lines[row][start:end].decode()
        return Span(row + 1, len(before) + 1, max(len(inside.rstrip("\r")), 1))


def _tree(text: str, kind: str) -> Any:
    import tree_sitter
    import tree_sitter_json
    import tree_sitter_toml

    grammar = tree_sitter_toml if kind == "toml" else tree_sitter_json
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    return parser.parse((text if kind == "toml" else _strict(text)).encode()).root_node


def _strict(text: str) -> str:
    """JSON without Python's NaN and Infinity, everything in its old place."""
    number = {"NaN": "111", "Infinity": "11111111"}
    return re.sub(r'"(?:[^"\\]|\\.)*"|NaN|Infinity', lambda found: number.get(found[0], found[0]), text)


Found = Iterator[tuple[Path, Any, Any]]  # a path, and the first and last node of what stands for it


def _toml(document: Any) -> Found:
    last: dict[Path, int] = {}  # index of the last table of each [[array]]
    for node in document.named_children:
        if node.type == "pair":
            yield from _toml_pair(node, ())
        elif node.type in ("table", "table_array_element"):
            header, *pairs = _without_comments(node)
            path = _header_path(_keys(header), node.type == "table_array_element", last)
            yield path, node, header.next_sibling  # with its brackets
            for pair in pairs:
                yield from _toml_pair(pair, path)


def _without_comments(node: Any) -> list[Any]:
    return [child for child in node.named_children if child.type != "comment"]


def _header_path(keys: list[str], is_array: bool, last: dict[Path, int]) -> Path:
    path: Path = ()
    for i, key in enumerate(keys):
        path = (*path, key)
        if is_array and i == len(keys) - 1:
            last[path] = last.get(path, -1) + 1
        if path in last:
            path = (*path, last[path])
    return path


def _keys(node: Any) -> list[str]:
    """The parts of a key, without quotes: a."b c".d is three."""
    table: Any = tomllib.loads(f"{node.text.decode()} = 0")
    keys = []
    while isinstance(table, dict):
        ((key, table),) = table.items()
        keys.append(key)
    return keys


def _toml_pair(pair: Any, path: Path) -> Found:
    key, value = _without_comments(pair)
    path = (*path, *_keys(key))
    yield path, key, key
    yield from _toml_inside(value, path)


def _toml_inside(value: Any, path: Path) -> Found:
    if value.type == "inline_table":
        for pair in _without_comments(value):
            yield from _toml_pair(pair, path)
    elif value.type == "array":
        for i, item in enumerate(_without_comments(value)):
            yield (*path, i), item, item
            yield from _toml_inside(item, (*path, i))


def _json(document: Any) -> Found:
    for value in document.named_children:
        yield from _json_inside(value, ())


def _json_inside(value: Any, path: Path) -> Found:
    if value.type == "object":
        for pair in value.named_children:
            key, item = pair.named_children
            inner = (*path, json.loads(key.text))
            yield inner, key, key
            yield from _json_inside(item, inner)
    elif value.type == "array":
        for i, item in enumerate(value.named_children):
            yield (*path, i), item, item
            yield from _json_inside(item, (*path, i))
