"""Signals of a command: Ctrl-C, SIGTERM and SIGHUP end it within GRACE_SECONDS, a second one at once."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

from caster.image.atomic_files import remove_temporaries

__all__ = ["at_forced_exit", "interrupted"]

GRACE_SECONDS = 4.0  # for an interrupted command to write what is done, before the process is ended
CLEANUP_SECONDS = 1.0  # for the end of child processes and the removal of temporary files after that
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
EXIT_CODE = 130  # as caster/cli/exit_codes.py, which is imported later

interrupted = threading.Event()  # set from the first signal to the end of the command
_forced_exit_actions: list[Callable[[], None]] = [remove_temporaries]


def at_forced_exit(action: Callable[[], None]) -> None:
    """Call `action` before a process is ended that did not end in time; it runs in another thread."""
    _forced_exit_actions.insert(0, action)


@contextlib.contextmanager
def handled_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt in the main thread at the first signal; end the process if that is not enough.

    A thread of its own watches, since Python's handlers wait for compiled code in the main thread. Signals that the
    process was started to ignore (nohup) stay ignored. Nothing outside of the main thread.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    handled = {each: signal.getsignal(each) for each in SIGNALS}
    handled = {each: before for each, before in handled.items() if before is not signal.SIG_IGN}
    watcher = threading.Thread(target=_watch, args=(reading, frozenset(handled)), daemon=True)
    before_fd = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    watcher.start()
    for each in handled:
        signal.signal(each, _interrupt)
    try:
        yield
    finally:
        for each, before in handled.items():
            signal.signal(each, before if before is not None else signal.SIG_DFL)
        signal.set_wakeup_fd(before_fd)
        os.close(writing)
        watcher.join(CLEANUP_SECONDS)
        interrupted.clear()


def end_process() -> NoReturn:
    """End this process with 130 without waiting for threads, after child processes and temporary files."""
    cleaning = threading.Thread(target=_clean_up, daemon=True)  # it might wait for a lock
    cleaning.start()
    cleaning.join(CLEANUP_SECONDS)
    os._exit(EXIT_CODE)


def _interrupt(number: int, frame: Any) -> None:
    if not interrupted.is_set():
        interrupted.set()
        raise KeyboardInterrupt


def _watch(reading: int, handled: frozenset[int]) -> None:
    """Read signal numbers from a pipe until it is closed; end the process at the second one, or at the deadline."""
    count, deadline = 0, 0.0
    while True:
        left = max(deadline - time.monotonic(), 0.0) if count else None
        received = os.read(reading, 64) if select.select([reading], [], [], left)[0] else None
        if received == b"":
            os.close(reading)
            return
        count += sum(number in handled for number in received or b"")
        if received is None or count > 1:
            with contextlib.suppress(OSError):
                os.write(2, b"interrupted: ended before what was running could end\n")
            end_process()
        if count and not deadline:
            deadline = time.monotonic() + GRACE_SECONDS


def _clean_up() -> None:
    for action in _forced_exit_actions:
        with contextlib.suppress(Exception):
            action()
