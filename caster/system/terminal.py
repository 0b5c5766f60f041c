"""The terminal: standard streams that show control characters as escapes, and progress on standard error.

Progress is a bar or a status line, drawn by rich on a terminal only and erased at the end, and a message that kernels
are being compiled. rich is imported when something is drawn, so that short commands never load it.
"""

from __future__ import annotations

import io
import mmap
import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from textwrap import wrap
from time import monotonic
from typing import TYPE_CHECKING, Any, TextIO, cast

if TYPE_CHECKING:
    from rich.live import Live


__all__ = [
    "BELOW_NAME",
    "LINE_CHARACTERS",
    "ProgressBar",
    "StatusLine",
    "folded",
    "printable",
    "report_stage",
    "unfiltered",
]


def printable(text: str, keep: str = "\n\t") -> str:
    """Replace control, format and bidirectional characters by escapes (\\u001b), which cannot drive a terminal.

    keep: characters to leave as they are. The escapes are those of JSON, so that printed JSON stays valid.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escape(c) for c in text)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))


# ---- lines ----

LINE_CHARACTERS = 80
LABEL = re.compile(r" *[a-z][\w. ]{0,11}: +")  # such as "exact:      ", below which further lines begin
COMMAND = re.compile(
    r" *(?:(?:replay|from|next|look|report): |mitsuba-ref |caster |pixel \()"
)  # stays whole, to be copied
POINTER = re.compile(r"[ |]*\^+ *$")  # below a place in a line of a scene file
BELOW_NAME = 6 * " "  # of a scene, or of the first line of a message


def folded(text: str) -> str:
    """The text in lines of at most LINE_CHARACTERS, but for commands, words such as paths, and lines marked below."""
    lines = text.split("\n")
    short = []
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if len(line) <= LINE_CHARACTERS or COMMAND.match(line) or POINTER.match(below):
            short.append(line)
            continue
        label = LABEL.match(line)
        indent = " " * max(label.end() if label else len(line) - len(line.lstrip()), len(BELOW_NAME))
        short += wrap(line, LINE_CHARACTERS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return "\n".join(short)


class PrintableStream:
    """A text stream that writes through `printable`. Its OSErrors carry a name, such as "standard output"."""

    def __init__(self, stream: TextIO, name: str) -> None:
        self.unfiltered, self._name = stream, name

    def write(self, text: str) -> int:
        with self._named_errors():
            self.unfiltered.write(printable(text))
        return len(text)

    def flush(self) -> None:
        with self._named_errors():
            self.unfiltered.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unfiltered, name)

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise type(error)(error.errno, error.strerror, self._name) from error


def unfiltered(stream: TextIO) -> TextIO:
    """The stream under a PrintableStream, for callers that draw on a terminal and escape all text themselves."""
    return cast(TextIO, getattr(stream, "unfiltered", stream))


@contextmanager
def printable_streams() -> Iterator[None]:
    """Replace standard output and standard error while the body runs."""
    before = sys.stdout, sys.stderr
    for name, text in (("stdout", "standard output"), ("stderr", "standard error")):
        if (stream := getattr(sys, name)) is not None:  # it was closed before the start
            setattr(sys, name, PrintableStream(unfiltered(stream), text))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


# ---- progress ----

QUIET_SECONDS = 1.0  # work shorter than this draws nothing
REFRESH_SECONDS = 0.1  # between two updates of the terminal
TICK_SECONDS = 0.5  # after which a bar is drawn again though nothing was counted
BAR_CHARACTERS = 10  # width of the bar; the whole line fits into 80 characters
ERASE_LINE = "\r\x1b[K"  # another process may have drawn a bar there, which it will draw again
DUMB_TERMINALS = ("dumb", "unknown")  # values of TERM without cursor movement


class StatusLine:
    """One line at the bottom of a terminal, redrawn in place and erased at the end; nothing without a terminal.

    Output to a closed standard error is dropped.
    """

    def __init__(self) -> None:
        self.stream = unfiltered(sys.stderr or io.StringIO())
        self.live = self.stream.isatty() and os.environ.get("TERM") not in DUMB_TERMINALS
        self._display: Live | None = None

    def show(self, content: str) -> None:
        """Replace the line. Text wider than the terminal is cropped, as a wrapped line could not be erased."""
        if not self.live:
            return
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        if self._display is None:
            console = Console(file=self.stream, force_terminal=True, highlight=False)
            self._display = Live(
                console=console, auto_refresh=False, transient=True, redirect_stdout=False, redirect_stderr=False
            )
            self._display.start()
        self._display.update(Text(printable(content, keep=""), no_wrap=True, overflow="crop"), refresh=True)

    def erase(self) -> None:
        """Remove the line from the terminal; a later `show` draws it again."""
        if self._display is not None:
            self._display.stop()
            self._display = None


# Held while a bar is drawn, and during a fork: the child would wait for ever for a stream that was being written to.
_drawing = threading.RLock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_drawing.acquire, after_in_parent=_drawing.release, after_in_child=_drawing.release)

STAGE_BYTES = 24
_stage: mmap.mmap | None = None  # what is being done, shared with forks; of the last progress bar


def report_stage(words: str) -> None:
    """Report what this process or a fork of it does now, at most STAGE_BYTES long, for the progress bar to show."""
    if _stage is not None:
        _stage[:] = words.encode().ljust(STAGE_BYTES)


class ProgressBar:
    """A progress bar over counted work, on a terminal only.

    `add` is thread-safe; `close` must be called on every path.
    """

    def __init__(self, what: str, total: int) -> None:
        global _stage
        self.what, self.total = what, total
        self.line = StatusLine()
        self.start = monotonic()
        self.next = self.start + QUIET_SECONDS
        self.done, self.extra = 0, ""
        self.closed = threading.Event()
        if self.line.live:
            _stage = mmap.mmap(-1, STAGE_BYTES)
            threading.Thread(target=self._keep_drawing, daemon=True).start()

    def add(self, count: int, extra: str = "") -> None:
        """Count work as done. extra: further text to show from now on, such as a count of scenes."""
        with _drawing:
            self.done += count
            self.extra = extra or self.extra
            self._draw()

    def _draw(self) -> None:
        now = monotonic()
        if now < self.next or self.done >= self.total or self.closed.is_set():
            return
        self.next = now + REFRESH_SECONDS
        seconds, share = now - self.start, self.done / self.total
        filled = round(BAR_CHARACTERS * share)
        bar = f"{self.what} {'#' * filled}{'-' * (BAR_CHARACTERS - filled)} {100 * share:.0f} %"
        left = f"{seconds / share - seconds:.0f} s left" if share else ""
        stage = _stage[:].strip(b" \0").decode() if _stage is not None else ""
        self.line.show(", ".join([bar, *filter(None, [self.extra, left, stage])]))

    def _keep_drawing(self) -> None:
        """Show the stage while nothing is counted."""
        while not self.closed.wait(TICK_SECONDS):
            with _drawing:
                self._draw()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Erase the bar while the body prints; the next `add` draws it again."""
        with _drawing:
            self.line.erase()
            yield

    def close(self) -> None:
        """Erase the bar."""
        self.closed.set()
        with _drawing:
            self.line.erase()


