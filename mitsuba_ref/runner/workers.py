"""Workers: forks of this process that serve calls. A crash or a hang ends one call, and the worker is replaced.

No library is used: loky and concurrent.futures give up all calls after a crash, and pebble after the end of an idle
worker. Here each worker has its own pipe.
"""

import contextlib
import faulthandler
import math
import multiprocessing
import os
import pickle
import signal
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from caster.system.atomic_files import ScratchFolder
from caster.system.cluster import CallEnded
from caster.system.process import PARENT_VARIABLE, die_with_parent
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.subprocess_runner import exit_name, kill_group, kill_subprocesses

Result = TypeVar("Result")

# Compiling all kernels, our caster and two processes of Mitsuba may each take as long as one process of Mitsuba.
CALL_TIMEOUTS = 4.0
STOP_SECONDS = 2.0  # for a worker to remove its files after SIGTERM, before it is killed
POLL_SECONDS = 0.2  # between looks at a worker that has not replied
STACK_FILE, MAX_CALLS = "stack", 4  # innermost Python calls of a crash

_forking = threading.Lock()  # a second fork at the same time would keep the first one's pipe open


class Worker:
    """One fork of this process."""

    def __init__(self, *, daemon: bool = True) -> None:
        """daemon: False for one that may run a candidate, which may start processes of its own."""
        self.folder = ScratchFolder()  # all temporary files of the fork
        with _forking:
            self.connection, remote = multiprocessing.Pipe()
            context = multiprocessing.get_context("fork")
            ends = remote, self.connection
            self.process = context.Process(target=_serve, args=(*ends, self.folder.name), daemon=daemon)
            self.process.start()
            remote.close()

    def call(self, seconds: float | None, function: Callable[..., Result], args: tuple[Any, ...]) -> Result:
        """function(*args), with its exceptions, within `seconds`. Raises CallEnded after closing the worker."""
        with contextlib.suppress(OSError):  # it has ended, which `reply` reports
            self.connection.send((function, args))
        return self.reply(seconds)

    def reply(self, seconds: float | None) -> Any:
        """The reply to a call. Raises as `call` does."""
        end = math.inf if seconds is None else time.monotonic() + seconds
        try:
            while not self.connection.poll(POLL_SECONDS):
                if not self.process.is_alive():  # another process may hold its pipe open
                    raise EOFError
                if time.monotonic() > end:
                    self.close()
                    raise CallEnded(f"killed after {seconds:g} s without an answer")
            result, error = self.connection.recv()
        except (EOFError, OSError):
            self.process.join(STOP_SECONDS)
            code = self.process.exitcode
            stack = self.close()
            raise CallEnded("\n".join([exit_name(-signal.SIGKILL if code is None else code), *stack])) from None
        if error is not None:
            raise error
        return result

    def close(self) -> list[str]:
        """End the worker and remove its files; returns the last Python calls before a crash."""
        self.connection.close()
        self.process.terminate()
        self.process.join(STOP_SECONDS)
        self.process.kill()
        self.process.join()
        assert self.process.pid is not None  # it was started
        kill_group(self.process.pid)
        stack: list[str] = []
        with contextlib.suppress(OSError), Path(self.folder.name, STACK_FILE).open(errors="replace") as lines:
            stack = [line.strip() for line in lines if line.lstrip().startswith("File ")][:MAX_CALLS]
        self.folder.cleanup()
        return stack


def _serve(calls: Connection, parents_end: Connection, folder: str) -> None:
    """Serve calls in the fork, until the parent closes the pipe."""
    parents_end.close()
    os.setpgrp()  # so that Ctrl-C in the terminal comes through the parent
    for number in (signal.SIGINT, signal.SIGHUP):  # the parent passes them on as SIGTERM
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    os.environ.pop(PARENT_VARIABLE, None)  # it names the parent of the forked process
    die_with_parent()
    tempfile.tempdir = folder
    faulthandler.enable(os.open(Path(folder, STACK_FILE), os.O_WRONLY | os.O_CREAT), all_threads=False)
    try:
        while True:
            function, args = calls.recv()
            reply: tuple[Any, Exception | None]
            try:
                reply = function(*args), None
            except Exception as error:
                error.add_note("".join(["In the worker:\n", *traceback.format_tb(error.__traceback__)]))
                reply = None, error
            try:
                calls.send(reply)
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                calls.send((None, TypeError(f"{function}: its result has no pickle: {error}")))
    except (EOFError, OSError, KeyboardInterrupt):  # the last for SIGTERM
        # The end of the parent may send one more. Ignored, it would be reported where it arrives just now.
        signal.signal(signal.SIGTERM, lambda number, frame: None)
        kill_subprocesses()
        os._exit(0)
    except SystemExit as end:  # raised by the called function
        os._exit(end.code if isinstance(end.code, int) else 0)


class Workers:
    """A worker for each thread that calls. Use it as a context."""

    def __init__(self, seconds: float = CALL_TIMEOUTS * DEFAULT_TIMEOUT) -> None:
        """seconds: time limit of one call."""
        self.seconds = seconds
        self._of_thread = threading.local()
        self._lock = threading.Lock()
        self._all: list[Worker] = []
        self._stopped = False

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._all:
            worker.close()

    def stop(self) -> None:
        """End calls in progress, each with CallEnded, and refuse new ones: for Ctrl-C while threads wait."""
        with self._lock:
            self._stopped = True
            for worker in self._all:
                worker.process.terminate()

    def call(self, function: Callable[..., Result], *args: Any) -> Result:
        """function(*args) in the thread's worker. Raises CallEnded, and the function's own exceptions."""
        with self._lock:
            if self._stopped:
                raise CallEnded("stopped before it began")
            worker: Worker | None = getattr(self._of_thread, "worker", None)
            if worker is None or not worker.process.is_alive():  # after a crash, or killed from outside
                worker = self._of_thread.worker = Worker()
                self._all.append(worker)
        return worker.call(self.seconds, function, args)
