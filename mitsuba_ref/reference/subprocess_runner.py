"""Child processes with a deadline and captured output, which leave nothing behind.

- `run` runs a command to its end. A crash, a signal or a missed deadline is a result, not an exception.
- `ResidentProcess` stays and answers requests in bytes, on its stdin and stdout; our own children answer by `serve`.
  Its end is raised as `ProcessEnded`.

Each child leads a process group, which is killed at the end, so that nothing it started survives. Captured output goes
to a file: a pipe that nobody empties would block the writer. On Linux, a child that calls `die_with_parent` is killed
with its parent, even if the parent was killed itself.
"""

import os
import re
import select
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import IO

from caster.system.process import PARENT_VARIABLE, die_with_parent, forced_exit_actions

OUTPUT_HEAD_BYTES, OUTPUT_TAIL_BYTES = 1000, 3000  # of captured output that are kept
REAP_SECONDS = 5.0  # for a killed process, or one that closed its pipe, to be gone
ANSI_ESCAPE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]")
PACKAGE_PARENT = Path(__file__).resolve().parents[2]  # the folder that the package lies in

# Runs a module of ours. Our packages come from their own folder, which may be the site-packages of another interpreter.
RUN_MODULE = """
import importlib.util, runpy, sys
root, module = sys.argv[1:3]
del sys.argv[1:3]
for name in ("caster", "mitsuba_ref"):
    folder = root + "/" + name
    spec = importlib.util.spec_from_file_location(name, folder + "/__init__.py", submodule_search_locations=[folder])
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
runpy.run_module(module, run_name="__main__")
"""

_running: set[int] = set()  # process groups
_starting = threading.Lock()
_starts_refused = threading.Event()


@dataclass(frozen=True)
class ProcessEnd:
    """The end of a process, and its output."""

    code: int | None  # exit code, negative for a signal; None: killed at its deadline
    output: str  # head and tail of stdout and stderr, without escape sequences
    seconds: float

    @property
    def exit(self) -> str:
        """An exit code, a signal, or that it was killed at its deadline."""
        return f"killed after {round(self.seconds, 3):g} s" if self.code is None else exit_name(self.code)

    @property
    def headline(self) -> str:
        """The first output line that contains "error", else the last line."""
        lines = [line.strip() for line in self.output.splitlines() if line.strip()]
        return next((line for line in lines if "error" in line.lower()), "".join(lines[-1:]))


class ProcessEnded(Exception):  # noqa: N818 - an event, not necessarily an error
    """A resident process that no longer answers; `end` says why."""

    def __init__(self, end: ProcessEnd) -> None:
        super().__init__(end)
        self.end = end


def _forget_children() -> None:
    """In a fork, which has none; another thread may have held the lock."""
    global _starting
    _starting = threading.Lock()
    _running.clear()


os.register_at_fork(after_in_child=_forget_children)


