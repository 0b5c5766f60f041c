"""Reader of PLY files, binary and ascii: the elements `vertex` and `face` become a mesh; others are ignored.

The numbers of a text are converted to float64 first, so that one reader serves both kinds. The rows of an OFF
file are read as the same elements.
"""

import re
import struct
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.geometry.mesh_files.obj import quote_bytes, read_numbers
from caster.geometry.triangle_mesh import Floats, Mesh, format_row, triangle_fans

# Type names of the format as codes of NumPy and struct, without byte order.
TYPES = dict(
    re.findall(
        r"(\w+) (\w+)",
        """
        char b  uchar B  short h  ushort H  int i    uint I    float f    double d
        int8 b  uint8 B  int16 h  uint16 H  int32 i  uint32 I  float32 f  float64 d
        """,
    )
)
BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
NUMBER_OF_TEXT = "<d"
HEADER_LINE = re.compile(
    rf"""
    (?:comment|obj_info)\b.*|
    format\ (?P<encoding>{"|".join(BYTE_ORDERS)})\ 1\.0|
    element\ (?P<element>\S+)\ (?P<rows>\d{{1,18}})|
    property\ (?:list\ (?P<length>{"|".join(name for name, code in TYPES.items() if code not in "fd")})\ )?
        (?P<type>{"|".join(TYPES)})\ (?P<property>\S+)|
    (?P<end>end_header)|
    """,
    re.VERBOSE | re.ASCII,
)
HEADER_LINES = "format ascii, binary_little_endian or binary_big_endian 1.0; element NAME ROWS; property TYPE NAME; "
HEADER_LINES += f"property list WHOLE-NUMBER-TYPE TYPE NAME; comment or end_header (types: {', '.join(TYPES)})"


class Property(NamedTuple):
    """A number per row, or a list of numbers if `length` is set: the types of numbers and lengths, as of struct."""

    type: str
    length: str = ""


class Element(NamedTuple):
    """A table of `rows` rows."""

    name: str
    rows: int
    properties: dict[str, Property]


class Column(NamedTuple):
    """The values of a property in all rows in one array; of a list property also the number of values per row."""

    values: NDArray[Any]
    sizes: NDArray[np.int64] | None


class Table(NamedTuple):
    """The columns of an element by name."""

    where: str
    columns: dict[str, Column]
    lines: Sequence[int] = ()  # of the rows of a text

    def error(self, row: int, text: str) -> SceneError:
        """The error of a row."""
        return SceneError(f"{self.where}:{self.lines[row]}: {text}" if self.lines else f"{self.where}: {text}")


# ---- header ----


def _parse_header(data: bytes, where: str) -> tuple[str, dict[str, Element], int, int]:
    """(encoding, elements, offset of the body, its first line). Raises SceneError with `where`:line."""
    magic = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if magic is None:
        raise SceneError(f"{where}:1: PLY header: expected the line 'ply', got {quote_bytes(data[:8])}")
    newline = magic[1][-1:]  # the carriage return of \r\n counts as space
    encoding, elements = "", dict[str, Element]()
    start, line = magic.end(), 1
    while (stop := data.find(newline, start)) >= 0:
        line += 1
        text = " ".join(data[start:stop].decode("ascii", "backslashreplace").split())
        start = stop + 1
        found, expected = HEADER_LINE.fullmatch(text), ""
        if found is None:
            expected = HEADER_LINES
        elif found["end"]:
            return encoding or "ascii", elements, start, line + 1
        elif found.lastgroup and bool(encoding) == bool(found["encoding"]):
            expected = "one line with the format, before all elements"
        elif found["element"] in elements or (found["property"] and not elements):
            expected = "each element once, and before its properties"
        elif found["element"]:
            elements[found["element"]] = Element(found["element"], int(found["rows"]), {})
        elif found["property"]:
            properties = elements[next(reversed(elements))].properties
            expected = "each property of an element once" if found["property"] in properties else ""
            types = [found["type"], found["length"]] if found["length"] else [found["type"]]
            codes = [NUMBER_OF_TEXT] * len(types)
            if encoding != "ascii":
                codes = [BYTE_ORDERS[encoding] + TYPES[each] for each in types]
            properties[found["property"]] = Property(*codes)
        else:
            encoding = found["encoding"] or encoding
        if expected:
            raise SceneError(f"{where}:{line}: PLY header: expected {expected}, got '{text[:60]}'")
    raise SceneError(f"{where}:{line}: PLY header: truncated: expected 'end_header', got the end of the file")


