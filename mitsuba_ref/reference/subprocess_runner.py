"""One question to Mitsuba, in a process of its own that is gone afterwards, whatever happens."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse

# -P: a user's folder may hold a mitsuba.py, and `-m` would look there first.
CHILD_COMMAND = (sys.executable, "-P", "-m", "mitsuba_ref.reference.session")
PACKAGE_PARENT = Path(__file__).resolve().parents[2]
OUTPUT_HEAD_BYTES, OUTPUT_TAIL_BYTES = 1000, 3000  # bytes kept of what Mitsuba said
ANSI_ESCAPE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]")

_running: set[int] = set()
_starting = threading.Lock()
_stopped = threading.Event()  # nothing is started any more


class ProcessExit(NamedTuple):
    code: int | None  # None: it took too long
    words: str
    seconds: float


def run_request(
    job: TraceRequest,
    timeout: float,
    settings: Mapping[str, str] | None = None,
    command: Sequence[str] = CHILD_COMMAND,
) -> TraceResponse | Crash:
    """Give `command` a folder with the job, read its answer there. `settings`: its environment variables."""
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as name:
        folder = Path(name)
        job.write(folder)
        end = _run([*command, name], folder, timeout, settings or {})
        return _read(job, folder, end, timeout)


def kill_subprocesses() -> None:
    """Kill every child that runs, and start no other until `allow_subprocesses`: for Ctrl-C while threads wait.

    Who waits for a child, or wants one, gets a Crash.
    """
    with _starting:
        _stopped.set()
        for group in list(_running):
            _kill(group)


def allow_subprocesses() -> None:
    """Let children be started."""
    _stopped.clear()


@contextlib.contextmanager
def killed_with_subprocesses(child: subprocess.Popen[bytes]) -> Iterator[None]:
    """Another program, in a session of its own, that `kill_subprocesses` is to end as well."""
    with _starting:
        _running.add(child.pid)
        if _stopped.is_set():
            _kill(child.pid)
    try:
        yield
    finally:
        _running.discard(child.pid)


def _run(command: Sequence[str], folder: Path, timeout: float, settings: Mapping[str, str]) -> ProcessExit:
    """Run it in a session of its own; its words go to a file, since a pipe that nobody empties is a hang."""
    start = time.monotonic()
    with (folder / "words").open("wb") as words:
        with _starting:
            if _stopped.is_set():
                return ProcessExit(-signal.SIGKILL, "stopped before it began", 0.0)
            child = subprocess.Popen(
                command,
                cwd=folder,
                env={**os.environ, **settings, "PYTHONPATH": _search_path()},
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            _running.add(child.pid)
        code = _wait(child, timeout)
    return ProcessExit(code, _words(folder / "words"), time.monotonic() - start)


def _wait(child: subprocess.Popen[bytes], timeout: float) -> int | None:
    try:
        return child.wait(timeout)
    except subprocess.TimeoutExpired:
        return None
    finally:  # also on Ctrl-C, and for what the child may have started itself
        _kill(child.pid)
        child.wait()
        _running.discard(child.pid)


def _kill(group: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):  # gone; macOS calls that a PermissionError
        os.killpg(group, signal.SIGKILL)


def _search_path() -> str:
    """This package first, then what the user set; not the current folder, which an empty entry means, too."""
    entries = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    here = Path.cwd()
    kept = [entry for entry in map(os.path.abspath, filter(None, entries)) if Path(entry) != here]
    return os.pathsep.join([str(PACKAGE_PARENT), *kept])


def _words(path: Path) -> str:
    """How it began and how it ended: LLVM names its error first and spells out a tree of code after it."""
    with path.open("rb") as file:
        words = file.read(OUTPUT_HEAD_BYTES)
        left = path.stat().st_size - OUTPUT_HEAD_BYTES
        if left > OUTPUT_TAIL_BYTES:
            words += b"\n[...]\n"
            file.seek(left - OUTPUT_TAIL_BYTES, os.SEEK_CUR)
        words += file.read(OUTPUT_TAIL_BYTES)
    return ANSI_ESCAPE.sub("", words.decode("utf-8", "replace")).strip()


def _read(job: TraceRequest, folder: Path, end: ProcessExit, timeout: float) -> TraceResponse | Crash:
    if end.code is None:
        return Crash("timeout", end.words, f"killed after {timeout:g} s", end.seconds)
    if end.code:
        return Crash(_kind(end.code), end.words, _exit(end.code), end.seconds)
    try:
        return TraceResponse.read(folder, len(job.o))
    except ValueError as error:
        return Crash("garbage", f"{end.words}\n{error}".strip(), _exit(0), end.seconds)


def _kind(code: int) -> str:
    if code == -signal.SIGABRT:
        return "abort"
    return "signal" if code < 0 else "error"


def _exit(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
