"""Fast readers of well-formed text mesh files; None for any other file, which the Python readers then diagnose.

Kernels parse numbers and OBJ statements in bytes of text, in common syntax such as `-1.25e-3`, separated by blanks; of
anything else they return PARSE_FAILED. Both ways give the same bits (tests/unit/test_mesh_plain_text.py).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from caster.geometry.triangle_mesh import Floats
from caster.jit.decorators import inlined, jit
from caster.jit.kernel_cache import COMPILED

BLANK, TAB, NEWLINE, RETURN, HASH, SLASH = 32, 9, 10, 13, 35, 47
PLUS, MINUS, POINT, ZERO = 43, 45, 46, 48
PARSE_FAILED = -1

# Powers of ten that are exact in float64.
POWERS_OF_TEN = np.array([float(10**k) for k in range(23)])
MAX_INT64_DIGITS = 18  # decimal digits that fit an int64
MAX_EXACT_INTEGER = 2**53

# The error of `rest` in `round_decimal` is below 4 of its roundings; a change by that must not change the result.
DECIMAL_RELATIVE_ERROR = 2.0**-50

SPLITTER = 2.0**27 + 1.0


@inlined
def two_product(a: float, b: float) -> Any:
    """(p, e) with a * b = p + e exactly. Source: Dekker (1971)."""
    p = a * b
    c, d = SPLITTER * a, SPLITTER * b
    a_high, b_high = c - (c - a), d - (d - b)
    a_low, b_low = a - a_high, b - b_high
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def round_decimal(digits: int, power: int, powers: Any) -> Any:
    """(x, sure): digits * 10^power correctly rounded if sure, for 0 <= digits < 10^18 and |power| <= 22."""
    if digits <= MAX_EXACT_INTEGER:
        return (float(digits) * powers[power] if power >= 0 else float(digits) / powers[-power]), True
    high = float(digits)
    low = float(digits - int(high))  # both are integers within int64, and so is their difference
    if power >= 0:
        q, rest = two_product(high, powers[power])
        rest += low * powers[power]
    else:
        q = high / powers[-power]
        p, e = two_product(q, powers[-power])
        rest = (((high - p) - e) + low) / powers[-power]
    x = q + rest
    return x, q + rest * (1.0 - DECIMAL_RELATIVE_ERROR) == x == q + rest * (1.0 + DECIMAL_RELATIVE_ERROR)


@inlined
def skip_blanks(text: Any, at: int) -> int:
    while at < len(text) and (text[at] == BLANK or text[at] == TAB):
        at += 1
    return at


@inlined
def at_line_end(text: Any, at: int) -> bool:
    return at >= len(text) or text[at] == NEWLINE or text[at] == RETURN


@inlined
def is_word_end(text: Any, at: int) -> bool:
    """Whether the byte ends a word."""
    return at_line_end(text, at) or text[at] == BLANK or text[at] == TAB


@inlined
def next_line(text: Any, at: int) -> int:
    """Offset of the next line, from the end of a line; PARSE_FAILED for a lone carriage return."""
    if at >= len(text):
        return at
    if text[at] == RETURN:
        at += 1
        if at >= len(text) or text[at] != NEWLINE:
            return PARSE_FAILED
    return at + 1


@inlined
def parse_integer(text: Any, at: int) -> Any:
    """(number, end) of a run of digits; PARSE_FAILED for none or more than 18."""
    start, number = at, 0
    while at < len(text) and ZERO <= text[at] <= ZERO + 9:
        number = number * 10 + (int(text[at]) - ZERO)
        at += 1
    return number, (at if 0 < at - start <= MAX_INT64_DIGITS else PARSE_FAILED)


@inlined
def parse_real(text: Any, at: int, powers: Any) -> Any:
    """(x, end, sure): x is correctly rounded if sure; end is PARSE_FAILED for other syntax."""
    negative = at < len(text) and text[at] == MINUS
    if at < len(text) and (text[at] == MINUS or text[at] == PLUS):
        at += 1
    digits, count, significant, power = 0, 0, 0, 0
    behind = False  # the decimal point
    while at < len(text):
        c = int(text[at])
        if ZERO <= c <= ZERO + 9:
            significant += 1 if significant > 0 or c > ZERO else 0
            if significant <= MAX_INT64_DIGITS:
                digits = digits * 10 + (c - ZERO)
            count += 1
            power -= 1 if behind else 0
        elif c == POINT and not behind:
            behind = True
        else:
            break
        at += 1
    if count == 0:
        return 0.0, PARSE_FAILED, False
    if at < len(text) and (text[at] == 101 or text[at] == 69):  # e, E
        at += 1
        down = at < len(text) and text[at] == MINUS
        if at < len(text) and (text[at] == MINUS or text[at] == PLUS):
            at += 1
        exponent, at = parse_integer(text, at)
        if at == PARSE_FAILED:
            return 0.0, PARSE_FAILED, False
        exponent = min(exponent, 100_000)
        power += -exponent if down else exponent
    if significant > MAX_INT64_DIGITS or not -22 <= power <= 22:
        return 0.0, at, digits == 0
    x, sure = round_decimal(digits, power, powers)
    return (-x if negative else x), at, sure


@jit
def end_line(text: Any, at: int) -> int:
    """Offset of the next line if the rest of this one is blank, else PARSE_FAILED."""
    at = skip_blanks(text, at)
    return next_line(text, at) if at_line_end(text, at) else PARSE_FAILED


@jit
def read_real_rows(text: Any, at: int, width: int, powers: Any, rows: Any, start: int, odd: Any) -> int:
    """Parse n lines of `width` numbers into rows (n, width); offset of the next line, or PARSE_FAILED.

    odd: (m, 3) int64, the numbers that are not sure: odd[0, 0] is their count, each further row the index in `rows`,
    start and end of one.
    """
    for k in range(start, len(rows)):
        for c in range(width):
            at = skip_blanks(text, at)
            x, end, sure = parse_real(text, at, powers)
            if end == PARSE_FAILED or not is_word_end(text, end):
                return PARSE_FAILED
            if not sure and not record_uncertain(odd, k * width + c, at, end):
                return PARSE_FAILED
            rows[k, c] = x
            at = end
        at = end_line(text, at)
        if at == PARSE_FAILED:
            return PARSE_FAILED
    return at


@inlined
def record_uncertain(odd: Any, place: int, start: int, stop: int) -> bool:
    """Record a number that is not sure; False if the table is full."""
    n = odd[0, 0] + 1
    if n >= len(odd):
        return False
    odd[0, 0], odd[n, 0], odd[n, 1], odd[n, 2] = n, place, start, stop
    return True


@jit
def read_integer_lists(text: Any, at: int, sizes: Any, values: Any) -> int:
    """Parse len(sizes) lines of a count and as many integers; offset of the next line, or PARSE_FAILED."""
    used = 0
    for k in range(len(sizes)):
        size, at = parse_integer(text, skip_blanks(text, at))
        if at == PARSE_FAILED or used + size > len(values):
            return PARSE_FAILED
        sizes[k] = size
        for _ in range(size):
            if not is_word_end(text, at):
                return PARSE_FAILED
            values[used], at = parse_integer(text, skip_blanks(text, at))
            if at == PARSE_FAILED:
                return PARSE_FAILED
            used += 1
        at = end_line(text, at)
        if at == PARSE_FAILED:
            return PARSE_FAILED
    return at


# OBJ statements in two passes: counts, then numbers.


def code_of(word: bytes) -> int:
    return int.from_bytes(word, "little")


V, VT, VN, F = (code_of(word) for word in (b"v", b"vt", b"vn", b"f"))
IGNORED_KEYWORDS = tuple(code_of(word) for word in (b"o", b"g", b"s", b"usemtl", b"mtllib"))


@inlined
def read_keyword(text: Any, at: int) -> Any:
    """(code, end) of the word at `at`; end is PARSE_FAILED for a long one."""
    code, shift = 0, 0
    while not is_word_end(text, at) and text[at] != HASH:
        if shift > 48:
            return code, PARSE_FAILED
        code |= int(text[at]) << shift
        shift += 8
        at += 1
    return code, at


@inlined
def rest_of_line(text: Any, at: int) -> int:
    while not at_line_end(text, at):
        at += 1
    return next_line(text, at)


@jit
def count_obj(text: Any, counts: Any) -> int:
    """Count statements into counts (v, vt, vn, f, corners). PARSE_FAILED for an uncommon statement."""
    at = 0
    while at < len(text):
        at = skip_blanks(text, at)
        code, at = read_keyword(text, at)
        if at == PARSE_FAILED:
            return PARSE_FAILED
        if code == V:
            counts[0] += 1
        elif code == VT:
            counts[1] += 1
        elif code == VN:
            counts[2] += 1
        elif code == F:
            counts[3] += 1
            while not at_line_end(text, at) and text[at] != HASH:
                at = skip_blanks(text, at)
                counts[4] += 0 if is_word_end(text, at) or text[at] == HASH else 1
                while not is_word_end(text, at) and text[at] != HASH:
                    at += 1
        elif code != 0 and code not in IGNORED_KEYWORDS:
            return PARSE_FAILED
        at = rest_of_line(text, at)
        if at == PARSE_FAILED:
            return PARSE_FAILED
    return at


@inlined
def read_number_row(text: Any, at: int, least: int, powers: Any, row: Any, k: int, odd: Any) -> int:
    """Parse at least `least` numbers into row[k]; end of the line, or PARSE_FAILED."""
    width, count = row.shape[1], 0
    while True:
        at = skip_blanks(text, at)
        if at_line_end(text, at) or text[at] == HASH:
            return at if count >= least else PARSE_FAILED
        x, end, sure = parse_real(text, at, powers)
        if end == PARSE_FAILED or not (is_word_end(text, end) or text[end] == HASH):
            return PARSE_FAILED
        if count < width:
            row[k, count] = x
            if not sure and not record_uncertain(odd, k * width + count, at, end):
                return PARSE_FAILED
        count += 1
        at = end


@inlined
def read_corner(text: Any, at: int, counts: Any, corner: Any, n: int) -> int:
    """Parse v, v/vt, v//vn or v/vt/vn into corner[n], 0-based, -1 if absent; end, or PARSE_FAILED."""
    for c in range(3):
        corner[n, c] = -1
    for c in range(3):
        if c == 0 or not (at < len(text) and text[at] == SLASH):
            index, at = parse_integer(text, at)
            if at == PARSE_FAILED or not 1 <= index <= counts[c]:
                return PARSE_FAILED
            corner[n, c] = index - 1
        if not (at < len(text) and text[at] == SLASH):
            break
        at += 1
        if c == 2 or (is_word_end(text, at) or text[at] == HASH):  # v/ and v/vt/ are diagnosed by the Python reader
            return PARSE_FAILED
    return at if is_word_end(text, at) or (at < len(text) and text[at] == HASH) else PARSE_FAILED


