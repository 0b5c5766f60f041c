"""Results as JSON files, and as text and tables for terminals and logs, in colour only on a terminal.

Results are pydantic dataclasses. Files also contain their derived values (`computed_field`), which are ignored when a
file is read.
"""

import json
import math
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, TextIO

import numpy as np
from pydantic import TypeAdapter

from caster.system.atomic_files import write_text
from caster.system.terminal import printable, unfiltered
from mitsuba_ref.reference.store import installed_version, machine
from mitsuba_ref.reference.variants import usable_variants

STANDARD_OUTPUT = "-"


def as_json(result: Any) -> dict[str, Any]:
    """The result as plain data, derived values included."""
    data: dict[str, Any] = TypeAdapter(type(result)).dump_python(result, mode="json")
    return data


def write_result(result: Any, file: str) -> None:
    """Write the JSON of a result. Raises OutputError."""
    text = json.dumps(as_json(result), indent=1, allow_nan=False) + "\n"
    if file == STANDARD_OUTPUT:
        sys.stdout.write(text)
    else:
        write_text(file, text)


def versions(*packages: str) -> dict[str, str]:
    """Versions of packages, Mitsuba's of the chosen interpreter; "none" where there is none."""
    return {name: machine().get(name) or installed_version(name) for name in packages}


def libllvm() -> str:
    """File name of the libLLVM that Mitsuba loads, or "none"."""
    library = usable_variants().libllvm
    return Path(library).name if library else "none"


def largest(values: np.ndarray) -> float | None:
    """The largest finite value; None if there is none."""
    finite = [value for value in values.tolist() if math.isfinite(value)]
    return max(finite, default=None)


# ---- text ----

STATUS_COLORS = {"PASS": "32", "FAIL": "1;31", "SKIP": "33", "KNOWN": "33"}  # codes of ANSI terminals


LINE_CHARACTERS = 80
LABEL = re.compile(r" *[a-z][\w. ]{0,11}: +")  # such as "exact:      ", below which further lines begin
COMMAND = re.compile(
    r" *(?:(?:replay|from|next|look|report): |mitsuba-ref |caster |pixel \()"
)  # stays whole, to be copied
POINTER = re.compile(r"[ |]*\^+ *$")  # below a place in a line of a scene file
BELOW_NAME = 6 * " "  # of a scene


def folded(text: str) -> str:
    """The text in lines of at most LINE_CHARACTERS, but for commands, words such as paths, and lines marked below."""
    lines = text.split("\n")
    marked = [POINTER.match(line) is not None for line in (*lines[1:], "")]
    return "\n".join(part for line, whole in zip(lines, marked, strict=True) for part in _folded(line, whole))


def _folded(line: str, whole: bool) -> list[str]:
    if whole or len(line) <= LINE_CHARACTERS or COMMAND.match(line):
        return [line]
    label = LABEL.match(line)
    indent = " " * label.end() if label else BELOW_NAME
    return wrap(line, LINE_CHARACTERS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def plural(count: int, noun: str) -> str:
    """A count and its noun, such as "1 scene" or "2 scenes"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def print_lines(text: str, stream: TextIO | None = None) -> None:
    """Print text at once, folded; on a terminal, the status at the start of a line in colour, but for NO_COLOR."""
    stream = stream or sys.stdout
    text = folded(printable(text))
    if stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb":
        stream = unfiltered(stream)
        for status, color in STATUS_COLORS.items():
            text = re.sub(rf"^{status}(?![^ \n])", f"\x1b[{color}m{status}\x1b[0m", text, flags=re.MULTILINE)
    print(text, file=stream, flush=True)


# ---- tables ----

Row = Sequence[str]


def aligned(rows: Sequence[Row], *, left: int = 0) -> list[str]:
    """Lines with aligned columns, the first `left` of them left-aligned. A short row ends with free text."""
    full = [row for row in rows if len(row) == len(rows[0])]
    widths = [max(map(len, column)) for column in zip(*full, strict=True)]
    widths[0] = max(len(row[0]) for row in rows)
    return [_line(row, widths, left) for row in rows]


def _line(row: Row, widths: Sequence[int], left: int) -> str:
    if len(row) < len(widths):
        return f"{row[0]:<{widths[0]}}  {' '.join(row[1:])}"
    pairs = enumerate(zip(row, widths, strict=True))
    return "  ".join(cell.ljust(width) if i < left else cell.rjust(width) for i, (cell, width) in pairs)


def percent(count: int, total: int) -> str:
    """A percentage; 100 only for all, 0 only for none."""
    share = 100.0 * count / total
    return f"{share:.4f} %" if 0 < count < total else f"{share:.0f} %"


NOTHING = "-"


def number(value: float | None, digits: int) -> str:
    """`digits` after the point; two significant ones where that would show zero for a number that is not."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}" if value == 0.0 or abs(value) >= 10.0**-digits else f"{value:.1e}"
