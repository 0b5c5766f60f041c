"""Loops on several threads, since kernels release the GIL, and reuse of the memory of large arrays."""

import contextlib
import ctypes
import math
import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

__all__ = ["core_count", "set_default_threads"]

CHUNKS_PER_THREAD = 4  # pieces of unequal cost are shared evenly

Piece = TypeVar("Piece")


_default_threads: int | None = None  # None: one a core


def set_default_threads(count: int | None) -> None:
    """Set the number of threads that is used if none is requested; None: one a core."""
    global _default_threads
    _default_threads = count


@contextlib.contextmanager
def default_threads(count: int) -> Iterator[None]:
    """Set the number of threads that is used if none is requested, within the body."""
    before = _default_threads
    set_default_threads(count)
    try:
        yield
    finally:
        set_default_threads(before)


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(requested: int | None = None) -> int:
    """The requested number of threads, or else the default of this process."""
    return requested or _default_threads or core_count()


def parallel_for(work: Callable[[int, int], None], count: int, threads: int | None = None, *, least: int = 1) -> None:
    """Call work(start, stop) for pieces of 0..count. least: the items that are worth a further thread."""
    least = max(least, 1)
    workers = max(1, min(thread_count(threads), count // least))
    pieces = min(workers * CHUNKS_PER_THREAD, count if workers > 1 else -(-count // least))
    parallel_for_pieces(lambda: lambda band: work(*band), even_pieces(count, pieces), workers)


def even_pieces(stop: int, count: int) -> list[tuple[int, int]]:
    """Divide 0..stop into `count` pieces (start, stop), whose lengths differ by at most 1."""
    return list(pairwise(stop * i // max(count, 1) for i in range(count + 1)))


def parallel_for_pieces(
    begin: Callable[[], Callable[[Piece], None]],
    pieces: Sequence[Piece],
    workers: int,
    done: Callable[[Piece], None] | None = None,
) -> None:
    """Process pieces on several threads, including this one; `begin` makes the function of each thread.

    done: is called after each piece, by its thread. After an error or an interruption no further piece begins; the
    first error is raised.
    """
    left = iter(pieces)  # the iterator of a list is thread-safe: no two threads get the same piece

    def go() -> None:
        work = None
        try:
            for piece in left:  # signals are handled between two pieces
                work = work or begin()  # only in threads that get a piece
                work(piece)
                if done is not None:
                    done(piece)
        except BaseException:
            for _ in left:
                pass
            raise

    others = [_pool(workers - 1).submit(go) for _ in range(min(workers, len(pieces)) - 1)]
    try:
        go()
    finally:
        # Threads that have not begun need not; the others use the caller's arrays, so this one waits for them.
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    """Threads are kept, since starting them takes as long as a small film."""
    return ThreadPoolExecutor(workers, thread_name_prefix="caster")


os.register_at_fork(after_in_child=_pool.cache_clear)  # a child has none of them


# Memory of arrays that are no longer referenced is reused: the system clears and maps each page of new memory when it
# is first written, which takes longer than most AOVs. Spare memory suffices for a million float64 rays with their hits,
# or for eight images of as many vectors.
MAX_SPARE_BYTES = 3 << 26
MIN_SPARE_BYTES = 1 << 17  # smaller arrays come from memory that the process has anyway

_SPARE_BLOCKS: dict[int, np.ndarray] = {}  # by id, oldest first


def unwritten_array(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An uninitialised array; its memory is reused once nothing refers to it or a view of it."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < MIN_SPARE_BYTES:
        return np.empty(shape, dtype)
    for key, block in list(_SPARE_BLOCKS.items()):
        if block.nbytes == size and _SPARE_BLOCKS.pop(key, None) is not None:  # else another thread took it
            break
    else:
        block = np.empty(size, np.uint8)
    owner = (ctypes.c_char * size).from_address(block.ctypes.data)
    weakref.finalize(owner, _give_back_block, block).atexit = False
    return np.frombuffer(owner, dtype).reshape(shape)


def _give_back_block(block: np.ndarray) -> None:
    """Keep a block as long as newer ones leave space. It may be called in any thread, at any time."""
    _SPARE_BLOCKS[id(block)] = block
    spare = list(_SPARE_BLOCKS.items())
    excess = sum(each.nbytes for _, each in spare) - MAX_SPARE_BYTES
    for key, each in spare:
        if excess > 0:
            excess -= each.nbytes
            _SPARE_BLOCKS.pop(key, None)
