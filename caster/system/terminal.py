"""The terminal: standard streams that show control characters as escapes, and progress on standard error.

Progress is bars, status lines and messages about kernel compilation. On a terminal it is drawn by rich, redrawn in
place and erased at the end. Elsewhere a line is written now and then. rich is imported when something is drawn, so that
short commands never load it.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, TextIO, cast

if TYPE_CHECKING:
    from rich.live import Live


__all__ = ["ProgressBar", "StatusLine", "compilation_reported", "printable", "unfiltered"]


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
    for name, text in (("stdout", "standard output"), ("stderr", "standard error")):
        if (stream := getattr(sys, name)) is not None:  # it was closed before the start
            setattr(sys, name, PrintableStream(unfiltered(stream), text))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


# ---- progress ----

QUIET_SECONDS = 1.0  # work shorter than this draws nothing on a terminal
REFRESH_SECONDS = 0.1  # between two updates of the terminal
LOG_SECONDS = 10.0  # before the first and between further lines of a log, which keeps them all
BAR_CHARACTERS = 24  # width of the bar on a terminal
ERASE_LINE = "\r\x1b[K"  # where another process draws a bar, which it draws again
DUMB_TERMINALS = ("dumb", "unknown")  # values of TERM without cursor movement

COMPILE_TIME_HINT = "once: some 20 to 60 of them, in 10 to 40 s"


class StatusLine:
    """One line at the bottom of a terminal, redrawn in place and erased at the end; nothing without a terminal.

    stream: default standard error; output to a closed standard error is dropped.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = unfiltered(stream or sys.stderr or io.StringIO())
        self.live = self.stream.isatty() and os.environ.get("TERM") not in DUMB_TERMINALS
        self._display: Live | None = None

    def show(self, content: str) -> None:
        """Replace the line. Text wider than the terminal is cropped, as a wrapped line could not be erased."""
        if not self.live:
            return
        from rich.text import Text

        if self._display is None:
            self._display = _started_display(self.stream)
        self._display.update(Text(printable(content, keep=""), no_wrap=True, overflow="crop"), refresh=True)

    def erase(self) -> None:
        """Remove the line from the terminal; a later `show` draws it again."""
        if self._display is not None:
            self._display.stop()
            self._display = None

    def log(self, text: str) -> None:
        """Write a line that stays, at once."""
        self.stream.write(printable(text) + "\n")
        self.stream.flush()


def _started_display(stream: TextIO) -> Live:
    from rich.console import Console
    from rich.live import Live

    console = Console(file=stream, force_terminal=True, highlight=False)
    display = Live(console=console, auto_refresh=False, transient=True, redirect_stdout=False, redirect_stderr=False)
    display.start()
    return display


class ProgressBar:
    """A progress bar over counted work. `add` is thread-safe; `close` must be called on every path."""

    def __init__(
        self,
        what: str,
        total: int,
        unit: str,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.what, self.total, self.unit = what, total, unit
        self.line = StatusLine(stream)
        self.clock, self.start = clock, clock()
        self.next = self.start + (QUIET_SECONDS if self.line.live else LOG_SECONDS)
        self.done, self.extra = 0, ""
        self.lock = threading.Lock()

    def add(self, count: int, extra: str = "") -> None:
        """Count work as done. extra: further text to show from now on, such as a count of scenes."""
        with self.lock:
            self.done += count
            self.extra = extra or self.extra
            now = self.clock()
            if now >= self.next and self.done < self.total:
                self.next = now + (REFRESH_SECONDS if self.line.live else LOG_SECONDS)
                self._draw(now - self.start)

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Erase the bar while the body prints; the next `add` draws it again."""
        with self.lock:
            self.line.erase()
            yield

    def close(self) -> None:
        """Erase the bar."""
        with self.lock:
            self.line.erase()

    def _draw(self, seconds: float) -> None:
        if not self.line.live:
            self.line.log(f"{self.what}: {self.text(seconds)}")
            return
        filled = round(BAR_CHARACTERS * self.done / self.total)
        self.line.show(f"{self.what} {'#' * filled}{'-' * (BAR_CHARACTERS - filled)} {self.text(seconds)}")

    def text(self, seconds: float) -> str:
        """66 %, 2.1M of 3.1M rays, 520k rays/s, 2 s left"""
        amount = f"{si_number(self.done)} of {si_number(self.total)} {self.unit}"
        parts = [f"{100 * self.done / self.total:.0f} %", *filter(None, [self.extra]), amount]
        if seconds > 0.0 and self.done:
            rate = self.done / seconds
            parts += [f"{si_number(rate)} {self.unit}/s", f"{duration((self.total - self.done) / rate)} left"]
        return ", ".join(parts)


def si_number(number: float) -> str:
    """A number in three digits with an SI prefix: 2.1M, 850."""
    for size, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= size:
            return f"{number / size:.3g}{prefix}"
    return f"{number:.3g}"


def duration(seconds: float) -> str:
    """A time span in whole seconds or minutes, or tenths of hours."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


class CompilationNotice:
    """Lines on standard error about kernels that a command compiles: one at once, then a count now and then.

    Forks count together with the process that made this: kernels of all of them are one run. Two that begin within
    the same microsecond may both write the first line.
    """

    def __init__(self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """stream: default standard error, as it is at each line."""
        import mmap

        self.stream, self.clock = stream, clock
        self._shared = memoryview(mmap.mmap(-1, 3 * 8)).cast("d")  # kernels, when the first began, of the next line

    @property
    def kernels(self) -> int:
        """How many were begun."""
        return int(self._shared[0])

    def compiling(self, name: str) -> None:
        """Count a kernel whose compilation starts."""
        now = self.clock()
        self._shared[0] += 1
        if self.kernels == 1:
            self._shared[1], self._shared[2] = now, now + LOG_SECONDS
            self._write(f"compiling kernels, {COMPILE_TIME_HINT}; `caster doctor --warm` does it ahead")
            report_refused_cache()
        elif now >= self._shared[2]:
            self._shared[2] = now + LOG_SECONDS
            self._write(f"compiling kernel {self.kernels}, after {duration(now - self._shared[1])}")

    def _write(self, text: str) -> None:
        line = StatusLine(self.stream)
        with contextlib.suppress(OSError):  # whoever closed standard error does not wait for it
            line.log(f"{ERASE_LINE}{text}" if line.live else text)


@contextlib.contextmanager
def compilation_reported(stream: TextIO | None = None) -> Iterator[None]:
    """Report what the body compiles, in this process and in its forks; nothing if all kernels are cached.

    stream: default standard error.
    """
    from caster.jit.decorators import COMPILATION_LOG

    before = COMPILATION_LOG.compiling
    COMPILATION_LOG.compiling = CompilationNotice(stream).compiling
    try:
        yield
    finally:
        COMPILATION_LOG.compiling = before


@cache
def report_refused_cache() -> None:
    """Print one line on standard error, once a process, if kernels are not cached because others could replace them."""
    from caster.jit.kernel_cache import cache_folder, refusals

    cache_folder()
    hint = "remove it, or name a folder of your own as XDG_CACHE_HOME"
    for refusal in refusals:
        print(f"compiled kernels are not kept: {refusal}; {hint}", file=sys.stderr, flush=True)
