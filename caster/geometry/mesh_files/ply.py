"""Reader of PLY files, binary and ascii: the elements `vertex` and `face` become a mesh; others are ignored.

The numbers of an ascii body are converted to float64 first, so that one reader serves both kinds.
"""

import re
import struct
from functools import lru_cache
from typing import Any, NamedTuple

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
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
FORMATS = "ascii, binary_little_endian or binary_big_endian, and 1.0"


class Property(NamedTuple):
    """A number per row, or a list of numbers if `length` is set, the format of its length."""

    type: np.dtype[Any]
    length: struct.Struct | None


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
    """The columns of an element by name. lines: of the rows of an ascii file."""

    columns: dict[str, Column]
    lines: list[int]

    def place(self, where: str, row: int) -> str:
        """The position of a row for an error message."""
        return f"{where}:{self.lines[row]}" if self.lines else where


# ---- header ----


def _parse_header(data: bytes, where: str) -> tuple[str, dict[str, Element], int, int]:
    """(byte order, elements, offset of the body, its first line). Raises SceneError with `where`:line."""
    magic = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if magic is None:
        raise SceneError(f"{where}:1: PLY header: expected the line 'ply', got {quote_bytes(data[:8])}")
    newline = magic[1][-1:]  # the carriage return of \r\n counts as space
    formats: list[str] = []
    elements: dict[str, Element] = {}
    start, line = magic.end(), 1
    while (stop := data.find(newline, start)) >= 0:
        line += 1
        words = data[start:stop].decode("ascii", "backslashreplace").split()
        start = stop + 1
        if words == ["end_header"]:
            return (formats or ["ascii"])[0], elements, start, line + 1
        try:
            _add_header_line(words, formats, elements)
        except ValueError as error:
            raise SceneError(f"{where}:{line}: PLY header: {error}") from error
    raise SceneError(f"{where}:{line}: PLY header: truncated: expected 'end_header', got the end of the file")


def _add_header_line(words: list[str], formats: list[str], elements: dict[str, Element]) -> None:
    """Read one line of the header. Raises ValueError with expected and got."""
    match words:
        case [] | ["comment" | "obj_info", *_]:
            pass
        case ["format", encoding, "1.0"] if encoding in BYTE_ORDERS and not formats:
            formats.append(encoding)
        case ["format", *_]:
            raise ValueError(f"expected one format, {FORMATS}, got '{' '.join(words)[:60]}'")
        case ["element" | "property", *_] if not formats:
            raise ValueError(f"expected a format line ({FORMATS}) first, got '{' '.join(words)[:60]}'")
        case ["element", name, count]:
            if not (count.isascii() and count.isdigit() and len(count) < 19):  # 19 digits may pass 2^63
                raise ValueError(f"expected a number of rows of element '{name}', got '{count[:60]}'")
            if name in elements:
                raise ValueError(f"expected each element once, got '{name}' again")
            elements[name] = Element(name, int(count), {})
        case ["property", *types, name] if elements:
            element = next(reversed(elements.values()))
            if name in element.properties:
                raise ValueError(f"expected each property of '{element.name}' once, got '{name}' again")
            element.properties[name] = _property(types, formats[0])
        case _:
            raise ValueError(f"expected element, property, comment or end_header, got '{' '.join(words)[:60]}'")


def _property(types: list[str], encoding: str) -> Property:
    of_list = types[:1] == ["list"]
    codes = [TYPES.get(word, "") for word in types[of_list:]]
    if len(codes) != 1 + of_list or "" in codes or (of_list and codes[0] in "fd"):
        expected = f"a type ({', '.join(TYPES)}), or list, a whole-number type and a type"
        raise ValueError(f"expected {expected}, got '{' '.join(types)[:60]}'")
    forms = ["<d" if encoding == "ascii" else BYTE_ORDERS[encoding] + code for code in codes]
    return Property(np.dtype(forms[-1]), struct.Struct(forms[0]) if of_list else None)


# ---- body ----


def _read_tables(data: bytes, where: str) -> dict[str, Table]:
    """The tables of all elements. Raises SceneError."""
    encoding, elements, at, line = _parse_header(data, where)
    body = _ascii_body(data[at:], line, where) if encoding == "ascii" else _Body(data, at, where)
    tables = {name: body.read(element) for name, element in elements.items()}
    if body.at < len(body.data):
        more = f"{len(body.lines) - body.row} more rows" if body.lines else f"{len(data) - body.at} more bytes"
        raise SceneError(f"{body.place()}: expected the end of the file after the last element, got {more}")
    return tables


def _ascii_body(text: bytes, first_line: int, where: str) -> "_Body":
    rows = [(n, words) for n, row in enumerate(text.splitlines(), first_line) if (words := row.split())]
    numbers: list[float] = []
    for line, words in rows:
        numbers += read_numbers(words, f"{where}:{line}")
    body = _Body(np.array(numbers, "<f8").tobytes(), 0, where)
    body.lines, body.ends = [line for line, _ in rows], 8 * np.cumsum([len(words) for _, words in rows], dtype=np.int64)
    return body


