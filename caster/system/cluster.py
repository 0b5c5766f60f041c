"""Calls on a Dask cluster: results in order, each call by itself; one that ends its workers is one failure.

Loaded for `--engine dask` alone. The cluster is started here, on loopback, or is one that runs at a given address.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import pickle
import signal
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from time import monotonic
from typing import Any, NamedTuple

from caster.description.errors import SceneError
from caster.system.atomic_files import ScratchFolder
from caster.system.process import interrupted

__all__ = ["CallEnded", "Calls", "Cluster", "Outcome"]

DASK = "dask"  # the engine; "dask:ADDRESS" is a cluster that runs there
# Of a call whose worker ends: the first end may have had a reason outside of it, such as too little memory. A cluster
# that runs already has its own number: one more than the `allowed-failures` of its scheduler, which are 3 by default.
TRIES = 2
CLOSE_SECONDS = 1.0  # for workers to end before they are killed
CALLS_PER_WORKER = 3  # submitted and not finished: one runs, the others hide the time of a message
WAITING_RESULTS = 64  # finished calls that wait for an earlier one
CONNECT_SECONDS = 20.0  # for a scheduler to answer, and to answer again
POLL_SECONDS = 0.5  # between looks at interruptions and at the connection
LOOPBACK = "127.0.0.1"
INSTALL = "pip install 'ray-reference[cluster]'"


Calls = Iterable[tuple[Any, ...]]  # the arguments of each


class ClusterError(SceneError):
    """A cluster cannot be used, or was lost."""


class CallEnded(Exception):  # noqa: N818 - an event
    """The process of a call ended, or was killed at the deadline, before it returned; str() is how."""


class Outcome(NamedTuple):
    """How a call ended."""

    result: Any = None
    error: Exception | None = None  # which the function raised; CallEnded
    worker: Mapping[str, str] = {}  # what `identify` says of the process that ran it

    def value(self) -> Any:
        """The result. Raises the error."""
        if self.error:
            raise self.error
        return self.result


class _Call(NamedTuple):
    """A call and its surroundings, as they are sent to a worker."""

    function: Callable[..., Any]
    args: bytes  # a pickle, read in `folder`: a candidate imports modules from there
    folder: str  # the working folder, since paths are relative to it
    identify: Callable[[], Mapping[str, str]]
    expected: Mapping[str, str]
    seconds: float | None

    def __call__(self) -> Outcome:
        """Run in the worker, which a call without an end kills."""
        from distributed import get_worker

        found = self.identify()
        for name, value in self.expected.items():
            if found.get(name) != value:
                where = f"a worker on {os.uname().nodename}"
                return Outcome(error=ClusterError(f"{where}: its {name} is {found.get(name)}, expected {value}"))
        if (threads := get_worker().state.nthreads) != 1:  # the working folder and the time limit are the process's
            return Outcome(error=ClusterError(f"a worker has {threads} threads, expected one: --nthreads 1"))
        if self.seconds is not None:
            faulthandler.dump_traceback_later(self.seconds, exit=True, file=_NOWHERE)  # also in machine code
        try:
            os.chdir(self.folder)
            return Outcome(self.function(*pickle.loads(self.args)), worker=found)
        except Exception as error:
            error.add_note("".join(["In the worker:\n", *traceback.format_tb(error.__traceback__)]))
            return Outcome(error=error, worker=found)
        finally:
            faulthandler.cancel_dump_traceback_later()


_NOWHERE = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)  # for the traceback: workers have the terminal of the run


@contextmanager
def _sigint_ignored() -> Iterator[None]:
    """Processes that the body starts inherit that they ignore SIGINT; only the main thread may change signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _closed(cluster: Any) -> None:
    """End a cluster of this process; a worker in the middle of a call is killed."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if interrupted.is_set() and nanny.pid:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
    cluster.close(timeout=CLOSE_SECONDS)


class Cluster:
    """A connection to a cluster. Use it as a context."""

    def __init__(self, engine: str, workers: int, identify: Callable[[], Mapping[str, str]], *expected: str) -> None:
        """engine: "dask", which starts `workers` processes of one thread each here, or "dask:ADDRESS".

        identify: what a process is, by name; a worker that differs from this process in one of `expected` is refused.
        Raises ClusterError.
        """
        try:
            import dask
            import distributed
        except ImportError:
            raise ClusterError(f"--engine {engine}: the package distributed is not installed: {INSTALL}") from None
        self.engine, self.identify = engine, identify
        own = identify()
        self.expected = {name: own[name] for name in expected}
        address = engine.removeprefix(DASK).removeprefix(":")
        if address.startswith("tls:") and not dask.config.get("distributed.comm.tls.ca-file", None):
            raise ClusterError(f"--engine {engine}: expected Dask's settings of TLS, such as a ca-file; there are none")
        self._stack = ExitStack()
        # A worker gets no call beyond the one that it runs, so that none is suspected of what another one did.
        settings = {
            "distributed.scheduler.allowed-failures": TRIES - 1,
            "distributed.scheduler.worker-saturation": 1.0,
            "distributed.comm.timeouts.connect": f"{CONNECT_SECONDS:g}s",
            "distributed.worker.daemon": False,  # a candidate may start processes
            "temporary-directory": self._stack.enter_context(ScratchFolder()),
        }
        self._ended = threading.Event()  # set at the end of each call
        self._stack.enter_context(dask.config.set(settings))
        try:
            start: Any = distributed.LocalCluster
            connect: Any = distributed.Client
            if not address:
                # silence_logs ends with the cluster, and its connections report their end after that
                logging.getLogger("distributed").setLevel(logging.CRITICAL)
                with _sigint_ignored():  # by the workers, which the run ends after Ctrl-C in the terminal
                    cluster = start(
                        n_workers=workers,
                        threads_per_worker=1,
                        host=LOOPBACK,
                        dashboard_address=f"{LOOPBACK}:0",  # None would take port 8787
                        silence_logs=logging.CRITICAL,
                    )
                self._stack.callback(_closed, cluster)
                address = cluster.scheduler_address
            self.client = self._stack.enter_context(connect(address, timeout=CONNECT_SECONDS, set_as_default=False))
            if engine != DASK:  # a worker of an earlier run has modules and programs of candidates as they were then
                old = [*self.client.scheduler_info(n_workers=-1)["workers"]]
                self.client.restart_workers(old, timeout=CONNECT_SECONDS)
                self.client.wait_for_workers(1, timeout=CONNECT_SECONDS)
        except (OSError, ValueError, RuntimeError) as error:  # TimeoutError is an OSError
            self._stack.close()
            raise ClusterError(
                f"--engine {engine}: no scheduler with workers answers there ({error or type(error).__name__}); "
                "`dask scheduler` prints the address of the one that it starts"
            ) from error

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):  # of a cluster that is lost already
            self._stack.close()

    def check_one_worker_a_machine(self) -> None:
        """Raise ClusterError where workers would disturb each other's times."""
        hosts = Counter(worker["host"] for worker in self.client.scheduler_info(n_workers=-1)["workers"].values())
        if crowded := [f"{count} on {host}" for host, count in hosts.items() if count > 1]:
            raise ClusterError(f"--engine {self.engine}: expected one worker a machine, got {', '.join(crowded)}")

    def map(
        self, function: Callable[..., Any], calls: Calls, seconds: float | None = None, waiting: int = WAITING_RESULTS
    ) -> Generator[Outcome, None, None]:
        """function(*args) for each of the calls; outcomes in their order. The function is imported by the workers.

        seconds: time limit of one call. waiting: how many finished calls at most wait for an earlier one. Raises
        ClusterError for a lost cluster, and for a worker that differs.
        """
        sent: deque[Any] = deque()  # futures, in the order of the calls
        found: dict[Any, Outcome] = {}  # of those that are finished, and wait for an earlier one
        try:
            for args in calls:
                workers = self.client.scheduler_info(n_workers=-1).get("workers", ())
                room = CALLS_PER_WORKER * max(1, len(workers))  # also while the cluster is not connected
                while len(found) >= waiting or len(sent) - len(found) >= room:
                    yield from self._finished(sent, found)
                call = _Call(function, pickle.dumps(args), os.getcwd(), self.identify, self.expected, seconds)
                future = self.client.submit(call, pure=False)
                future.add_done_callback(lambda _: self._ended.set())
                sent.append(future)
            while sent:
                yield from self._finished(sent, found)
        finally:
            with suppress(Exception):
                self.client.cancel([*sent], force=True)

    def _finished(self, sent: deque[Any], found: dict[Any, Outcome]) -> Iterator[Outcome]:
        """Wait for a call to finish, then take outcomes from the left as far as there are any.

        Every result is fetched at once: one that only a worker has is lost with it, and its call runs again.
        """
        lost = monotonic() + CONNECT_SECONDS
        while not (ended := [future for future in sent if future not in found and future.done()]):
            if interrupted.is_set():
                raise KeyboardInterrupt
            self._ended.wait(POLL_SECONDS)
            self._ended.clear()
            if self.client.status == "running":
                lost = monotonic() + CONNECT_SECONDS
            elif monotonic() > lost:
                raise self._lost()
        found |= {future: self._outcome(future) for future in ended}
        while sent and sent[0] in found:
            yield found.pop(sent.popleft())

    def _lost(self) -> ClusterError:
        return ClusterError(f"--engine {self.engine}: the scheduler is gone; what is finished is kept")

    def _outcome(self, future: Any) -> Outcome:
        from distributed.scheduler import KilledWorker

        try:
            outcome: Outcome = future.result()
        except KilledWorker:
            return Outcome(error=CallEnded("a crash or the time limit, each time it was tried"))
        except Exception as error:  # of Dask itself, such as a result without a pickle
            if future.cancelled():
                raise self._lost() from error
            return Outcome(error=error)
        if isinstance(outcome.error, ClusterError):
            raise outcome.error
        return outcome
