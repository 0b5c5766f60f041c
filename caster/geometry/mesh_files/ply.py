"""Reader of PLY files, binary and ascii: the elements `vertex` and `face` become a mesh; others are ignored."""

import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.geometry.mesh_files.plain_text import read_plain_lists, read_plain_rows
from caster.geometry.triangle_mesh import Floats, Mesh, format_row, triangle_fans
from caster.jit.kernel_cache import COMPILED

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


# ---- binary bodies ----


def read_binary(data: bytes, header: Header, where: str) -> dict[str, Table]:
    """The tables of all elements. Raises SceneError if the body is too short or too long."""
    at = header.end
    tables = {}
    for element in header.elements:
        body = _Body(data, element, header.byte_order, where)
        columns, at = body.read_at_once(at) or body.read_rows(at)
        tables[element.name] = Table(columns, None)
    if at < len(data):
        more = len(data) - at
        raise SceneError(f"{where}: expected the end after the last element, got {more} more bytes")
    return tables


class _Body:
    """The bytes of one element."""

    def __init__(self, data: bytes, element: Element, byte_order: str, where: str) -> None:
        self.data, self.element, self.where = data, element, where
        self.types = [np.dtype(byte_order + p.type) for p in element.properties]
        self.count_types = [np.dtype(byte_order + (p.count_type or "u1")) for p in element.properties]

    def read_at_once(self, at: int) -> tuple[Columns, int] | None:
        """All rows at once if all lists have the length of the first row's; else None."""
        count = self.element.rows
        sizes = self._row(at, 0)[1] if count else [0] * len(self.types)
        row = self._row_type(sizes)
        end = at + count * row.itemsize
        if end > len(self.data):
            return None
        table = np.frombuffer(self.data, row, count, at) if count else np.empty(0, row)
        columns: Columns = {}
        for k, p in enumerate(self.element.properties):
            values = table[f"value{k}"]
            if p.count_type and not np.all(table[f"size{k}"] == sizes[k]):
                return None
            columns[p.name] = Lists(np.full(count, sizes[k]), values.ravel()) if p.count_type else values
        return columns, end

    def _row_type(self, sizes: list[int]) -> np.dtype[np.void]:
        """NumPy type of one row. Fields are numbered, since properties may have any name."""
        fields: list[tuple[str, np.dtype[np.generic], tuple[int, ...]]] = []
        for k, p in enumerate(self.element.properties):
            if p.count_type:
                fields.append((f"size{k}", self.count_types[k], ()))
            fields.append((f"value{k}", self.types[k], (sizes[k],) if p.count_type else ()))
        return np.dtype(fields)

    def read_rows(self, at: int) -> tuple[Columns, int]:
        """Row by row: the length of a list determines the offset of the next property."""
        chunks: list[list[bytes]] = [[] for _ in self.types]
        sizes: list[list[int]] = [[] for _ in self.types]
        for row in range(self.element.rows):
            starts, lengths, at = self._row(at, row)
            for k, start in enumerate(starts):
                chunks[k].append(self.data[start : start + lengths[k] * self.types[k].itemsize])
                sizes[k].append(lengths[k])
        columns: Columns = {}
        for k, p in enumerate(self.element.properties):
            values = np.frombuffer(b"".join(chunks[k]), self.types[k])
            columns[p.name] = Lists(np.array(sizes[k], np.int64), values) if p.count_type else values
        return columns, at

    def _row(self, at: int, row: int) -> tuple[list[int], list[int], int]:
        """(offsets of the values of each property, their counts, end of the row)."""
        starts, sizes = [], []
        for k, p in enumerate(self.element.properties):
            size = 1
            if p.count_type:
                size = self._size(at, k, row, p)
                at += self.count_types[k].itemsize
            starts.append(at)
            sizes.append(size)
            at += size * self.types[k].itemsize
        if at > len(self.data):
            raise self._truncated(row)
        return starts, sizes, at

    def _size(self, at: int, k: int, row: int, p: Property) -> int:
        type_ = self.count_types[k]
        raw = self.data[at : at + type_.itemsize]
        if len(raw) < type_.itemsize:
            raise self._truncated(row)
        size = int.from_bytes(raw, "big" if type_.str[0] == ">" else "little", signed=type_.kind == "i")
        if size < 0:
            raise SceneError(
                f"{self.where}: row {row} of element '{self.element.name}': list '{p.name}' "
                f"must have a length >= 0, got {size}"
            )
        return size

    def _truncated(self, row: int) -> SceneError:
        return SceneError(
            f"{self.where}: truncated: expected {self.element.rows} rows of element '{self.element.name}', "
            f"got {row} whole ones before the end of the file ({len(self.data)} bytes)"
        )


