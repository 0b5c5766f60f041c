"""How far some work has come, on standard error: one line on a terminal, a line now and then elsewhere.

It counts work. It uses no colour, so that NO_COLOR has nothing to forbid.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from caster.terminal_line import Line

QUIET = 1.0  # s: work that takes less says nothing on a terminal
REDRAWN = 0.1  # s between two pictures of the line
PLAIN = 10.0  # s between two lines where no terminal is, and before the first: logs keep them all
WIDTH = 24  # characters of the bar


class Bar:
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
        self.line = Line(stream)
        self.clock, self.start = clock, clock()
        self.next = self.start + (QUIET if self.line.live else PLAIN)
        self.done, self.extra = 0, ""
        self.lock = threading.Lock()

    def add(self, count: int, extra: str = "") -> None:
        """So much more is done. extra: what else to say from now on."""
        with self.lock:
            self.done += count
            self.extra = extra or self.extra
            now = self.clock()
            if now >= self.next and self.done < self.total:
                self.next = now + (REDRAWN if self.line.live else PLAIN)
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
        amount = f"{short(self.done)} of {short(self.total)} {self.unit}"
        parts = [f"{100 * share:.0f} %", *filter(None, [self.extra]), amount]
        if seconds > 0.0 and self.done:
            rate = self.done / seconds
            parts += [f"{short(rate)} {self.unit}/s", f"{duration((self.total - self.done) / rate)} left"]
        bar = f" {drawn(share, self.line.stream.encoding)}" if self.line.live else ":"
        return f"{self.what}{bar} {', '.join(parts)}"


def drawn(share: float, encoding: str | None) -> str:
    """A bar of WIDTH characters, in eighths of them where the encoding has the blocks."""
    try:
        "▏█".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return f"[{'#' * int(WIDTH * share):<{WIDTH}}]"
    eighths = int(8 * WIDTH * share)
    part = " ▏▎▍▌▋▊▉"[eighths % 8] if eighths % 8 else ""
    return f"{'█' * (eighths // 8) + part:<{WIDTH}}"


def short(number: float) -> str:
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