@jit
def read_obj(text: Any, powers: Any, counts: Any, rows: Any, sizes: Any, corners: Any, odd: Any) -> int:
    """Parse all statements into rows = (v, vt, vn), with odd of `read_real_rows` for each; PARSE_FAILED for others.

    sizes (f,): corners per face; corners (words, 3): 0-based v, vt, vn, -1 if absent.
    """
    at, v, vt, vn, f, n = 0, 0, 0, 0, 0, 0
    while at < len(text):
        at = skip_blanks(text, at)
        code, at = read_keyword(text, at)
        if code == V:
            at = read_number_row(text, at, 3, powers, rows[0], v, odd[0])
            v += 1
        elif code == VT:
            at = read_number_row(text, at, 1, powers, rows[1], vt, odd[1])
            vt += 1
        elif code == VN:
            at = read_number_row(text, at, 3, powers, rows[2], vn, odd[2])
            vn += 1
        elif code == F:
            first = n
            at = skip_blanks(text, at)
            while not at_line_end(text, at) and text[at] != HASH:
                at = read_corner(text, at, counts, corners, n)
                if at == PARSE_FAILED:
                    return PARSE_FAILED
                n += 1
                at = skip_blanks(text, at)
            if n - first < 3:
                return PARSE_FAILED
            sizes[f] = n - first
            f += 1
        if at == PARSE_FAILED:
            return PARSE_FAILED
        at = rest_of_line(text, at)
        if at == PARSE_FAILED:
            return PARSE_FAILED
    return at


# ---- readers of arrays ----

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


def read_plain_lists(data: bytes, at: int, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64], int] | None:
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
