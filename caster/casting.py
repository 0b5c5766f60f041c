"""Rays in, nearest hits out: the three cullings, on as many threads as there are cores."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from caster.kernels.bvh import LEAF_SIZE, cast_bvh
from caster.kernels.everything import cast_everything
from caster.kernels.nearest import Nearest, Rays, no_hits
from caster.kernels.screen import Window, cast_own_origins, cast_shared_origin, find_spans
from caster.packing import Kind, Packed

Culling = Literal["everything", "screen", "bvh"]

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


def find_nearest(packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None) -> Nearest:
    """The nearest hit of any rays."""
    nearest = no_hits(len(rays.t_min))
    for kind in packed.kinds:
        cast = _by_tree if culling == "bvh" and worth_a_tree(kind) else _by_everything
        in_bands(cast(kind, rays, nearest), len(rays.t_min), threads)
    return nearest


def worth_a_tree(kind: Kind) -> bool:
    return kind.bounded and len(kind.ids) > LEAF_SIZE


def _by_everything(kind: Kind, rays: Rays, nearest: Nearest) -> Callable[[int, int], None]:
    return lambda start, stop: cast_everything(kind.prims, kind.ids, rays, nearest, start, stop)


def _by_tree(kind: Kind, rays: Rays, nearest: Nearest) -> Callable[[int, int], None]:
    tree = kind.tree
    return lambda start, stop: cast_bvh(kind.prims, kind.ids, tree, rays, nearest, (start, stop))


def find_nearest_on_film(
    packed: Packed, rays: Rays, camera: Any, window: Window, shares_origin: bool, threads: int | None = None
) -> Nearest:
    """The nearest hit of a camera's own rays, primitive by primitive over the pixels of its picture."""
    nearest = no_hits(len(rays.t_min))
    cast = cast_shared_origin if shares_origin else cast_own_origins
    origin = float(np.abs(rays.o).max(initial=0.0))
    for kind in packed.kinds:
        slack = kind.reach * (origin + kind.extent) if kind.bounded else 0.0
        spans = np.empty((len(kind.ids), 4), np.int32)
        find_spans(kind.prims, camera, window, spans, slack)

        def work(start: int, stop: int, kind: Kind = kind, spans: np.ndarray = spans) -> None:
            cast(kind.prims, kind.ids, spans, rays, nearest, (window.width, start, stop))

        in_bands(work, window.height, threads)
    return nearest