class _Body:
    """The numbers of a file as bytes, read element by element."""

    def __init__(self, data: bytes, at: int, where: str) -> None:
        self.data, self.at, self.where = data, at, where
        self.row = 0  # rows read so far
        self.lines: list[int] = []  # of the rows of an ascii file
        self.ends: NDArray[np.int64] | None = None  # where these rows end

    def read(self, element: Element) -> Table:
        """The next element, at once if it is binary and its lists are equally long. Raises SceneError."""
        if not element.properties and element.rows:
            raise SceneError(f"{self.where}: PLY header: expected properties of element '{element.name}', got none")
        if not element.properties:
            return Table({}, [])
        first, start, properties = self.row, self.at, tuple(element.properties.values())
        sizes = self._next_row(element, first) if element.rows else (1,) * len(properties)
        layout = _layout(properties, sizes)
        number = min(element.rows, (len(self.data) - start) // layout.itemsize)
        rows = np.frombuffer(self.data, layout, number, start)
        values, lengths = (
            [rows[f"value{k}"].ravel() for k in range(len(sizes))],
            np.broadcast_to(sizes, (number, len(sizes))),
        )
        self.row, self.at = first + number, start + rows.nbytes
        lists = [k for k, p in enumerate(properties) if p.length]
        unlike = number < element.rows or any((rows[f"size{k}"] != sizes[k]).any() for k in lists)
        if element.rows and (unlike or self.ends is not None):
            self.row, self.at = first, start
            values, lengths = self._row_by_row(element)
        columns = {
            name: Column(values[k], lengths[:, k] if k in lists else None) for k, name in enumerate(element.properties)
        }
        return Table(columns, self.lines[first : self.row])

    def _row_by_row(self, element: Element) -> tuple[list[NDArray[Any]], NDArray[np.int64]]:
        """(the values of each property, their number in each row)."""
        first, starts, sizes, properties = self.row, [], [], tuple(element.properties.values())
        for _ in range(element.rows):
            starts.append(self.at)
            sizes.append(self._next_row(element, first))
        data, places, lengths = np.frombuffer(self.data, np.uint8), np.array(starts), np.array(sizes)
        ends = np.cumsum(lengths, axis=0)
        values = [np.empty(total, p.type) for total, p in zip(ends[-1], properties, strict=True)]
        for group in set(sizes):
            here, layout = (lengths == group).all(axis=1), _layout(properties, group)
            rows = np.stack([data[places[here] + i] for i in range(layout.itemsize)], axis=1).view(layout)[:, 0]
            for k, size in enumerate(group):
                values[k][(ends[here, k, None] - size) + np.arange(size)] = rows[f"value{k}"]
        return values, lengths

    def _next_row(self, element: Element, first: int) -> tuple[int, ...]:
        """Skip a row and return the number of values of each property. first: of the element's rows, for errors."""
        sizes, at = [], self.at
        for name, p in element.properties.items():
            size = 1
            if p.length:
                if at + p.length.size <= len(self.data):
                    (size,) = p.length.unpack_from(self.data, at)
                    if not (0 <= size < 2**32 and size == int(size)):
                        raise self._error(element, first, f"a length >= 0 of list '{name}', got {size:g}")
                at += p.length.size
            sizes.append(int(size))
            at += sizes[-1] * p.type.itemsize
        if at > len(self.data):
            expected = f"expected {element.rows} rows of element '{element.name}', got {self.row - first} whole ones"
            raise SceneError(f"{self.place()}: truncated: {expected} before the end of the file")
        if self.ends is not None and self.ends[self.row] != at:
            got = (self.ends[self.row] - self.at) // 8
            raise self._error(element, first, f"{(at - self.at) // 8} numbers, got {got}")
        self.row, self.at = self.row + 1, at
        return tuple(sizes)

    def _error(self, element: Element, first: int, text: str) -> SceneError:
        return SceneError(f"{self.place()}: row {self.row - first} of element '{element.name}': expected {text}")

    def place(self) -> str:
        return f"{self.where}:{self.lines[self.row]}" if self.row < len(self.lines) else self.where


@lru_cache(maxsize=64)
def _layout(properties: tuple[Property, ...], sizes: tuple[int, ...]) -> np.dtype[Any]:
    """The layout of a row; fields are numbered, since properties may have any name."""
    fields: list[Any] = []
    for k, (p, size) in enumerate(zip(properties, sizes, strict=True)):
        fields += [(f"size{k}", p.length.format)] if p.length else []
        fields += [(f"value{k}", p.type, (size,))]
    return np.dtype(fields)


# ---- the elements as a mesh or points ----

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
CORNERS = ("vertex_indices", "vertex_index")


class Points(NamedTuple):
    """Vertices of a file as centres of spheres."""

    centers: Floats  # (n, 3)
    radii: Floats | None  # (n,); None: the file has none


def parse_ply(data: bytes, where: str) -> Mesh:
    """Bytes of a PLY file -> Mesh, with the file's vertices in its order. Raises SceneError with `where`."""
    tables = _read_tables(data, where)
    for name in ("vertex", "face"):
        if name not in tables:
            got = ", ".join(tables) or "none"
            raise SceneError(f"{where}: expected elements vertex and face, got no '{name}' (but: {got})")
    vertex = tables["vertex"]
    vertices = _floats(vertex, POSITION, where)  # faces with a vertex that is not finite are rejected later
    normals = _floats(vertex, NORMAL, where) if any(name in vertex.columns for name in NORMAL) else None
    names = next((pair for pair in UV if all(name in vertex.columns for name in pair)), None)
    uv = _floats(vertex, names, where) if names else None
    for columns, rows in ((NORMAL, normals), (names or (), uv)):
        if rows is not None:
            good = np.isfinite(rows).all(axis=1)
            _check_rows(rows, good, f"{', '.join(columns)} of vertex {{}} must be finite numbers", vertex, where)
    return Mesh(vertices, _faces(tables["face"], len(vertices), where), normals, uv)


def parse_ply_points(data: bytes, where: str) -> Points:
    """Bytes of a PLY file -> its vertices, and their property `radius`, if any. Raises SceneError with `where`.

    Other elements and properties are ignored.
    """
    vertex = _read_tables(data, where).get("vertex")
    if vertex is None or not any(len(column.values) for column in vertex.columns.values()):
        raise SceneError(f"{where}: expected at least one row of an element 'vertex', got none")
    points = _floats(vertex, POSITION, where)
    _check_rows(points, np.isfinite(points).all(axis=1), "vertex {} must be finite numbers", vertex, where)
    if "radius" not in vertex.columns:
        return Points(points, None)
    radii = _floats(vertex, ("radius",), where)
    good = (np.isfinite(radii) & (radii > 0.0)).all(axis=1)
    _check_rows(radii, good, "radius of vertex {} must be a length > 0", vertex, where)
    return Points(points, radii[:, 0])


def parse_ply_columns(data: bytes, where: str, names: tuple[str, ...]) -> Floats:
    """Bytes of a PLY file -> these properties (n, len(names)) of element vertex, all finite. Raises SceneError."""
    vertex = _read_tables(data, where).get("vertex", Table({}, []))
    rows = _floats(vertex, names, where)
    _check_rows(rows, np.isfinite(rows).all(axis=1), "vertex {} must have finite numbers", vertex, where)
    return rows


def _check_rows(rows: Floats, good: Any, text: str, table: Table, where: str) -> None:
    """Raise SceneError for the first row that is not good; text: with {} for its number."""
    bad = np.flatnonzero(~good)
    if len(bad):
        got = format_row(rows[bad[0]]) if rows.shape[1] > 1 else f"{rows[bad[0], 0]:g}"
        place = table.place(where, int(bad[0]))
        raise SceneError(f"{place}: {text.format(bad[0])}, got {got} ({len(bad)} of {len(rows)} are wrong)")


def _floats(table: Table, names: tuple[str, ...], where: str) -> Floats:
    """(n, len(names)) of the columns `names`, all required."""
    columns = [table.columns.get(name) for name in names]
    scalars = [column.values for column in columns if column is not None and column.sizes is None]
    if len(scalars) < len(names):
        got = [name if column.sizes is None else f"{name}, a list" for name, column in table.columns.items()]
        expected = f"the properties {', '.join(names)} of element 'vertex'"
        raise SceneError(f"{where}: expected {expected}, a number each, got {', '.join(got)}")
    return np.stack([np.asarray(column, np.float64) for column in scalars], axis=1)


def _faces(face: Table, count: int, where: str) -> NDArray[np.int32]:
    corners = next((face.columns[name] for name in CORNERS if name in face.columns), None)
    if corners is None or corners.sizes is None:
        got = ", ".join(face.columns) or "none"
        raise SceneError(f"{where}: expected a list {' or '.join(CORNERS)} of element 'face', got {got}")
    values, sizes = corners.values, corners.sizes
    short = np.flatnonzero(sizes < 3)
    if len(short):
        row, text = int(short[0]), f"needs at least 3 vertices, got {sizes[short[0]]}"
        raise SceneError(f"{face.place(where, row)}: face {row} {text}")
    bad = np.flatnonzero(~((values >= 0) & (values < count) & (values == np.floor(values))))
    if len(bad):
        row = int(np.searchsorted(np.cumsum(sizes), bad[0], side="right"))
        text = f"must join vertices 0 to {count - 1} (the file has {count}), got {values[bad[0]]:g}"
        raise SceneError(f"{face.place(where, row)}: face {row} {text}")
    return values.astype(np.int32)[triangle_fans(sizes)]
