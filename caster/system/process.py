"""The end of a command: exit codes, exceptions as messages and exit codes, and signals.

Ctrl-C, SIGTERM and SIGHUP end a command within GRACE_SECONDS, a second one at once.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

from caster.description.errors import SceneError
from caster.system.atomic_files import remove_temporaries
from caster.system.terminal import printable_streams

__all__ = [
    "DIFFERENCES",
    "FILE",
    "INTERNAL",
    "INTERRUPTED",
    "MEANINGS",
    "NOTHING_SELECTED",
    "NOT_COMPARABLE",
    "OK",
    "PARENT_VARIABLE",
    "PIPE_CLOSED",
    "USAGE",
    "at_forced_exit",
    "die_with_parent",
    "interrupted",
    "reopen_closed_streams",
]

OK = 0
DIFFERENCES = 1
USAGE = 2  # a wrong option, or a scene that cannot be used
NOT_COMPARABLE = 3
FILE = 4  # missing, unreadable or unwritable
NOTHING_SELECTED = 5
INTERNAL = 70
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
PIPE_CLOSED = 141  # 128 + SIGPIPE: the reader closed the pipe before the result was written

MEANINGS = {
    OK: "pass",
    DIFFERENCES: "differences",
    USAGE: "wrong usage or invalid scene",
    NOT_COMPARABLE: "not comparable",
    FILE: "file missing, unreadable or unwritable",
    NOTHING_SELECTED: "nothing selected",
    INTERNAL: "internal error",
    INTERRUPTED: "interrupted",
}


def exit_codes_help(*codes: int) -> str:
    """A line for --help with the meanings of exit codes."""
    return "exit codes: " + ", ".join(f"{code} {MEANINGS[code]}" for code in codes)


def run_command(command: Callable[[], int]) -> int:
    """Run a command, print its error to standard error, and return the exit code.

    SceneError and its subclasses carry their own code. Only an unexpected exception shows a traceback.
    """
    reopen_closed_streams()
    _escape_unencodable()
    with printable_streams():
        try:
            with handled_signals():
                code = _exit_code(command)
            sys.stdout.flush()  # here, so that a closed pipe or a full disk is detected
            return code
        except BrokenPipeError:
            return _discard_output(PIPE_CLOSED)
        except OSError as error:
            return _discard_output(_report_error(_os_error_text(error), FILE))


def _os_error_text(error: OSError) -> str:
    """The file and what is wrong with it; where an error names no file, the folder of temporary files."""
    if error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {error.strerror or error}"
    return f"{error.strerror or error} (a file without a name; temporary files are in {tempfile.gettempdir()})"


def reopen_closed_streams() -> None:
    """Open os.devnull for every standard stream that was closed before the start, also for child processes.

    Otherwise the next file to be opened would get the stream's file descriptor.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115 - as long as the process lasts
            os.set_inheritable(nowhere.fileno(), True)
            setattr(sys, name, nowhere)


def _exit_code(command: Callable[[], int]) -> int:
    try:
        return command()
    except SystemExit as stop:  # argparse has printed an error or its help
        return stop.code if isinstance(stop.code, int) else USAGE if stop.code else OK
    except SceneError as error:
        return _report_error(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _report_error("interrupted", INTERRUPTED)
    except MemoryError as error:
        return _report_error(f"not enough memory{f': {error}' if str(error) else ''}", USAGE)
    except OSError:
        raise
    except Exception as error:
        if type(error).__name__ == "BdbQuit":  # `q` in pdb, which catches it
            raise
        traceback.print_exc()
        return _report_error(f"internal error, please report it: {type(error).__name__}: {error}", INTERNAL)


def _report_error(text: str, code: int) -> int:
    print(text, file=sys.stderr)
    return code


def _discard_output(code: int) -> int:
    """Discard buffered output, which the interpreter would otherwise try to write at exit."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _escape_unencodable() -> None:
    """Print characters that the terminal cannot encode as escapes, as they may occur in file names."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


# ---- signals: Ctrl-C, SIGTERM and SIGHUP ----

GRACE_SECONDS = 4.0  # for an interrupted command to write what is done, before the process is ended
CLEANUP_SECONDS = 1.0  # for the end of child processes and the removal of temporary files after that
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

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
    os._exit(INTERRUPTED)


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


PARENT_VARIABLE = "CASTER_PARENT"  # in the environment of children: the process that started them


def die_with_parent() -> None:
    """Have Linux kill this process with the one that started it, even if that one is killed itself.

    Ends this process where that one is gone already.
    """
    if sys.platform == "linux":
        import ctypes

        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    if os.environ.get(PARENT_VARIABLE, str(os.getppid())) != str(os.getppid()):
        os._exit(1)