# ---- ascii bodies: one line per row; all numbers are float64, exact up to 2^53 ----


class _Line(NamedTuple):
    number: int
    words: list[bytes]


def read_ascii(data: bytes, header: Header, where: str) -> dict[str, Table]:
    """The tables of all elements. Raises SceneError with `where`:line."""
    return _read_plain(data, header) or read_any_ascii(data, header, where)


def _read_plain(data: bytes, header: Header) -> dict[str, Table] | None:
    """The same by kernels, for rows of numbers or of a single list, one line each; None otherwise."""
    if not COMPILED:
        return None
    at, line, tables = header.end, header.end_line, {}
    for element in header.elements:
        lines = range(line, line + element.rows)
        found = _plain_columns(data, at, element)
        if found is None:
            return None
        tables[element.name], at, line = Table(found[0], lines), found[1], line + element.rows
    return tables if not data[at:].strip() else None


def _plain_columns(data: bytes, at: int, element: Element) -> tuple[Columns, int] | None:
    properties = element.properties
    if element.rows * len(properties) > len(data) - at:  # more than the file holds: nothing is allocated
        return None
    if not any(p.count_type for p in properties):
        rows = read_plain_rows(data, at, element.rows, len(properties))
        return None if rows is None else ({p.name: rows[0][:, k] for k, p in enumerate(properties)}, rows[1])
    lists = read_plain_lists(data, at, element.rows) if len(properties) == 1 else None
    return None if lists is None else ({properties[0].name: Lists(lists[0], lists[1])}, lists[2])


def read_any_ascii(data: bytes, header: Header, where: str) -> dict[str, Table]:
    """The same in Python, line by line."""
    numbered = enumerate(data[header.end :].splitlines(), header.end_line)
    lines = [_Line(number, words) for number, text in numbered if (words := text.split())]
    start = 0
    tables = {}
    for element in header.elements:
        rows = lines[start : start + element.rows]
        if len(rows) < element.rows:
            expected = f"{element.rows} rows of element '{element.name}'"
            raise SceneError(f"{where}: truncated: expected {expected}, got {len(rows)}")
        tables[element.name] = _table(rows, element, where)
        start += element.rows
    if start < len(lines):
        place, got = f"{where}:{lines[start].number}", _text(lines[start])
        raise SceneError(f"{place}: expected the end of the file after the last element, got {got}")
    return tables


def _table(rows: list[_Line], element: Element, where: str) -> Table:
    numbers = _numbers(rows, where)
    read = _with_lists if any(p.count_type for p in element.properties) else _scalars
    return Table(read(rows, numbers, element, where), [row.number for row in rows])


def _numbers(rows: list[_Line], where: str) -> list[float]:
    try:
        return [_number(word) for row in rows for word in row.words]
    except ValueError:
        bad = next(row for row in rows if not _is_numeric(row))
        raise SceneError(f"{where}:{bad.number}: expected numbers, got {_text(bad)}") from None


def _number(word: bytes) -> float:
    if b"_" in word:  # Python accepts 1_000
        raise ValueError
    return float(word)


def _is_numeric(row: _Line) -> bool:
    try:
        return bool([_number(word) for word in row.words])
    except ValueError:
        return False


def _scalars(rows: list[_Line], numbers: list[float], element: Element, where: str) -> Columns:
    width = len(element.properties)
    for row in rows:
        if len(row.words) != width:
            raise _wrong_width(row, element, width, where)
    table = np.array(numbers, np.float64).reshape(len(rows), width)
    return {p.name: table[:, k] for k, p in enumerate(element.properties)}


def _with_lists(rows: list[_Line], numbers: list[float], element: Element, where: str) -> Columns:
    """Row by row: the length of a list determines the offset of the next property."""
    found: dict[str, list[float]] = {p.name: [] for p in element.properties}
    sizes: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_type}
    at = 0
    for row in rows:
        end = at + len(row.words)
        for p in element.properties:
            size = 1
            if p.count_type:
                size = _size(numbers, at, end, row, p, where)
                sizes[p.name].append(size)
                at += 1
            found[p.name] += numbers[at : at + size]
            at += size
        if at != end:
            raise _wrong_width(row, element, len(row.words) + at - end, where)
    return {name: _column(values, sizes.get(name)) for name, values in found.items()}


def _column(values: list[float], sizes: list[int] | None) -> Column | Lists:
    column = np.array(values, np.float64)
    return column if sizes is None else Lists(np.array(sizes, np.int64), column)


