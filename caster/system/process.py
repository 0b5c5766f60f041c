"""How a command ends: exit codes, messages of exceptions, and signals.

Ctrl-C, SIGTERM and SIGHUP interrupt a command, which then has GRACE_SECONDS to end; a second one ends it at once.
"""

import io
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from caster.description.errors import SceneError
from caster.system.atomic_files import remove_temporaries
from caster.system.terminal import folded, printable_streams

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
    "USAGE",
    "die_with_parent",
    "forced_exit_actions",
    "interrupted",
    "report_error",
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


def run_command(command: Callable[[], int]) -> int:
    """Run a command, print its error to standard error, and return the exit code.

    SceneError and its subclasses carry their own code. Only an unexpected exception shows a traceback.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # which may be unable to encode the characters of a file name
            stream.reconfigure(errors="backslashreplace")
    with printable_streams():
        try:
            with handled_signals():
                code = _exit_code(command)
            if sys.stdout is not None:  # it was closed before the start
                sys.stdout.flush()  # here, so that a closed pipe or a full disk is detected
            return code
        except BrokenPipeError:
            return _discard_output(PIPE_CLOSED)
        except OSError as error:
            text = f"{error.strerror or error} (a file without a name; temporary files are in {tempfile.gettempdir()})"
            if error.filename is not None:
                text = f"{os.fsdecode(error.filename)}: {error.strerror or error}"
            return _discard_output(report_error(text, FILE))


def _exit_code(command: Callable[[], int]) -> int:
    try:
        return command()
    except SystemExit as stop:  # argparse has printed an error or its help
        return stop.code if isinstance(stop.code, int) else USAGE if stop.code else OK
    except SceneError as error:
        return report_error(str(error), error.exit_code)
    except KeyboardInterrupt:
        return report_error("interrupted", INTERRUPTED)
    except MemoryError as error:
        return report_error(f"not enough memory{f': {error}' if str(error) else ''}", USAGE)
    except OSError:
        raise
    except Exception as error:
        if type(error).__name__ == "BdbQuit":  # `q` in pdb, which catches it
            raise
        traceback.print_exc()
        return report_error(f"internal error, please report it: {type(error).__name__}: {error}", INTERNAL)


def report_error(text: str, code: int) -> int:
    """Print a message on standard error, folded; the code."""
    print(folded(text), file=sys.stderr)
    return code


def _discard_output(code: int) -> int:
    """Discard buffered output, which the interpreter would otherwise try to write at exit."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


# ---- signals: Ctrl-C, SIGTERM and SIGHUP ----

GRACE_SECONDS = 4.0  # that an interrupted command has to write its results before the process ends
CLEANUP_SECONDS = 1.0  # after that, for ending child processes and removing temporary files
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)

interrupted = threading.Event()  # set from the first signal to the end of the command
# Run in this order, in another thread, when a process does not end in time.
forced_exit_actions: list[Callable[[], None]] = [remove_temporaries]


@contextmanager
def handled_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt at the first signal; end the process at the second, or after GRACE_SECONDS.

    Python runs the handler when compiled code in the main thread returns. Signals that the process was started to
    ignore (nohup) stay ignored. Has no effect outside of the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handled = {each: before for each in SIGNALS if (before := signal.getsignal(each)) is not signal.SIG_IGN}
    for each in handled:
        signal.signal(each, _interrupt)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for each, before in handled.items():
            signal.signal(each, before if before is not None else signal.SIG_DFL)
        interrupted.clear()


def _interrupt(number: int, frame: Any) -> None:
    if interrupted.is_set():
        with suppress(OSError):
            os.write(2, b"interrupted: ended at once, without waiting for running work\n")
        end_process()
    interrupted.set()
    signal.setitimer(signal.ITIMER_REAL, GRACE_SECONDS)
    raise KeyboardInterrupt


def end_process() -> NoReturn:
    """Exit with 130 without waiting for threads; child processes and temporary files go first."""
    cleaning = threading.Thread(target=_clean_up, daemon=True)  # it might wait for a lock
    cleaning.start()
    cleaning.join(CLEANUP_SECONDS)
    os._exit(INTERRUPTED)


def _clean_up() -> None:
    for action in forced_exit_actions:
        with suppress(Exception):
            action()


PARENT_VARIABLE = "CASTER_PARENT"  # in the environment of child processes: the id of their parent


def die_with_parent() -> None:
    """Ask Linux to kill this process when its parent dies, even if the parent is killed.

    Exits if the parent is gone already.
    """
    if sys.platform == "linux":
        import ctypes

        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    if os.environ.get(PARENT_VARIABLE, str(os.getppid())) != str(os.getppid()):
        os._exit(1)
