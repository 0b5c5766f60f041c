"""Output of the commands: results as JSON files, and as text and tables, in colour only on a terminal.

Results are pydantic dataclasses. Files also contain their derived values (`computed_field`), which are ignored when a
file is read.
"""

import json
import math
import os
import re
import sys
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, TextIO

from caster.system.atomic_files import write_text
from caster.system.terminal import LINE_CHARACTERS, folded, printable, unfiltered
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.verdict import as_json
from mitsuba_ref.reference.variants import usable_variants

STANDARD_OUTPUT = "-"


def json_text(result: Any) -> str:
    """The result as JSON."""
    return json.dumps(as_json(result), indent=1, allow_nan=False) + "\n"


def write_result(result: Any, file: str | None) -> None:
    """Write the JSON of a result to the file of --json, "-" for standard output, if given. Raises OutputError."""
    if file == STANDARD_OUTPUT:
        sys.stdout.write(json_text(result))
    elif file:
        write_text(file, json_text(result))


def libllvm() -> str:
    """File name of the libLLVM that Mitsuba loads, or "none"."""
    library = usable_variants().libllvm
    return Path(library).name if library else "none"


def largest(values: Array) -> float | None:
    """The largest finite value; None if there is none."""
    return max(filter(math.isfinite, values.tolist()), default=None)


# ---- text ----

STATUS_COLORS = {"PASS": "32", "FAIL": "1;31", "SKIP": "33", "KNOWN": "33"}  # codes of ANSI terminals


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
GAP = "  "  # between columns


def aligned(rows: Sequence[Row], *, left: int = 0, step: int = 1) -> list[str]:
    """Lines with aligned columns, the first `left` of them left-aligned. A short row ends with free text.

    Columns beyond LINE_CHARACTERS go into a table below, behind the first column again; `step` of them, counted from
    the last, stay together.
    """
    full = [row for row in rows if len(row) == len(rows[0])]
    widths = [max(map(len, column)) for column in zip(*full, strict=True)]
    widths[0] = max(len(row[0]) for row in rows)
    ends = [*accumulate(width + len(GAP) for width in widths)]
    fit = max(1 + step, sum(end - len(GAP) <= LINE_CHARACTERS for end in ends))
    fit -= (fit - len(widths)) % step
    lines = [_line(row if len(row) < len(widths) else row[:fit], widths[:fit], left) for row in rows]
    rest = [[row[0], *row[fit:]] for row in full]
    return lines if fit >= len(widths) else [*lines, "", *aligned(rest, left=min(left, 1), step=step)]


def _line(row: Row, widths: Sequence[int], left: int) -> str:
    if len(row) < len(widths):
        return f"{row[0]:<{widths[0]}}{GAP}{' '.join(row[1:])}"
    pairs = enumerate(zip(row, widths, strict=True))
    return GAP.join(cell.ljust(width) if i < left else cell.rjust(width) for i, (cell, width) in pairs)


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
