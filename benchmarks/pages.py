"""Pages of docs/ that are made from the results of experiments."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from caster.description.errors import SceneError
from caster.description.input_files import read_input
from caster.system.atomic_files import check_folder, write_bytes, write_text

T = TypeVar("T")
Row = Sequence[str]

WIDTH = 120  # characters of a line of prose


def write_page(folder: Path, page: str, lines: Iterable[str], image_folder: str, images: Mapping[str, bytes]) -> None:
    """Write a Markdown page, and its images into a folder beside it. Raises OutputError."""
    target = check_folder(folder / image_folder)
    for name, content in images.items():
        write_bytes(target / name, content)
    write_text(folder / page, "\n".join(lines) + "\n")


def read_result(kind: type[T], file: str, written_by: str) -> T:
    """The result in a file that `written_by` wrote. Raises FileMissing or SceneError."""
    try:
        return TypeAdapter(kind).validate_json(read_input(file, "result"))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        text = f"{file}: expected what `{written_by} --json` writes: {where}: {first['msg']}"
        raise SceneError(text) from error


def markdown(rows: Sequence[Row], *, rule: str | None = None) -> str:
    """A Markdown table, the first row its head. rule: the line below it, left-aligned columns unless given."""
    full = ([*row, *[""] * (len(rows[0]) - len(row))] for row in rows)
    head, *body = ("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |" for cells in full)
    return "\n".join([head, rule or "|" + "---|" * len(rows[0]), *body])