def exit_name(code: int) -> str:
    """'exit code 3', 'SIGSEGV', or 'signal 77' for a signal without a name."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def kill_subprocesses() -> None:
    """Kill every child and refuse to start another until `allow_subprocesses`: for Ctrl-C while threads wait.

    Threads that wait for a child, or start one, get an end by SIGKILL.
    """
    with _starting:
        _starts_refused.set()
        for group in list(_running):
            kill_group(group)


forced_exit_actions.insert(0, kill_subprocesses)


def allow_subprocesses() -> None:
    """Undo the refusal of `kill_subprocesses`."""
    _starts_refused.clear()


def run(command: Sequence[str], timeout: float, environment: Mapping[str, str] = {}) -> ProcessEnd:
    """Run a command to its end, or kill it after `timeout` seconds. environment: added to that of this process.

    Raises OSError where the command cannot be started.
    """
    begin = monotonic()
    with tempfile.TemporaryFile() as output:
        try:
            child = _start(command, output, environment)
        except ProcessEnded as refused:
            return refused.end
        code: int | None = None
        try:
            code = child.wait(timeout)
        except subprocess.TimeoutExpired:
            pass
        finally:  # also on Ctrl-C, and for what the child may have started itself
            _kill_and_reap(child)
        return ProcessEnd(code, captured(output), monotonic() - begin)


class UnexpectedReply(ValueError):  # noqa: N818 - an outcome, not a mistake of the program
    """A child sent bytes that are not a reply; the text says what was expected."""


HEAD_BYTES = 8  # of a reply: its length


def length_first(data: bytes) -> bytes:
    """The bytes after their number, a little-endian int64."""
    return len(data).to_bytes(HEAD_BYTES, "little") + data


def _length(head: bytes) -> int:
    return int.from_bytes(head, "little")


class ResidentProcess:
    """A child that reads requests from its stdin and writes replies to its stdout; its stderr is captured. Close it."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] = {}, cwd: str | None = None) -> None:
        """Raises OSError, ProcessEnded where it cannot be started."""
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        try:
            self.process = _start(command, self._output, environment, cwd=cwd, pipes=True)
        except BaseException:
            self._output.close()
            raise
        assert self.process.stdin is not None and self.process.stdout is not None
        self._stdin, self._stdout = self.process.stdin.fileno(), self.process.stdout.fileno()
        os.set_blocking(self._stdin, False)

    @property
    def alive(self) -> bool:
        return not self._output.closed and self.process.poll() is None

    def ask(self, data: bytes, timeout: float) -> bytes:
        """The reply of a child that calls `serve`. Raises ProcessEnded after closing the process."""
        return self.request(length_first(data), timeout)[HEAD_BYTES:]

    def request(self, data: bytes, timeout: float, length_of: Callable[[bytes], int] = _length) -> bytes:
        """Send `data` and return the reply: HEAD_BYTES, then as many bytes as length_of reads from them.

        Raises ProcessEnded, or UnexpectedReply (length_of may), after closing the process.
        """
        begin = monotonic()
        os.ftruncate(self._output.fileno(), 0)  # what it printed beside earlier replies
        os.lseek(self._output.fileno(), 0, os.SEEK_SET)  # the child writes at the same offset
        left, reply, expected = memoryview(data), bytearray(), HEAD_BYTES
        try:
            while left or len(reply) < expected:
                seconds = max(begin + timeout - monotonic(), 0.0)
                readable, writable, _ = select.select([self._stdout], [self._stdin] if left else [], [], seconds)
                if not readable and not writable:
                    raise self._ended(begin, late=True)
                if readable:
                    received = os.read(self._stdout, 1 << 20)
                    if not received:
                        raise self._ended(begin)
                    reply += received
                else:
                    left = left[os.write(self._stdin, left[: 1 << 20]) :]
                if len(reply) >= HEAD_BYTES and expected == HEAD_BYTES:
                    expected += length_of(bytes(reply[:HEAD_BYTES]))
        except BrokenPipeError:
            raise self._ended(begin) from None
        except BaseException:  # also Ctrl-C: the child may be in the middle of a request
            self.close()
            raise
        if len(reply) > expected:
            self.close()
            raise UnexpectedReply(f"{len(reply) - expected} bytes more than it announced")
        return bytes(reply)

    def _ended(self, begin: float, *, late: bool = False) -> ProcessEnded:
        """Close a process that did not answer, at once if it is late, else after some seconds; returns its end."""
        code: int | None = None
        if not late:
            try:
                code = self.process.wait(REAP_SECONDS)
            except subprocess.TimeoutExpired:
                code = -signal.SIGKILL
        _kill_and_reap(self.process)
        end = ProcessEnd(code, captured(self._output), monotonic() - begin)
        self.close()
        return ProcessEnded(end)

    def close(self) -> None:
        """Kill it and close its pipes and files; a second call does nothing."""
        if self._output.closed:
            return
        _kill_and_reap(self.process)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(OSError):  # a request that was never read
                pipe.close()
        self._output.close()