# ---- body ----


def _read_tables(data: bytes, where: str) -> dict[str, Table]:
    """The tables of all elements. Raises SceneError."""
    encoding, elements, start, line = _parse_header(data, where)
    if encoding != "ascii":
        return _Body(data, start, where).read_all(elements.values())
    lines = ((n, words) for n, row in enumerate(data[start:].splitlines(), line) if (words := row.split()))
    rows = [(n, read_numbers(words, f"{where}:{n}")) for n, words in lines]
    return _Body.of_text(rows, where).read_all(elements.values())


@dataclass
class _Body:
    """The numbers of a file as bytes, read element by element."""

    data: bytes
    at: int
    where: str
    lines: Sequence[int] = ()  # of the rows of a text
    ends: NDArray[np.int64] | None = None  # where these rows end
    row: int = 0  # rows read so far

    @classmethod
    def of_text(cls, rows: list[tuple[int, list[float]]], where: str) -> Self:
        """The body of rows of numbers, each with its line."""
        numbers = np.fromiter(chain.from_iterable(row for _, row in rows), NUMBER_OF_TEXT)
        ends = numbers.itemsize * np.cumsum([len(row) for _, row in rows], dtype=np.int64)
        return cls(numbers.tobytes(), 0, where, [line for line, _ in rows], ends)

    def read_all(self, elements: Iterable[Element]) -> dict[str, Table]:
        """The tables of all elements, which end where the file does. Raises SceneError."""
        tables = {element.name: self._read(element) for element in elements}
        if self.at < len(self.data):
            more = f"{len(self.lines) - self.row} more rows" if self.lines else f"{len(self.data) - self.at} more bytes"
            raise SceneError(f"{self._place()}: expected the end of the file after the last element, got {more}")
        return tables

    def _read(self, element: Element) -> Table:
        """The next element, at once if all rows have the layout of the first. Raises SceneError."""
        if not element.properties and element.rows:
            raise SceneError(f"{self.where}: PLY header: expected properties of element '{element.name}', got none")
        if not element.properties:
            return Table(self.where, {})
        self.element, self.first, start = element, self.row, self.at
        numbers, properties = range(len(element.properties)), list(element.properties.values())
        sizes = [len(values) for values in self._next_row()] if element.rows else [1] * len(properties)
        fields: list[Any] = []  # of a row; they are numbered, since properties may have any name
        for k, (p, size) in enumerate(zip(properties, sizes, strict=True)):
            fields += [(f"size{k}", p.length)] if p.length else []
            fields += [(f"value{k}", p.type, (size,))]
        layout = np.dtype(fields)
        count = min(element.rows, (len(self.data) - start) // layout.itemsize)
        rows = np.frombuffer(self.data, layout, count, start)
        ends = start + layout.itemsize * np.arange(1, count + 1)
        values: list[Any] = [rows[f"value{k}"].ravel() for k in numbers]
        counts: list[Any] = [np.full(count, size) for size in sizes]
        self.row, self.at = self.first, start
        if (
            count == element.rows
            and all((rows[f"size{k}"] == sizes[k]).all() for k in numbers if properties[k].length)
            and (self.ends is None or np.array_equal(ends, self.ends[self.first : self.first + count]))
        ):
            self.row, self.at = self.first + count, start + rows.nbytes
        else:
            values, counts = [array("d") for _ in numbers], [array("q") for _ in numbers]
            for _ in range(element.rows):
                for k, found in enumerate(self._next_row()):
                    values[k].extend(found)
                    counts[k].append(len(found))
        columns = {
            name: Column(np.asarray(values[k]), np.asarray(counts[k]) if properties[k].length else None)
            for k, name in enumerate(element.properties)
        }
        return Table(self.where, columns, self.lines[self.first : self.row])

    def _next_row(self) -> list[tuple[float, ...]]:
        """Read the values of each property in a row of the element."""
        row, at = [], self.at
        try:
            for name, p in self.element.properties.items():
                size = 1
                if p.length:
                    (size,) = struct.unpack_from(p.length, self.data, at)
                    at += struct.calcsize(p.length)
                    if not (0 <= size < 2**32 and size == int(size)):
                        raise self._error(f"a length >= 0 of list '{name}', got {size:g}")
                numbers = f"{p.type[0]}{int(size)}{p.type[1]}"
                row.append(struct.unpack_from(numbers, self.data, at))
                at += struct.calcsize(numbers)
        except struct.error:
            name, rows, whole = self.element.name, self.element.rows, self.row - self.first
            expected = f"expected {rows} rows of element '{name}', got {whole} whole ones"
            raise SceneError(f"{self._place()}: truncated: {expected} before the end of the file") from None
        if self.ends is not None and self.ends[self.row] != at:
            raise self._error(f"{(at - self.at) // 8} numbers, got {(self.ends[self.row] - self.at) // 8}")
        self.row, self.at = self.row + 1, at
        return row

    def _error(self, text: str) -> SceneError:
        return SceneError(
            f"{self._place()}: row {self.row - self.first} of element '{self.element.name}': expected {text}"
        )

    def _place(self) -> str:
        return f"{self.where}:{self.lines[self.row]}" if self.row < len(self.lines) else self.where


# ---- the elements as a mesh or spheres ----

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
CORNERS = ("vertex_indices", "vertex_index")


def parse_ply(data: bytes, where: str) -> Mesh:
    """Bytes of a PLY file -> Mesh, with the file's vertices in its order. Raises SceneError with `where`."""
    return _mesh_of(_read_tables(data, where), where)


def _mesh_of(tables: dict[str, Table], where: str) -> Mesh:
    for name in ("vertex", "face"):
        if name not in tables:
            got = ", ".join(tables) or "none"
            raise SceneError(f"{where}: expected elements vertex and face, got no '{name}' (but: {got})")
    vertex = tables["vertex"]
    vertices = _floats(vertex, POSITION)  # faces with a vertex that is not finite are rejected later
    normals = _finite(vertex, NORMAL) if any(name in vertex.columns for name in NORMAL) else None
    names = next((pair for pair in UV if all(name in vertex.columns for name in pair)), None)
    return Mesh(vertices, _faces(tables["face"], len(vertices)), normals, _finite(vertex, names) if names else None)


def parse_ply_spheres(data: bytes, where: str) -> tuple[Floats, Floats | None]:
    """Bytes of a PLY file -> its vertices (n, 3), and their property radius (n,) if they have it.

    Other elements and properties are ignored. Raises SceneError with `where`.
    """
    vertex = _read_tables(data, where).get("vertex", Table(where, {}))
    centers = _finite(vertex, POSITION)
    if not len(centers):
        raise SceneError(f"{where}: expected at least one row of an element 'vertex', got none")
    if "radius" not in vertex.columns:
        return centers, None
    radii = _floats(vertex, ("radius",))
    good = (np.isfinite(radii) & (radii > 0.0))[:, 0]
    _check_rows(vertex, radii, good, "radius of vertex {} must be a length > 0")
    return centers, radii[:, 0]


def _floats(table: Table, names: tuple[str, ...]) -> Floats:
    """(n, len(names)) of the columns `names`, all required."""
    columns = [table.columns.get(name) for name in names]
    scalars = [column.values for column in columns if column is not None and column.sizes is None]
    if len(scalars) < len(names):
        got = [name if column.sizes is None else f"{name}, a list" for name, column in table.columns.items()]
        expected = f"the properties {', '.join(names)} of element 'vertex'"
        raise SceneError(f"{table.where}: expected {expected}, a number each, got {', '.join(got) or 'none'}")
    return np.stack([np.asarray(column, np.float64) for column in scalars], axis=1)


def _finite(table: Table, names: tuple[str, ...]) -> Floats:
    rows = _floats(table, names)
    _check_rows(table, rows, np.isfinite(rows).all(axis=1), f"{', '.join(names)} of vertex {{}} must be finite numbers")
    return rows


def _check_rows(table: Table, rows: Floats, good: Any, text: str) -> None:
    """Raise SceneError for the first row that is not good; text: with {} for its number."""
    bad = np.flatnonzero(~good)
    if len(bad):
        got = format_row(rows[bad[0]]) if rows.shape[1] > 1 else f"{rows[bad[0], 0]:g}"
        raise table.error(bad[0], f"{text.format(bad[0])}, got {got} ({len(bad)} of {len(rows)} are wrong)")


def _faces(face: Table, count: int) -> NDArray[np.int32]:
    corners = next((face.columns[name] for name in CORNERS if name in face.columns), None)
    if corners is None or corners.sizes is None:
        got = ", ".join(face.columns) or "none"
        raise SceneError(f"{face.where}: expected a list {' or '.join(CORNERS)} of element 'face', got {got}")
    values, sizes = corners.values, corners.sizes
    for row in np.flatnonzero(sizes < 3)[:1]:
        raise face.error(row, f"face {row} needs at least 3 vertices, got {sizes[row]}")
    for bad in np.flatnonzero(~((values >= 0) & (values < count) & (values == np.floor(values))))[:1]:
        row = int(np.searchsorted(np.cumsum(sizes), bad, side="right"))
        raise face.error(
            row, f"face {row} must join vertices 0 to {count - 1} (the file has {count}), got {values[bad]:g}"
        )
    return values.astype(np.int32)[triangle_fans(sizes)]


# ---- OFF ----


def parse_off(data: bytes, where: str) -> Mesh:
    """Text of an OFF file -> Mesh; colours and normals are ignored. Raises SceneError with `where`:line.

    trimesh is not used, since it sorts polygons by their number of corners.
    """
    rows = [(n, words) for n, line in enumerate(data.splitlines(), 1) if (words := line.split(b"#")[0].split())]
    if not rows or not re.fullmatch(rb"(ST)?C?N?OFF", rows[0][1].pop(0)) or b"BINARY" in rows[0][1]:
        raise SceneError(f"{where}: expected an OFF file in text, which begins with OFF, COFF, NOFF or STOFF")
    (line, head), *rows = (rows if rows[0][1] else rows[1:]) or [(1, [])]
    counts = read_numbers(head[:2], f"{where}:{line}", int)
    if len(counts) < 2 or min(counts) < 0:
        raise SceneError(f"{where}:{line}: expected numbers of vertices and faces, got {quote_bytes(b' '.join(head))}")
    vertices, faces = counts
    numbers = [(line, read_numbers(words, f"{where}:{line}")) for line, words in rows[: vertices + faces]]
    points = [(line, row[:3]) for line, row in numbers[:vertices]]
    polygons = [(line, row[: 1 + int(row[0])] if 0 <= row[0] < len(row) else row) for line, row in numbers[vertices:]]
    vertex = Element("vertex", vertices, dict.fromkeys(POSITION, Property(NUMBER_OF_TEXT)))
    face = Element("face", faces, {CORNERS[0]: Property(NUMBER_OF_TEXT, NUMBER_OF_TEXT)})
    return _mesh_of(_Body.of_text([*points, *polygons], where).read_all([vertex, face]), where)
