"""Numbers in text, one byte after the other: what mesh files hold many of.

Only plain text is read: `-1.25e-3` and the like, between blanks. Whatever else there is makes a reader give up, and the
file is then read slowly (caster/mesh_files), with the same numbers and with words for what is wrong.
"""

from typing import Any

import numpy as np

from caster.kernels.jit import inlined, jit

BLANK, TAB, NEWLINE, RETURN, HASH, SLASH = 32, 9, 10, 13, 35, 47
PLUS, MINUS, POINT, ZERO = 43, 45, 46, 48
GAVE_UP = -1

# Powers of ten that are float64 exactly.
POWERS = np.array([float(10**k) for k in range(23)])
MOST_DIGITS = 18  # so that all of them are an int64
EXACT = 2**53

# hi and lo as `rounded` has them: q2 is off by less than 4 roundings of itself, and so little must not matter.
SLACK = 2.0**-50

SPLITTER = 2.0**27 + 1.0


@inlined
def times(a: float, b: float) -> Any:
    """(p, e) with a * b = p + e exactly. Source: Dekker (1971)."""
    p = a * b
    c, d = SPLITTER * a, SPLITTER * b
    a_high, b_high = c - (c - a), d - (d - b)
    a_low, b_low = a - a_high, b - b_high
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def rounded(digits: int, power: int, powers: Any) -> Any:
    """(x, sure): digits * 10^power correctly rounded, for 0 <= digits < 10^18 and |power| <= 22; or not sure of it."""
    if digits <= EXACT:
        return (float(digits) * powers[power] if power >= 0 else float(digits) / powers[-power]), True
    high = float(digits)
    low = float(digits - int(high))  # both of them, and their difference, are whole numbers that fit
    if power >= 0:
        q, rest = times(high, powers[power])
        rest += low * powers[power]
    else:
        q = high / powers[-power]
        p, e = times(q, powers[-power])
        rest = (((high - p) - e) + low) / powers[-power]
    x = q + rest
    return x, q + rest * (1.0 - SLACK) == x == q + rest * (1.0 + SLACK)


@inlined
def skip_blanks(text: Any, at: int) -> int:
    while at < len(text) and (text[at] == BLANK or text[at] == TAB):
        at += 1
    return at


@inlined
def at_line_end(text: Any, at: int) -> bool:
    return at >= len(text) or text[at] == NEWLINE or text[at] == RETURN


@inlined
def is_gap(text: Any, at: int) -> bool:
    """Whether a word may end here."""
    return at_line_end(text, at) or text[at] == BLANK or text[at] == TAB


@inlined
def next_line(text: Any, at: int) -> int:
    """Where the line after this end of a line begins; GAVE_UP for a lone carriage return."""
    if at >= len(text):
        return at
    if text[at] == RETURN:
        at += 1
        if at >= len(text) or text[at] != NEWLINE:
            return GAVE_UP
    return at + 1


@inlined
def whole(text: Any, at: int) -> Any:
    """(number, where it ends) of digits; GAVE_UP for none, or for more than 18."""
    start, number = at, 0
    while at < len(text) and ZERO <= text[at] <= ZERO + 9:
        number = number * 10 + (int(text[at]) - ZERO)
        at += 1
    return number, (at if 0 < at - start <= MOST_DIGITS else GAVE_UP)


@inlined
def real(text: Any, at: int, powers: Any) -> Any:
    """(x, where it ends, sure of it); GAVE_UP as the end for what is no plain number."""
    negative = at < len(text) and text[at] == MINUS
    if at < len(text) and (text[at] == MINUS or text[at] == PLUS):
        at += 1
    digits, count, significant, power = 0, 0, 0, 0
    behind = False  # the point
    while at < len(text):
        c = int(text[at])
        if ZERO <= c <= ZERO + 9:
            significant += 1 if significant > 0 or c > ZERO else 0
            if significant <= MOST_DIGITS:
                digits = digits * 10 + (c - ZERO)
            count += 1
            power -= 1 if behind else 0
        elif c == POINT and not behind:
            behind = True
        else:
            break
        at += 1
    if count == 0:
        return 0.0, GAVE_UP, False
    if at < len(text) and (text[at] == 101 or text[at] == 69):  # e, E
        at += 1
        down = at < len(text) and text[at] == MINUS
        if at < len(text) and (text[at] == MINUS or text[at] == PLUS):
            at += 1
        exponent, at = whole(text, at)
        if at == GAVE_UP:
            return 0.0, GAVE_UP, False
        exponent = min(exponent, 100_000)
        power += -exponent if down else exponent
    if significant > MOST_DIGITS or not -22 <= power <= 22:
        return 0.0, at, digits == 0
    x, sure = rounded(digits, power, powers)
    return (-x if negative else x), at, sure


@jit
def end_line(text: Any, at: int) -> int:
    """Where the next line begins, if nothing but blanks is left of this one; else GAVE_UP."""
    at = skip_blanks(text, at)
    return next_line(text, at) if at_line_end(text, at) else GAVE_UP


@jit
def read_reals(text: Any, at: int, width: int, powers: Any, rows: Any, start: int, odd: Any) -> int:
    """Lines of `width` numbers into rows (n, width), n of them; return where the next line begins, or GAVE_UP.

    odd: (m, 3) int64 for numbers that have to be read with more care: odd[0, 0] counts them, each further row is its
    place in `rows` and where it begins and ends.
    """
    for k in range(start, len(rows)):
        for c in range(width):
            at = skip_blanks(text, at)
            x, end, sure = real(text, at, powers)
            if end == GAVE_UP or not is_gap(text, end):
                return GAVE_UP
            if not sure and not note(odd, k * width + c, at, end):
                return GAVE_UP
            rows[k, c] = x
            at = end
        at = end_line(text, at)
        if at == GAVE_UP:
            return GAVE_UP
    return at


@inlined
def note(odd: Any, place: int, start: int, stop: int) -> bool:
    """Write down a number that has to be read with more care; False if there is no room left."""
    n = odd[0, 0] + 1
    if n >= len(odd):
        return False
    odd[0, 0], odd[n, 0], odd[n, 1], odd[n, 2] = n, place, start, stop
    return True


@jit
def read_lists(text: Any, at: int, sizes: Any, values: Any) -> int:
    """Lines of a count and so many whole numbers, len(sizes) of them; where the next line begins, or GAVE_UP."""
    used = 0
    for k in range(len(sizes)):
        size, at = whole(text, skip_blanks(text, at))
        if at == GAVE_UP or used + size > len(values):
            return GAVE_UP
        sizes[k] = size
        for _ in range(size):
            if not is_gap(text, at):
                return GAVE_UP
            values[used], at = whole(text, skip_blanks(text, at))
            if at == GAVE_UP:
                return GAVE_UP
            used += 1
        at = end_line(text, at)
        if at == GAVE_UP:
            return GAVE_UP
    return at
