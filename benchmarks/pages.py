"""Pages of docs/ that are made from the results of experiments."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from caster.system.atomic_files import check_folder, write_bytes, write_text

WIDTH = 120  # characters of a line of prose


def write_page(folder: Path, page: str, lines: Iterable[str], image_folder: str, images: Mapping[str, bytes]) -> None:
    """Write a Markdown page, and its images into a folder beside it. Raises OutputError."""
    target = check_folder(folder / image_folder)
    for name, content in images.items():
        write_bytes(target / name, content)
    write_text(folder / page, "\n".join(lines) + "\n")
