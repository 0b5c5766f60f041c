"""Tables for terminals and logs: aligned columns, in colour only where a terminal shows it."""

import os
import sys
from collections.abc import Iterable, Sequence
from io import StringIO
from typing import Literal, NamedTuple, TextIO

from rich.console import Console
from rich.table import Table
from rich.text import Text

from caster.cli.printable_stream import printable, unfiltered

UNLIMITED_WIDTH = 10_000  # characters: lines of a log are never wrapped or cut
STATUS_STYLES = {"PASS": "green", "FAIL": "bold red"}


class Column(NamedTuple):
    """Title, of one or several lines, alignment, and the least width in characters."""

    title: str
    justify: Literal["left", "right"] = "left"
    width: int = 0


def format_table(
    columns: Sequence[Column], rows: Iterable[Sequence[str]], *, header: bool = True, gap: int = 2
) -> str:
    """Rows under their titles as plain text, without blanks at line ends. gap: blanks between columns."""
    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0), show_header=header, header_style="")
    for column in columns:
        title = Text(column.title)
        table.add_column(
            title, justify=column.justify, min_width=column.width, no_wrap=True, vertical="bottom"
        )
    for row in rows:
        table.add_row(*(Text(printable(cell, keep="")) for cell in row))
    out = StringIO()
    Console(file=out, width=UNLIMITED_WIDTH, color_system=None, highlight=False).print(table)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def print_lines(text: str, stream: TextIO | None = None) -> None:
    """Print text at once; on a terminal, PASS and FAIL at the start of a line in colour, unless NO_COLOR is set."""
    stream = stream or sys.stdout
    text = printable(text)
    if not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        print(text, file=stream, flush=True)
        return
    console = Console(file=unfiltered(stream), highlight=False, soft_wrap=True)
    for line in text.splitlines():
        styled = Text(line)
        if line[:4] in STATUS_STYLES:
            styled.stylize(STATUS_STYLES[line[:4]], 0, 4)
        console.print(styled)
    stream.flush()
