"""Exit codes of `caster` and `mitsuba-ref`, and the mapping of exceptions to messages and exit codes."""

import contextlib
import io
import os
import sys
import tempfile
import traceback
from collections.abc import Callable

from caster.cli.printable_stream import printable_streams
from caster.cli.signals import handled_signals
from caster.description.errors import SceneError

__all__ = [
    "DIFFERENCES",
    "FILE",
    "INTERNAL",
    "INTERRUPTED",
    "MEANINGS",
    "NOTHING_SELECTED",
    "NOT_COMPARABLE",
    "OK",
    "PIPE_CLOSED",
    "USAGE",
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
    return (
        f"{error.strerror or error} (a file without a name; temporary files are in {tempfile.gettempdir()})"
    )


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
