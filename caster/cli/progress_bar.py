"""One line at the bottom of a terminal, written over again and again, that leaves nothing behind."""

import io
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

ERASE = "\r\x1b[K"  # back to the start of the line, and clear it


class StatusLine:
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


# How far some work has come, on standard error: one line on a terminal, a line now and then elsewhere.
#
# It counts work. It uses no colour, so that NO_COLOR has nothing to forbid.


QUIET_SECONDS = 1.0  # s: work that takes less says nothing on a terminal
REFRESH_SECONDS = 0.1  # s between two pictures of the line
LOG_SECONDS = 10.0  # s between two lines where no terminal is, and before the first: logs keep them all
BAR_CHARACTERS = 24  # characters of the bar


class ProgressBar:
    """`add` may be called by any thread; `close` has to be, whatever happens."""

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
        """So much more is done. extra: what else to say from now on."""
        with self.lock:
            self.done += count
            self.extra = extra or self.extra
            now = self.clock()
            if now >= self.next and self.done < self.total:
                self.next = now + (REFRESH_SECONDS if self.line.live else LOG_SECONDS)
                self._show(now)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Print something else meanwhile: the line is gone, and comes back with the next `add`."""
        with self.lock:
            self.line.erase()
            yield

    def close(self) -> None:
        """Nothing is left of it on a terminal."""
        with self.lock:
            self.line.erase()

    def _show(self, now: float) -> None:
        text = self.text(now - self.start)
        if self.line.live:
            self.line.show(text)
        else:
            self.line.write(text + "\n")

    def text(self, seconds: float) -> str:
        """rendering ████████    66 %, 2.1M of 3.1M rays, 520k rays/s, 2 s left"""
        share = self.done / self.total
        amount = f"{si_number(self.done)} of {si_number(self.total)} {self.unit}"
        parts = [f"{100 * share:.0f} %", *filter(None, [self.extra]), amount]
        if seconds > 0.0 and self.done:
            rate = self.done / seconds
            parts += [f"{si_number(rate)} {self.unit}/s", f"{duration((self.total - self.done) / rate)} left"]
        bar = f" {bar_text(share, self.line.stream.encoding)}" if self.line.live else ":"
        return f"{self.what}{bar} {', '.join(parts)}"


def bar_text(share: float, encoding: str | None) -> str:
    """A bar of WIDTH characters, in eighths of them where the encoding has the blocks."""
    try:
        "▏█".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return f"[{'#' * int(BAR_CHARACTERS * share):<{BAR_CHARACTERS}}]"
    eighths = int(8 * BAR_CHARACTERS * share)
    part = " ▏▎▍▌▋▊▉"[eighths % 8] if eighths % 8 else ""
    return f"{'█' * (eighths // 8) + part:<{BAR_CHARACTERS}}"


def si_number(number: float) -> str:
    """Three digits: 2.1M, 850."""
    for size, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= size:
            return f"{number / size:.3g}{prefix}"
    return f"{number:.3g}"


def duration(seconds: float) -> str:
    """In whole seconds, minutes or hours."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
