"""Tables of results as aligned text and as Markdown, from the same rows of cells."""

from collections.abc import Sequence

NOTHING = "-"
Row = Sequence[str]


def aligned(rows: Sequence[Row], *, left: int = 0) -> list[str]:
    """Lines with aligned columns, the first `left` of them to the left. A short row ends with free text."""
    full = [row for row in rows if len(row) == len(rows[0])]
    widths = [max(map(len, column)) for column in zip(*full, strict=True)]
    widths[0] = max(len(row[0]) for row in rows)
    return [_line(row, widths, left) for row in rows]


def _line(row: Row, widths: Sequence[int], left: int) -> str:
    if len(row) < len(widths):
        return f"{row[0]:<{widths[0]}}  {' '.join(row[1:])}"
    pairs = enumerate(zip(row, widths, strict=True))
    return "  ".join(cell.ljust(width) if i < left else cell.rjust(width) for i, (cell, width) in pairs)


def markdown(rows: Sequence[Row], *, rule: str | None = None) -> str:
    """A Markdown table, the first row its head. rule: the line below it, left-aligned columns unless given."""
    head, *body = (_markdown_row(row, len(rows[0])) for row in rows)
    return "\n".join([head, rule or "|" + "---|" * len(rows[0]), *body])


def _markdown_row(row: Row, columns: int) -> str:
    cells = [*row, *[""] * (columns - len(row))]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def number(value: float | None, digits: int) -> str:
    """`digits` after the point; two significant ones where that would show zero for a number that is not."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}" if value == 0.0 or abs(value) >= 10.0**-digits else f"{value:.1e}"
