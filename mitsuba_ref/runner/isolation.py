"""Calls in forks of this process: what ends the process, such as a crash of compiled code, ends one call alone."""

import contextlib
import faulthandler
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

from caster.system.atomic_files import ScratchFolder
from caster.system.process import PARENT_VARIABLE, die_with_parent
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.subprocess_runner import exit_name, kill_subprocesses

Result = TypeVar("Result")

# Compilation of all kernels, our caster and two processes of Mitsuba may each take as long as one of the latter.
CALL_TIMEOUTS = 4.0
CALL_SECONDS = CALL_TIMEOUTS * DEFAULT_TIMEOUT  # for one call
STOP_SECONDS = 2.0  # for a worker to remove its files after SIGTERM, before it is killed
POLL_SECONDS = 0.005
STACK_FILE, MAX_CALLS = "stack", 4  # Python calls that a crash came from, the innermost ones

_forking = threading.Lock()  # a second fork at the same time would hold the first one's pipe open


class WorkerEnded(Exception):  # noqa: N818 - an event; str() is how the process ended, then the last Python calls
    """A worker that ended, or was killed after CALL_SECONDS, before its call returned."""


class ResultNotSent(Exception):  # noqa: N818 - str() names the function and what of its result has no pickle
    """A result, or an exception, that cannot be sent from a fork: a mistake of this package."""


class Worker:
    """A fork of this process that serves one call at a time."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.folder = ScratchFolder()  # all temporary files of the fork
        self.stack: list[str] = []  # the last Python calls at a fatal signal
        self.code: int | None = None
        sys.stdout.flush()  # what is buffered belongs to this process alone
        with _forking:
            self.connection, remote = multiprocessing.Pipe()
            self.pid = os.fork()
            if self.pid == 0:
                self.connection.close()
                self._serve(function, remote)
            remote.close()

    def _serve(self, function: Callable[..., Any], requests: Connection) -> NoReturn:
        """The fork's side."""
        try:
            signal.set_wakeup_fd(-1)  # the parent's, who would take a signal of this process for one of its own
            for number in (signal.SIGINT, signal.SIGHUP):  # come by way of the parent, as SIGTERM
                signal.signal(number, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.default_int_handler)
            os.environ.pop(PARENT_VARIABLE, None)  # of the process that was forked
            die_with_parent()
            tempfile.tempdir = self.folder.name
            stack = os.open(Path(self.folder.name, STACK_FILE), os.O_WRONLY | os.O_CREAT)
            faulthandler.enable(stack, all_threads=False)
            while True:
                args, options = requests.recv()
                reply: tuple[Any, Exception | None]
                try:
                    reply = function(*args, **options), None
                except Exception as error:
                    error.add_note("".join(["In the fork:\n", *traceback.format_tb(error.__traceback__)]))
                    reply = None, error
                try:
                    requests.send(reply)
                except (pickle.PicklingError, AttributeError, TypeError) as error:
                    requests.send((None, ResultNotSent(f"{function.__name__}: {error}")))
        except (EOFError, OSError):
            os._exit(0)
        except (KeyboardInterrupt, SystemExit) as end:  # SIGTERM, or sys.exit of what was called
            kill_subprocesses()
            os._exit(end.code if isinstance(end, SystemExit) and isinstance(end.code, int) else 0)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)

    def call(self, seconds: float, args: tuple[Any, ...], options: dict[str, Any]) -> Any:
        """function(*args, **options), with its exceptions. Raises WorkerEnded; the worker is closed then."""
        try:
            self.connection.send((args, options))
            if not self.connection.poll(seconds):
                self.close(signal.SIGKILL)
                raise WorkerEnded(f"killed after {seconds:g} s without an answer")
            result, error = self.connection.recv()
        except (EOFError, OSError):
            self.close(signal.SIGCONT)  # which changes nothing: it has closed its end of the pipe
            assert self.code is not None
            raise WorkerEnded("\n".join([exit_name(self.code), *self.stack])) from None
        if error is not None:
            raise error
        return result

    @property
    def alive(self) -> bool:
        """Whether it runs; `code` is set where it does not, negative for a signal."""
        if self.code is None and (found := os.waitpid(self.pid, os.WNOHANG))[0]:
            self.code = os.waitstatus_to_exitcode(found[1])
        return self.code is None

    def send(self, number: int) -> None:
        if self.alive:
            os.kill(self.pid, number)

    def close(self, number: int = signal.SIGTERM) -> None:
        """End it, and remove its files."""
        self.connection.close()
        self.send(number)
        deadline = time.monotonic() + STOP_SECONDS
        while self.alive:
            if time.monotonic() > deadline:
                self.send(signal.SIGKILL)
            time.sleep(POLL_SECONDS)
        with contextlib.suppress(OSError):
            lines = Path(self.folder.name, STACK_FILE).read_text(errors="replace").splitlines()
            self.stack = [line.strip() for line in lines if line.lstrip().startswith("File ")][:MAX_CALLS]
        self.folder.cleanup()


class Isolated(Generic[Result]):
    """A function whose calls are made in forks, as many as there are calls at a time; direct calls without os.fork.

    Forks stay for further calls within `kept`, which is where calls have to be made.
    """

    def __init__(self, function: Callable[..., Result], seconds: float = CALL_SECONDS) -> None:
        self.function, self.seconds = function, seconds
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._busy: set[Worker] = set()
        self._users = 0
        self._stopped = False

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Keep forks; after the outermost of nested contexts there are none."""
        with self._lock:
            self._stopped = self._stopped and self._users > 0
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                ended, self._idle = ([], self._idle) if self._users else (self._idle, [])
            for worker in ended:
                worker.close()

    def stop(self) -> None:
        """End calls that are being made, each with WorkerEnded, and refuse others: for Ctrl-C amid threads."""
        with self._lock:
            self._stopped = True
            for worker in self._busy:
                worker.send(signal.SIGTERM)

    def __call__(self, *args: Any, **options: Any) -> Result:
        """Raises WorkerEnded beside the function's own exceptions."""
        if not hasattr(os, "fork"):
            return self.function(*args, **options)
        with self._lock:
            if self._stopped:
                raise WorkerEnded("stopped before it began")
            assert self._users, "a call outside of `kept` would leave its fork behind"
            worker = self._idle.pop() if self._idle else Worker(self.function)
            if not worker.alive:  # killed from outside, between two calls
                worker.close()
                worker = Worker(self.function)
            self._busy.add(worker)
        alive = True
        try:
            result: Result = worker.call(self.seconds, args, options)
            return result
        except WorkerEnded:
            alive = False
            raise
        finally:
            with self._lock:
                self._busy.discard(worker)
                if alive:
                    self._idle.append(worker)
