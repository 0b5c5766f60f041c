"""The statements of an OBJ file that is plain text, in two passes: how many there are, then their numbers."""

from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.text import (
    GAVE_UP,
    HASH,
    SLASH,
    at_line_end,
    is_gap,
    next_line,
    note,
    real,
    skip_blanks,
    whole,
)


def code_of(word: bytes) -> int:
    return int.from_bytes(word, "little")


V, VT, VN, F = (code_of(word) for word in (b"v", b"vt", b"vn", b"f"))
OTHERS = tuple(code_of(word) for word in (b"o", b"g", b"s", b"usemtl", b"mtllib"))


@inlined
def keyword(text: Any, at: int) -> Any:
    """(code of the word that begins here, where it ends); GAVE_UP as the end for a long one."""
    code, shift = 0, 0
    while not is_gap(text, at) and text[at] != HASH:
        if shift > 48:
            return code, GAVE_UP
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
    """counts: v, vt, vn, f, and words after f. GAVE_UP where a statement is none of the common ones."""
    at = 0
    while at < len(text):
        at = skip_blanks(text, at)
        code, at = keyword(text, at)
        if at == GAVE_UP:
            return GAVE_UP
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
                counts[4] += 0 if is_gap(text, at) or text[at] == HASH else 1
                while not is_gap(text, at) and text[at] != HASH:
                    at += 1
        elif code != 0 and code not in OTHERS:
            return GAVE_UP
        at = rest_of_line(text, at)
        if at == GAVE_UP:
            return GAVE_UP
    return at


@inlined
def read_row(text: Any, at: int, least: int, powers: Any, row: Any, k: int, odd: Any) -> int:
    """The numbers of a statement, at least so many, into row[k]; where the line ends, or GAVE_UP."""
    width, count = row.shape[1], 0
    while True:
        at = skip_blanks(text, at)
        if at_line_end(text, at) or text[at] == HASH:
            return at if count >= least else GAVE_UP
        x, end, sure = real(text, at, powers)
        if end == GAVE_UP or not (is_gap(text, end) or text[end] == HASH):
            return GAVE_UP
        if count < width:
            row[k, count] = x
            if not sure and not note(odd, k * width + count, at, end):
                return GAVE_UP
        count += 1
        at = end


@inlined
def read_corner(text: Any, at: int, counts: Any, corner: Any, n: int) -> int:
    """v, v/vt, v//vn or v/vt/vn into corner[n], counted from 0, -1 for none; where it ends, or GAVE_UP."""
    for c in range(3):
        corner[n, c] = -1
    for c in range(3):
        if c == 0 or not (at < len(text) and text[at] == SLASH):
            index, at = whole(text, at)
            if at == GAVE_UP or not 1 <= index <= counts[c]:
                return GAVE_UP
            corner[n, c] = index - 1
        if not (at < len(text) and text[at] == SLASH):
            break
        at += 1
        if c == 2 or (
            is_gap(text, at) or text[at] == HASH
        ):  # v/ and v/vt/ are left to those who have words for it
            return GAVE_UP
    return at if is_gap(text, at) or (at < len(text) and text[at] == HASH) else GAVE_UP


@jit
def read_obj(text: Any, powers: Any, counts: Any, rows: Any, sizes: Any, corners: Any, odd: Any) -> int:
    """Fill rows = (v, vt, vn), with odd = three of what `text.read_reals` has; GAVE_UP for what is not plain.

    sizes (f,): corners of each face; corners (words, 3): v, vt, vn of each, counted from 0, -1 for none.
    """
    at, v, vt, vn, f, n = 0, 0, 0, 0, 0, 0
    while at < len(text):
        at = skip_blanks(text, at)
        code, at = keyword(text, at)
        if code == V:
            at = read_row(text, at, 3, powers, rows[0], v, odd[0])
            v += 1
        elif code == VT:
            at = read_row(text, at, 1, powers, rows[1], vt, odd[1])
            vt += 1
        elif code == VN:
            at = read_row(text, at, 3, powers, rows[2], vn, odd[2])
            vn += 1
        elif code == F:
            first = n
            at = skip_blanks(text, at)
            while not at_line_end(text, at) and text[at] != HASH:
                at = read_corner(text, at, counts, corners, n)
                if at == GAVE_UP:
                    return GAVE_UP
                n += 1
                at = skip_blanks(text, at)
            if n - first < 3:
                return GAVE_UP
            sizes[f] = n - first
            f += 1
        if at == GAVE_UP:
            return GAVE_UP
        at = rest_of_line(text, at)
        if at == GAVE_UP:
            return GAVE_UP
    return at