@contextmanager
def compilation_reported() -> Iterator[None]:
    """Report once that the body compiles kernels, in this process or in its forks; nothing if all are cached.

    The line goes to standard error, as that is when the line is written.
    """
    from caster.jit.decorators import COMPILATION_LOG

    before = COMPILATION_LOG.compiling
    written = mmap.mmap(-1, 1)  # shared with forks; two that begin at the same moment may both write

    def compiling(name: str) -> None:
        if written[0]:
            return
        written[0] = 1
        report_stage("compiling kernels")
        line = StatusLine()
        with suppress(OSError):  # standard error may be closed
            text = "compiling kernels, once, in 10 to 40 s; `caster doctor --warm` does it ahead"
            print(f"{ERASE_LINE if line.live else ''}{text}", file=line.stream, flush=True)
        report_refused_cache()

    COMPILATION_LOG.compiling = compiling
    try:
        yield
    finally:
        COMPILATION_LOG.compiling = before


@cache
def report_refused_cache() -> None:
    """Print once a process, on standard error, why compiled kernels are not kept: others could replace the files."""
    from caster.jit.kernel_cache import cache_folder, refusals

    cache_folder()
    hint = "remove it, or name a folder of your own as XDG_CACHE_HOME"
    for refusal in refusals:
        print(folded(f"compiled kernels are not kept: {refusal}; {hint}"), file=sys.stderr, flush=True)
