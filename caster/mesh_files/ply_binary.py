"""The body of a binary PLY file. Rows of one size are read at once; otherwise row by row."""

import numpy as np

from caster.fields import SceneError
from caster.mesh_files.ply_header import Element, Header, Property
from caster.mesh_files.ply_table import Columns, Lists, Table


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
        """All rows, if they are there and their lists are as long as the first row's; else None."""
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
        """Fields are numbered, as properties may have any name."""
        fields: list[tuple[str, np.dtype[np.generic], tuple[int, ...]]] = []
        for k, p in enumerate(self.element.properties):
            if p.count_type:
                fields.append((f"size{k}", self.count_types[k], ()))
            fields.append((f"value{k}", self.types[k], (sizes[k],) if p.count_type else ()))
        return np.dtype(fields)

    def read_rows(self, at: int) -> tuple[Columns, int]:
        """Row by row, as the length of one list says where the next property starts."""
        chunks: list[list[bytes]] = [[] for _ in self.types]
        sizes: list[list[int]] = [[] for _ in self.types]
        for row in range(self.element.rows):
            starts, row_sizes, at = self._row(at, row)
            for k, start in enumerate(starts):
                chunks[k].append(self.data[start : start + row_sizes[k] * self.types[k].itemsize])
                sizes[k].append(row_sizes[k])
        columns: Columns = {}
        for k, p in enumerate(self.element.properties):
            values = np.frombuffer(b"".join(chunks[k]), self.types[k])
            columns[p.name] = Lists(np.array(sizes[k], np.int64), values) if p.count_type else values
        return columns, at

    def _row(self, at: int, row: int) -> tuple[list[int], list[int], int]:
        """(where the values of each property start, how many they are, where the row ends)."""
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