def _size(numbers: list[float], at: int, end: int, row: _Line, p: Property, where: str) -> int:
    """The length of the list at `at`, an integer not beyond the rest of the line."""
    size = numbers[at] if at < end else 0.0
    if at < end and 0.0 <= size <= end - at - 1 and size.is_integer():
        return int(size)
    expected = f"list '{p.name}' to be its length and as many values"
    raise SceneError(f"{where}:{row.number}: expected {expected}, got {_text(row)}")


def _wrong_width(row: _Line, element: Element, width: int, where: str) -> SceneError:
    return SceneError(
        f"{where}:{row.number}: expected {width} numbers for a row of element '{element.name}', "
        f"got {len(row.words)}: {_text(row)}"
    )


def _text(row: _Line) -> str:
    return repr(b" ".join(row.words)[:60].decode("ascii", "backslashreplace"))


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
    header = parse_header(data, where)
    tables = (read_binary if header.byte_order else read_ascii)(data, header, where)
    for name in ("vertex", "face"):
        if name not in tables:
            got = ", ".join(tables) or "none"
            raise SceneError(f"{where}: expected elements vertex and face, got no '{name}' (but: {got})")
    vertices = _floats(tables["vertex"], POSITION, where)
    return Mesh(
        vertices,
        _faces(tables["face"], len(vertices), where),
        _normals(tables["vertex"], where),
        _uv(tables["vertex"], where),
    )


def parse_ply_points(data: bytes, where: str) -> Points:
    """Bytes of a PLY file -> its vertices, and their property `radius`, if any. Raises SceneError with `where`.

    Other elements and properties are ignored.
    """
    header = parse_header(data, where)
    vertex = (read_binary if header.byte_order else read_ascii)(data, header, where).get("vertex")
    if vertex is None or not len(next(iter(vertex.columns.values()), ())):
        raise SceneError(f"{where}: expected at least one row of an element 'vertex', got none")
    points = _floats(vertex, POSITION, where)
    _check_rows(points, np.isfinite(points).all(axis=1), "vertex {} must be finite numbers", vertex, where)
    if "radius" not in vertex.columns:
        return Points(points, None)
    column = vertex.columns["radius"]
    if isinstance(column, Lists):
        raise SceneError(f"{where}: expected a number as property radius of element 'vertex', got a list")
    radii = np.asarray(column, np.float64)
    good = np.isfinite(radii) & (radii > 0.0)
    _check_rows(radii[:, None], good, "radius of vertex {} must be a length > 0", vertex, where)
    return Points(points, radii)


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
    scalars = [column for column in columns if isinstance(column, np.ndarray)]
    if len(scalars) < len(names):
        expected, got = ", ".join(names), ", ".join(table.columns)
        raise SceneError(f"{where}: expected the properties {expected} of element 'vertex', got {got}")
    rows = np.stack([np.asarray(column, np.float64) for column in scalars], axis=1)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad) and names != POSITION:  # faces with such a vertex are rejected later
        place, got = table.place(where, int(bad[0])), format_row(rows[bad[0]])
        raise SceneError(f"{place}: {', '.join(names)} of vertex {bad[0]} must be finite numbers, got {got}")
    return rows


def _normals(vertex: Table, where: str) -> Floats | None:
    return _floats(vertex, NORMAL, where) if any(name in vertex.columns for name in NORMAL) else None


def _uv(vertex: Table, where: str) -> Floats | None:
    names = next((pair for pair in UV if all(name in vertex.columns for name in pair)), None)
    return _floats(vertex, names, where) if names else None


def _faces(face: Table, count: int, where: str) -> NDArray[np.int32]:
    corners = next((c for name in CORNERS if isinstance(c := face.columns.get(name), Lists)), None)
    if corners is None:
        got = ", ".join(face.columns) or "none"
        raise SceneError(f"{where}: expected a list {' or '.join(CORNERS)} of element 'face', got {got}")
    _check_sizes(corners, face, where)
    _check_indices(corners, face, count, where)
    return corners.values.astype(np.int32)[triangle_fans(corners.sizes)]


def _check_sizes(corners: Lists, face: Table, where: str) -> None:
    bad = np.flatnonzero(corners.sizes < 3)
    if len(bad):
        place, got = face.place(where, int(bad[0])), corners.sizes[bad[0]]
        raise SceneError(f"{place}: face {bad[0]} needs at least 3 vertices, got {got}")


def _check_indices(corners: Lists, face: Table, count: int, where: str) -> None:
    values = corners.values
    bad = np.flatnonzero(~((values >= 0) & (values < count) & (values == np.floor(values))))
    if len(bad):
        row = int(np.searchsorted(np.cumsum(corners.sizes), bad[0], side="right"))
        limits = f"0 to {count - 1} (the file has {count})"
        place, got = face.place(where, row), f"{values[bad[0]]:g}"
        raise SceneError(f"{place}: face {row} must join vertices {limits}, got {got}")
