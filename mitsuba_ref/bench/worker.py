"""A contestant's process, which stays and answers requests, JSON each, so that contestants can take turns.

python -m mitsuba_ref.bench.worker WORK NOTICES

WORK: Work as JSON; NOTICES: number of the file that compilation is reported to
"""

import gc
import json
import os
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from caster.system.terminal import compilation_reported
from mitsuba_ref.bench.entries import CannotRun, Entry, Work
from mitsuba_ref.reference.subprocess_runner import serve

STATUS_READY, STATUS_CANNOT = "ready", "cannot"


def main(work: Work, notices: int) -> None:
    """Answer questions until stdin ends."""
    pin_to_processors(work.threads)
    entry: Entry | None = None

    def reply_to(line: bytes) -> bytes:
        nonlocal entry
        request = json.loads(line)
        try:
            if entry is None or request["do"] == "build":
                entry = None  # before the next is made: two at a time take twice the memory
                entry = new_entry(work)
            return json.dumps({"status": STATUS_READY} | respond(entry, request)).encode()
        except (CannotRun, ImportError) as reason:
            return json.dumps({"status": STATUS_CANNOT, "why": " ".join(str(reason).split())}).encode()

    with os.fdopen(notices, "w") as stream, compilation_reported(stream):
        serve(reply_to)


def new_entry(work: Work) -> Entry:
    """The contestant, with nothing built."""
    gc.collect()
    module, _, name = work.entry.partition(":")
    entry: Entry = getattr(import_module(f"mitsuba_ref.bench.{module}"), name)(work)
    return entry


def pin_to_processors(processors: int) -> None:
    """Pin this process to so many processors, before any threads are started."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[:processors]))


def respond(entry: Entry, request: dict[str, Any]) -> dict[str, Any]:
    """One question: build, cast, answer or memory."""
    if request["do"] == "build":
        start = time.perf_counter()
        entry.build(request["size"])
        seconds = time.perf_counter() - start
        entry.take_rays()
        return {"seconds": seconds}
    if request["do"] == "cast":
        return cast(entry, request["least"])
    if request["do"] == "answer":
        with np.load(request["rays"]) as rays:
            np.save(request["out"], entry.answer(rays["o"], rays["d"]))
        return {}
    return {"bytes": getattr(entry, "peak_memory", peak_memory)()}


def cast(entry: Entry, least: float) -> dict[str, Any]:
    """The median of as many casts as fit into `least` seconds, one at least."""
    seconds: list[float] = []
    rays = 0
    while not seconds or sum(seconds) < least:
        start = time.perf_counter()
        rays = entry.cast()
        seconds.append(time.perf_counter() - start)
    return {"seconds": float(np.median(seconds)), "casts": len(seconds), "rays": rays}


def peak_memory() -> int:
    """Most bytes that this process had in memory, all libraries and Python included.

    Linux counts in ru_maxrss also what the process had that started this one, but not in VmHWM.
    """
    import resource  # POSIX alone

    try:
        status = Path("/proc/self/status").read_text()
        return next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


if __name__ == "__main__":
    main(Work(**json.loads(sys.argv[1])), int(sys.argv[2]))
