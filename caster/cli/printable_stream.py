"""Standard streams that show control characters instead of sending them to the terminal."""

import contextlib
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO, cast

__all__ = ["printable", "unfiltered"]


def printable(text: str, keep: str = "\n\t") -> str:
    """Text whose control, format and bidirectional characters are escapes (\\u001b) that a terminal shows.

    keep: characters to leave as they are. The escapes are those of JSON, so that JSON stays what it is.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escape(c) for c in text)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))


class PrintableStream:
    """A text stream through `printable`. An OSError of it carries its name, such as "standard output"."""

    def __init__(self, stream: TextIO, name: str) -> None:
        self.unfiltered, self._name = stream, name

    def write(self, text: str) -> int:
        with self._named_errors():
            self.unfiltered.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        with self._named_errors():
            self.unfiltered.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unfiltered, name)

    @contextlib.contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise type(error)(error.errno, error.strerror, self._name) from error


def unfiltered(stream: TextIO) -> TextIO:
    """The stream below, for those who draw on a terminal and pass all text through `printable` themselves."""
    return cast(TextIO, getattr(stream, "unfiltered", stream))


@contextlib.contextmanager
def printable_streams() -> Iterator[None]:
    """Replace standard output and standard error while the body runs."""
    before = sys.stdout, sys.stderr
    sys.stdout = cast(TextIO, PrintableStream(unfiltered(sys.stdout), "standard output"))
    sys.stderr = cast(TextIO, PrintableStream(unfiltered(sys.stderr), "standard error"))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
