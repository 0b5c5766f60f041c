"""Fast readers of well-formed text mesh files; None for any other file, which the Python readers then diagnose.

Both ways give the same bits (tests/unit/test_mesh_plain_text.py).
"""

import numpy as np
from numpy.typing import NDArray

from caster.geometry.mesh_files.text_kernels import (
    NEWLINE,
    PARSE_FAILED,
    POWERS_OF_TEN,
    count_obj,
    read_integer_lists,
    read_obj,
    read_real_rows,
)
from caster.geometry.triangle_mesh import Floats
from caster.jit.kernel_cache import COMPILED

MAX_UNCERTAIN_NUMBERS = 4096  # per kind; files with more are read in Python


class ObjArrays:
    """The statements of an OBJ file as arrays."""

    def __init__(self, counts: NDArray[np.int64]) -> None:
        v, vt, vn, f, words = counts.tolist()
        self.rows: tuple[Floats, Floats, Floats] = (np.empty((v, 3)), np.zeros((vt, 2)), np.empty((vn, 3)))
        self.sizes = np.empty(f, np.int64)
        self.corners = np.empty((words, 3), np.int64)  # 0-based v, vt, vn; -1 if absent


def read_plain_obj(data: bytes) -> ObjArrays | None:
    """Read an OBJ file with common statements only."""
    if not COMPILED or b"\\" in data:
        return None
    text, counts = np.frombuffer(data, np.uint8), np.zeros(5, np.int64)
    if count_obj(text, counts) == PARSE_FAILED:
        return None
    obj, odd = ObjArrays(counts), tuple(_uncertain_table() for _ in range(3))
    if read_obj(text, POWERS_OF_TEN, counts, obj.rows, obj.sizes, obj.corners, odd) == PARSE_FAILED:
        return None
    for rows, places in zip(obj.rows, odd, strict=True):
        _reparse_uncertain(data, rows, places)
    finite = all(np.isfinite(rows).all() for rows in obj.rows)
    return obj if finite else None


def read_plain_rows(data: bytes, at: int, count: int, width: int) -> tuple[Floats, int] | None:
    """Read `count` lines of `width` numbers; also returns the offset of the next line."""
    rows, odd = np.empty((count, width)), _uncertain_table()
    end = read_real_rows(np.frombuffer(data, np.uint8), at, width, POWERS_OF_TEN, rows, 0, odd)
    if end == PARSE_FAILED or end > len(data) or not _is_line_start(data, end):
        return None
    _reparse_uncertain(data, rows, odd)
    return rows, end


def read_plain_lists(
    data: bytes, at: int, count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int] | None:
    """Read `count` lines of a list: sizes, all values, and the offset of the next line."""
    sizes = np.empty(count, np.int64)
    values = np.empty((len(data) - at) // 2, np.int64)  # at least a digit and a blank each
    end = read_integer_lists(np.frombuffer(data, np.uint8), at, sizes, values)
    if end == PARSE_FAILED or not _is_line_start(data, end):
        return None
    return sizes, values[: sizes.sum()].copy(), end


def _is_line_start(data: bytes, at: int) -> bool:
    return at >= len(data) or data[at - 1] == NEWLINE


def _uncertain_table() -> NDArray[np.int64]:
    return np.zeros((MAX_UNCERTAIN_NUMBERS, 3), np.int64)


def _reparse_uncertain(data: bytes, rows: Floats, odd: NDArray[np.int64]) -> None:
    flat = rows.reshape(-1)
    for place, start, stop in odd[1 : odd[0, 0] + 1].tolist():
        flat[place] = float(data[start:stop])
