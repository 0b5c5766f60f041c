"""The header of a PLY file, and the tables that its elements are read into."""

import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError

Column = NDArray[Any]  # one value per row


class Lists(NamedTuple):
    """A list property: number of values per row, and all values in one array."""

    sizes: NDArray[np.int64]
    values: Column


Columns = dict[str, Column | Lists]


class Table(NamedTuple):
    """The columns of an element by name; line numbers of rows for ascii files."""

    columns: Columns
    lines: Sequence[int] | None

    def place(self, where: str, row: int) -> str:
        """The position of a row for an error message."""
        return where if self.lines is None else f"{where}:{self.lines[row]}"


# Type names of the format as NumPy codes without byte order.
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
}  # fmt: skip
MAX_ELEMENTS, MAX_PROPERTIES = 64, 256  # of a file, of an element; scanners write some two and some thirty
ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
FORMATS = "ascii, binary_little_endian or binary_big_endian"


class Property(NamedTuple):
    """A scalar property, or a list property if count_type is set."""

    name: str
    type: str
    count_type: str | None = None


class Element(NamedTuple):
    """A table of `rows` rows of `properties`."""

    name: str
    rows: int
    properties: tuple[Property, ...]


class Header(NamedTuple):
    """byte_order: "" for ascii, else "<" or ">". The body starts at byte `end`, on line `end_line`."""

    byte_order: str
    elements: tuple[Element, ...]
    end: int
    end_line: int


def parse_header(data: bytes, where: str) -> Header:
    """Parse the header of PLY 1.0. Raises SceneError with `where`:line."""
    draft = _Draft()
    line = 0
    for line, end, words in _lines(data, where):
        try:
            if words[:1] == ["end_header"]:
                return draft.finish(end, line + 1)
            draft.add(words)
        except ValueError as error:
            raise SceneError(f"{where}:{line}: PLY header: {error}") from error
    raise SceneError(f"{where}:{line}: PLY header: truncated: expected 'end_header', got the end of the file")


def _lines(data: bytes, where: str) -> Iterator[tuple[int, int, list[str]]]:
    """(line number, offset after the line, words) of the lines after the magic line."""
    magic = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if magic is None:
        got = data[:8].decode("ascii", "backslashreplace")
        raise SceneError(f"{where}:1: PLY header: expected the line 'ply', got '{got}...'")
    newline = magic[1][-1:]  # of \r\n the carriage return counts as space
    start = magic.end()
    number = 1
    while (stop := data.find(newline, start)) >= 0:
        number += 1
        yield number, stop + 1, data[start:stop].decode("ascii", "backslashreplace").split()
        start = stop + 1


class _Draft:
    """State of the header parser. Methods raise ValueError with expected and got."""

    def __init__(self) -> None:
        self.byte_order: str | None = None
        self.elements: list[Element] = []

    def add(self, words: list[str]) -> None:
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", encoding, "1.0"] if encoding in ENCODINGS and self.byte_order is None:
                self.byte_order = ENCODINGS[encoding]
            case ["element", name, count]:
                self._add_element(name, count)
            case ["property", "list", count_type, type_, name]:
                self._add_property(Property(name, _type(type_), _count_type(count_type)))
            case ["property", type_, name]:
                self._add_property(Property(name, _type(type_)))
            case ["format", *_]:
                raise ValueError(f"expected one format, {FORMATS} and 1.0, got '{_joined(words)}'")
            case _:
                raise ValueError(f"expected element, property, comment or end_header, got '{_joined(words)}'")

    def finish(self, end: int, end_line: int) -> Header:
        if self.byte_order is None:
            raise ValueError(f"expected a format line ({FORMATS} and 1.0), got none")
        bare = [e.name for e in self.elements if e.rows and not e.properties]
        if bare:
            raise ValueError(f"expected properties of element '{bare[0]}', got none")
        return Header(self.byte_order, tuple(self.elements), end, end_line)

    def _add_element(self, name: str, count: str) -> None:
        if not (count.isascii() and count.isdigit() and len(count) < 19):  # 19 digits may pass 2^63
            raise ValueError(f"expected a number of rows of element '{name}', got '{count[:60]}'")
        if len(self.elements) == MAX_ELEMENTS:
            raise ValueError(f"expected at most {MAX_ELEMENTS} elements, got one more")
        if any(e.name == name for e in self.elements):
            raise ValueError(f"expected each element once, got '{name}' again")
        self.elements.append(Element(name, int(count), ()))

    def _add_property(self, new: Property) -> None:
        if not self.elements:
            raise ValueError(f"expected an element before the property '{new.name}', got none")
        last = self.elements[-1]
        if len(last.properties) == MAX_PROPERTIES:
            raise ValueError(f"expected at most {MAX_PROPERTIES} properties of '{last.name}', got one more")
        if any(p.name == new.name for p in last.properties):
            raise ValueError(f"expected each property of '{last.name}' once, got '{new.name}' again")
        self.elements[-1] = last._replace(properties=(*last.properties, new))


def _type(name: str) -> str:
    if name not in TYPES:
        raise ValueError(f"expected a type ({', '.join(TYPES)}), got '{name}'")
    return TYPES[name]


def _count_type(name: str) -> str:
    code = _type(name)
    if code.startswith("f"):
        raise ValueError(f"expected a whole-number type for the length of a list, got '{name}'")
    return code


def _joined(words: list[str]) -> str:
    return " ".join(words)[:60]
