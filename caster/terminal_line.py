"""One line at the bottom of a terminal, written over again and again, that leaves nothing behind."""

import io
import os
import shutil
import sys
from typing import TextIO

ERASE = "\r\x1b[K"  # back to the start of the line, and clear it


class Line:
    """On standard error, unless told. Where no terminal is, or one that cannot erase, nothing is shown."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr or io.StringIO()  # a closed standard error is None: nobody is told
        self.live = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.drawn = False

    def show(self, text: str) -> None:
        """This in the place of what was there, cut to the terminal's width: a line that wraps could not be erased."""
        if self.live:
            self.write(ERASE + text[: shutil.get_terminal_size().columns - 1])
            self.drawn = True

    def erase(self) -> None:
        if self.drawn:
            self.write(ERASE)
            self.drawn = False

    def write(self, text: str) -> None:
        """As it is, at once."""
        self.stream.write(text)
        self.stream.flush()
