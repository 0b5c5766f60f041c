"""Engines, which run a command's calls in processes or threads of this machine, or on a Dask cluster.

Each call is one scene, example or sweep, from 0.1 s to some seconds of work, and takes and returns picklable values.
Results are the same on every engine, since a call depends on its arguments alone.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from caster.rendering.threads import core_count
from caster.system import process
from caster.system.cluster import Calls, Cluster, Outcome
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.store import LIBRARIES, PROCESSOR, machine
from mitsuba_ref.runner.verdict_files import SETTINGS, SOURCES, worker_identity
from mitsuba_ref.runner.workers import CALL_TIMEOUTS, Workers

LOCAL = "local"
INTERRUPTED_SECONDS = 1.5  # after an interruption, for calls in progress to end
CALLS_AHEAD = 32  # calls of a worker that may be submitted before the outcome of the first is taken


@dataclass
class Engine:
    """Runs calls on a cluster, in forks of this process, or in its threads."""

    workers: int  # calls at a time on this machine
    seconds: float  # time limit of a call
    pool: Workers | None = None
    cluster: Cluster | None = None
    processors: frozenset[str] = frozenset()  # of the machines that ran calls

    def map(
        self, function: Callable[..., Any], calls: Calls, then: Callable[[Any], Any] = lambda result: result
    ) -> Generator[Outcome, None, None]:
        """function(*args) for each of the calls, several at a time; outcomes in their order.

        then: turns each returned value into a result, in this process and at once. No further call starts after an
        interruption.
        """
        if self.cluster:
            with closing(self.cluster.map(function, calls, self.seconds)) as outcomes:
                for outcome in outcomes:
                    self.processors |= {outcome.worker[PROCESSOR]} if outcome.worker else set()
                    yield outcome if outcome.error else _outcome_of(then, (outcome.result,))
            return
        self.processors = frozenset({machine()[PROCESSOR]})
        pool = self.pool

        def work(args: tuple[Any, ...]) -> Outcome:
            return _outcome_of(lambda *given: then(pool.call(function, *given) if pool else function(*given)), args)

        threads = ThreadPoolExecutor(self.workers)
        futures = deque[Future[Outcome]]()
        try:
            for args in calls:
                futures.append(threads.submit(work, args))
                if len(futures) >= CALLS_AHEAD * self.workers:
                    yield futures[0].result()
                    futures.popleft()  # so that the result can be released
            while futures:
                yield futures[0].result()
                futures.popleft()
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            subprocess_runner.kill_subprocesses()
            if pool:
                pool.stop()
            if process.interrupted.is_set():  # work in compiled code ends with the process
                wait([each for each in futures if each.running()], timeout=INTERRUPTED_SECONDS)
            else:
                threads.shutdown(wait=True)
            subprocess_runner.allow_subprocesses()


def _outcome_of(function: Callable[..., Any], args: tuple[Any, ...]) -> Outcome:
    try:
        return Outcome(function(*args))
    except Exception as error:
        return Outcome(error=error)


@contextlib.contextmanager
def opened(name: str, workers: int | None, seconds: float, *, forks: bool) -> Iterator[Engine]:
    """The engine that the value of --engine names. Raises ClusterError.

    workers: calls at a time on this machine; None: one a core. seconds: time limit of a call. forks: False for calls
    that need this process, since no module defines the candidate's function.
    """
    count = workers or core_count()
    if name != LOCAL:
        # a worker that differs in one of these is refused
        with Cluster(name, count, worker_identity, SOURCES, SETTINGS, "python", *LIBRARIES) as cluster:
            yield Engine(count, seconds, cluster=cluster)
        return
    with Workers(seconds) if forks else contextlib.nullcontext() as pool:
        yield Engine(count, seconds, pool)


def outcomes_of(
    name: str,
    workers: int | None,
    function: Callable[..., Any],
    calls: Calls,
    then: Callable[[Any], Any] = lambda result: result,
    *,
    forks: bool = True,
) -> Generator[Outcome, None, None]:
    """The outcomes of an engine that is opened for these calls alone. Arguments as for `opened` and `Engine.map`."""
    with (
        opened(name, workers, CALL_TIMEOUTS * DEFAULT_TIMEOUT, forks=forks) as engine,
        closing(engine.map(function, calls, then)) as outcomes,
    ):
        yield from outcomes
