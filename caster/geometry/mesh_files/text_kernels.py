"""Numbers in text, one byte after the other: what mesh files hold many of.

Only plain text is read: `-1.25e-3` and the like, between blanks. Whatever else there is makes a reader give up, and the
file is then read slowly (caster/mesh_files), with the same numbers and with words for what is wrong.
"""

from typing import Any

import numpy as np

from caster.jit.decorators import inlined, jit

BLANK, TAB, NEWLINE, RETURN, HASH, SLASH = 32, 9, 10, 13, 35, 47
PLUS, MINUS, POINT, ZERO = 43, 45, 46, 48
PARSE_FAILED = -1

# Powers of ten that are float64 exactly.
POWERS_OF_TEN = np.array([float(10**k) for k in range(23)])
MAX_INT64_DIGITS = 18  # so that all of them are an int64
MAX_EXACT_INTEGER = 2**53

# hi and lo as `rounded` has them: q2 is off by less than 4 roundings of itself, and so little must not matter.
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
    """(x, sure): digits * 10^power correctly rounded, for 0 <= digits < 10^18 and |power| <= 22; or not sure of it."""
    if digits <= MAX_EXACT_INTEGER:
        return (float(digits) * powers[power] if power >= 0 else float(digits) / powers[-power]), True
    high = float(digits)
    low = float(digits - int(high))  # both of them, and their difference, are whole numbers that fit
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
    """Whether a word may end here."""
    return at_line_end(text, at) or text[at] == BLANK or text[at] == TAB


@inlined
def next_line(text: Any, at: int) -> int:
    """Where the line after this end of a line begins; PARSE_FAILED for a lone carriage return."""
    if at >= len(text):
        return at
    if text[at] == RETURN:
        at += 1
        if at >= len(text) or text[at] != NEWLINE:
            return PARSE_FAILED
    return at + 1


@inlined
def parse_integer(text: Any, at: int) -> Any:
    """(number, where it ends) of digits; PARSE_FAILED for none, or for more than 18."""
    start, number = at, 0
    while at < len(text) and ZERO <= text[at] <= ZERO + 9:
        number = number * 10 + (int(text[at]) - ZERO)
        at += 1
    return number, (at if 0 < at - start <= MAX_INT64_DIGITS else PARSE_FAILED)


@inlined
def parse_real(text: Any, at: int, powers: Any) -> Any:
    """(x, where it ends, sure of it); PARSE_FAILED as the end for what is no plain number."""
    negative = at < len(text) and text[at] == MINUS
    if at < len(text) and (text[at] == MINUS or text[at] == PLUS):
        at += 1
    digits, count, significant, power = 0, 0, 0, 0
    behind = False  # the point
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
    """Where the next line begins, if nothing but blanks is left of this one; else PARSE_FAILED."""
    at = skip_blanks(text, at)
    return next_line(text, at) if at_line_end(text, at) else PARSE_FAILED


@jit
def read_real_rows(text: Any, at: int, width: int, powers: Any, rows: Any, start: int, odd: Any) -> int:
    """Lines of `width` numbers into rows (n, width), n of them; return where the next line begins, or PARSE_FAILED.

    odd: (m, 3) int64 for numbers that have to be read with more care: odd[0, 0] counts them, each further row is its
    place in `rows` and where it begins and ends.
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
    """Write down a number that has to be read with more care; False if there is no room left."""
    n = odd[0, 0] + 1
    if n >= len(odd):
        return False
    odd[0, 0], odd[n, 0], odd[n, 1], odd[n, 2] = n, place, start, stop
    return True


@jit
def read_integer_lists(text: Any, at: int, sizes: Any, values: Any) -> int:
    """Lines of a count and so many whole numbers, len(sizes) of them; where the next line begins, or PARSE_FAILED."""
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


# The statements of an OBJ file that is plain text, in two passes: how many there are, then their numbers.


def code_of(word: bytes) -> int:
    return int.from_bytes(word, "little")


V, VT, VN, F = (code_of(word) for word in (b"v", b"vt", b"vn", b"f"))
IGNORED_KEYWORDS = tuple(code_of(word) for word in (b"o", b"g", b"s", b"usemtl", b"mtllib"))


@inlined
def read_keyword(text: Any, at: int) -> Any:
    """(code of the word that begins here, where it ends); PARSE_FAILED as the end for a long one."""
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
    """counts: v, vt, vn, f, and words after f. PARSE_FAILED where a statement is none of the common ones."""
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
    """The numbers of a statement, at least so many, into row[k]; where the line ends, or PARSE_FAILED."""
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
    """v, v/vt, v//vn or v/vt/vn into corner[n], counted from 0, -1 for none; where it ends, or PARSE_FAILED."""
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
        if c == 2 or (
            is_word_end(text, at) or text[at] == HASH
        ):  # v/ and v/vt/ are left to those who have words for it
            return PARSE_FAILED
    return at if is_word_end(text, at) or (at < len(text) and text[at] == HASH) else PARSE_FAILED


@jit
def read_obj(text: Any, powers: Any, counts: Any, rows: Any, sizes: Any, corners: Any, odd: Any) -> int:
    """Fill rows = (v, vt, vn), with odd = three of what `text.read_real_rows` has; PARSE_FAILED for what is not plain.

    sizes (f,): corners of each face; corners (words, 3): v, vt, vn of each, counted from 0, -1 for none.
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
