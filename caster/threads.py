"""Work in pieces, on as many threads as there are cores: kernels release the GIL."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise

import numpy as np

BANDS_PER_THREAD = 4  # small enough that a thread with an empty sky takes over work from one with a mesh


def thread_count(asked: int | None = None) -> int:
    """As many as asked for, else as many as this process may use."""
    if asked:
        return asked
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_bands(work: Callable[[int, int], None], count: int, threads: int | None = None) -> None:
    """Call work(start, stop) over 0..count in pieces; kernels release the GIL, so threads run together."""
    workers = thread_count(threads)
    edges = np.linspace(0, count, min(count, workers * BANDS_PER_THREAD) + 1).astype(int).tolist()
    if workers == 1 or count < 2:
        for start, stop in pairwise(edges):  # a signal is heard between two bands
            work(start, stop)
        return
    with ThreadPoolExecutor(workers) as pool:
        finish(pool, [pool.submit(work, start, stop) for start, stop in pairwise(edges)])


def finish(pool: ThreadPoolExecutor, futures: Iterable[Future[None]]) -> None:
    """Wait for all; after an error or an interruption, do not begin what has not begun."""
    try:
        for future in futures:
            future.result()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
