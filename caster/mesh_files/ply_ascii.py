"""The body of an ascii PLY file: one line a row. All numbers come out as float64, exact up to 2^53."""

from typing import NamedTuple

import numpy as np

from caster.fields import SceneError
from caster.kernels.compiling.kernel_cache import COMPILED
from caster.mesh_files.plain_text import read_plain_lists, read_plain_rows
from caster.mesh_files.ply_header import Element, Header, Property
from caster.mesh_files.ply_table import Column, Columns, Lists, Table


class _Line(NamedTuple):
    number: int
    words: list[bytes]


def read_ascii(data: bytes, header: Header, where: str) -> dict[str, Table]:
    """The tables of all elements. Raises SceneError with `where`:line."""
    return _read_plain(data, header) or read_any_ascii(data, header, where)


def _read_plain(data: bytes, header: Header) -> dict[str, Table] | None:
    """The same of rows of numbers, and of rows that are one list of whole numbers, a line each without a gap."""
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
    if not any(p.count_type for p in properties):
        rows = read_plain_rows(data, at, element.rows, len(properties))
        return None if rows is None else ({p.name: rows[0][:, k] for k, p in enumerate(properties)}, rows[1])
    lists = read_plain_lists(data, at, element.rows) if len(properties) == 1 else None
    return None if lists is None else ({properties[0].name: Lists(lists[0], lists[1])}, lists[2])


def read_any_ascii(data: bytes, header: Header, where: str) -> dict[str, Table]:
    """The same, line by line."""
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
    if b"_" in word:  # Python would read 1_000 as a thousand
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
    """Row by row, as the length of one list says where the next property starts."""
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
    """The length of the list that starts at `at`: a whole number that the rest of the line can hold."""
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
