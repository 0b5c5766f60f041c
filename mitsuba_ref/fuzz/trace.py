"""What is being tried, in a file, for the case that compiled code takes this process down with it."""

import contextlib
from pathlib import Path

from caster.whole_files import check_folder, write_text

NAME = "unfinished.txt"


class Trace:
    """A context: the file is there while it lasts, and stays where the process dies in it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / NAME

    def __enter__(self) -> "Trace":
        """Raises OutputError if nothing can be written there, before any work."""
        self.made = not self.folder.exists()
        check_folder(self.folder)
        write_text(self.file, "")
        return self

    def note(self, options: str) -> None:
        """Say what is tried next."""
        with self.file.open("w", encoding="utf-8") as file:
            file.write(f"mitsuba-ref fuzz {options}\n")

    def __exit__(self, *_: object) -> None:
        self.file.unlink(missing_ok=True)
        if self.made:
            with contextlib.suppress(OSError):  # failures are kept there
                self.folder.rmdir()


def died_in(folder: Path) -> str:
    """What a process was at that died here; "" if none did."""
    try:
        return (folder / NAME).read_text(encoding="utf-8").strip()
    except OSError:
        return ""
