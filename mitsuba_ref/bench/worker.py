"""A caster's process, which stays and answers requests, JSON each, so that casters can take turns.

python -m mitsuba_ref.bench.worker WORK

WORK: Work as JSON
"""

import gc
import json
import statistics
import sys
from importlib import import_module
from time import perf_counter
from typing import Any

from mitsuba_ref.bench.drivers import CannotRun, Driver, Work
from mitsuba_ref.reference.subprocess_runner import serve


class Worker:
    """Replies to the requests build, cast and answer."""

    driver: Driver | None = None

    def __init__(self, work: Work) -> None:
        self.work = work

    def reply(self, line: bytes) -> bytes:
        request = json.loads(line)
        try:
            return json.dumps(getattr(self, request.pop("do"))(**request)).encode()
        except CannotRun as reason:
            return json.dumps({"why": " ".join(str(reason).split())}).encode()

    def build(self, size: int) -> dict[str, Any]:
        """Create a caster and time its build."""
        self.driver = None  # before the next is made: two at a time take twice the memory
        gc.collect()
        module, _, name = self.work.driver.partition(":")
        self.driver = getattr(import_module(f"mitsuba_ref.bench.{module}"), name)(self.work)
        start = perf_counter()
        self.driver.build(size)
        seconds = perf_counter() - start
        self.driver.take_rays(size)
        return {"seconds": seconds}

    def cast(self, least: float) -> dict[str, Any]:
        """Cast repeatedly for `least` seconds, once at least; returns the median time."""
        assert self.driver is not None
        seconds: list[float] = []
        while not seconds or sum(seconds) < least:
            start = perf_counter()
            rays = self.driver.cast()
            seconds.append(perf_counter() - start)
        return {"seconds": statistics.median(seconds), "rays": rays}

    def answer(self, rows: list[int]) -> dict[str, Any]:
        """t of some of the scene's rays."""
        assert self.driver is not None
        t = self.driver.answer(*self.work.rays(rows))
        return {"t": t.tolist(), "precision": self.driver.precision}


if __name__ == "__main__":
    serve(Worker(Work(**json.loads(sys.argv[1]))).reply)