def serve(
    answer: Callable[[bytes], bytes], idle_seconds: float | None = None, done: Callable[[], bool] = lambda: False
) -> None:
    """The child's side of `ResidentProcess.ask`: replies until stdin ends, or until `done` is true after a reply.

    idle_seconds: it also ends after so long without a request. Other output to stdout goes to stderr from here on.
    """
    die_with_parent()
    replies = os.dup(1)
    os.dup2(2, 1)
    with os.fdopen(os.dup(0), "rb", buffering=0) as requests, os.fdopen(replies, "wb") as out:
        while select.select([requests], [], [], idle_seconds)[0]:
            request = _read(requests, _length(_read(requests, HEAD_BYTES)))
            if not request:
                return
            out.write(length_first(answer(request)))
            out.flush()
            if done():
                return


def _read(file: IO[bytes], count: int) -> bytes:
    """Read `count` bytes, or fewer at the end of the file."""
    data = bytearray()
    while len(data) < count and (more := file.read(count - len(data))):
        data += more
    return bytes(data)


def run_module(python: str, module: str, *words: str, environment: Mapping[str, str]) -> ResidentProcess:
    """Run a module of ours that calls `serve`, in a Python that does not import from the current folder.

    Raises ProcessEnded while starts are refused.
    """
    command = [python, "-P", "-c", RUN_MODULE, str(PACKAGE_PARENT), module, *words]
    path = {"PYTHONPATH": import_path()}
    return ResidentProcess(command, {**environment, **path}, cwd=tempfile.gettempdir())


def import_path() -> str:
    """The user's PYTHONPATH without the current folder (an empty entry)."""
    entries = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    here = Path.cwd()
    return os.pathsep.join(entry for entry in map(os.path.abspath, filter(None, entries)) if Path(entry) != here)


def captured(output: IO[bytes]) -> str:
    """Head and tail of captured output: LLVM prints its error first and then a tree of code."""
    descriptor = output.fileno()  # pread does not move the offset, which a child may share
    size = os.fstat(descriptor).st_size
    head = os.pread(descriptor, OUTPUT_HEAD_BYTES, 0)
    tail = max(size - OUTPUT_TAIL_BYTES, len(head))
    gap = b"\n[...]\n" if tail > len(head) else b""
    content = head + gap + os.pread(descriptor, OUTPUT_TAIL_BYTES, tail)
    return ANSI_ESCAPE.sub("", content.decode("utf-8", "replace")).strip()


def _start(
    command: Sequence[str],
    output: IO[bytes],
    environment: Mapping[str, str],
    *,
    cwd: str | None = None,
    pipes: bool = False,
) -> subprocess.Popen[bytes]:
    """Start a command in a session of its own. pipes: its stdin and stdout are pipes; else stdout goes to `output`.

    Raises ProcessEnded while starts are refused, and OSError.
    """
    with _starting:
        if _starts_refused.is_set():
            raise ProcessEnded(ProcessEnd(-signal.SIGKILL, "stopped before it began", 0.0))
        child = subprocess.Popen(
            command,
            cwd=cwd,
            env={**os.environ, **environment, PARENT_VARIABLE: str(os.getpid())},
            stdin=subprocess.PIPE if pipes else subprocess.DEVNULL,
            stdout=subprocess.PIPE if pipes else output,
            stderr=output,
            start_new_session=True,  # Ctrl-C is for this process, which then ends the child
        )
        _running.add(child.pid)
        return child


def _kill_and_reap(child: subprocess.Popen[bytes]) -> None:
    kill_group(child.pid)
    with suppress(subprocess.TimeoutExpired):
        child.wait(REAP_SECONDS)
    _running.discard(child.pid)


def kill_group(group: int) -> None:
    with suppress(ProcessLookupError, PermissionError):  # gone; macOS calls that a PermissionError
        os.killpg(group, signal.SIGKILL)
