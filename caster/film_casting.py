"""Rays of a film in, nearest hits out, tile by tile: each primitive against the pixels of its picture."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from caster.casting import bases, decide_doubtful, ids_by_place
from caster.kernels.nearest import Nearest, Rays, no_hits
from caster.kernels.screen import (
    MARGIN,
    Window,
    cast_own_origins,
    cast_shared_origin,
    count_in_tiles,
    find_spans,
    sort_into_tiles,
)
from caster.kernels.tile import HEIGHT, WIDTH, Box, load_rays, new_tile, store_nearest
from caster.kernels.tree import REACH
from caster.packing import Kind, Packed
from caster.threads import finish, in_bands, thread_count


@dataclass(frozen=True)
class Sorted:
    """The primitives of a kind, and in which tiles of the window each is to be looked for."""

    kind: Kind
    spans: np.ndarray  # (n, 4) int32: x_start, y_start, x_stop, y_stop in the window
    places: tuple[int, int]  # of its primitives, counted kind by kind
    runs: list[int]  # tile n has primitives order[runs[n]:runs[n + 1]]
    order: np.ndarray  # int32, primitive numbers within the kind


def find_nearest_on_film(
    packed: Packed,
    rays: Rays,
    camera: Any,
    window: Window,
    shares_origin: bool,
    threads: int | None = None,
    *,
    off_centre: float = 0.0,
) -> Nearest:
    """The nearest hit of a camera's own rays; off_centre: by how many pixels they may pass their pixel's centre."""
    origin = float(np.abs(rays.o).max(initial=0.0))
    kinds = sorted_kinds(packed, camera, window, origin, threads, off_centre)
    cast = cast_shared_origin if shares_origin else cast_own_origins
    nearest, doubt = no_hits(len(rays.t_min)), np.zeros(len(rays.t_min), bool)
    ids = ids_by_place(packed)

    def work(number: int, box: Box, tile: np.ndarray) -> None:
        load_rays(rays, window.width, box, tile)
        cast_tile(cast, kinds, number, box, tile)
        store_nearest(tile, ids, window.width, box, nearest, doubt)

    in_tiles(work, window, threads)
    return decide_doubtful(packed, rays, nearest, doubt, threads)


def cast_tile(
    cast: Callable[..., None], kinds: list[Sorted], number: int, box: Box, tile: np.ndarray
) -> None:
    """Everything that may be seen in a tile."""
    for it in kinds:
        run = it.runs[number], it.runs[number + 1]
        if run[0] < run[1]:
            cast(it.kind.prims, it.order, run, it.spans, it.places[0], box, tile)


def boxes(window: Window) -> Iterator[Box]:
    """The tiles of a window, row by row."""
    for y in range(0, window.height, HEIGHT):
        for x in range(0, window.width, WIDTH):
            yield x, y, min(x + WIDTH, window.width), min(y + HEIGHT, window.height)


def in_tiles(
    work: Callable[[int, Box, np.ndarray], None], window: Window, threads: int | None = None
) -> None:
    """Call work(number, box, tile) for each tile of the window; every thread has one array, for one tile at a time."""
    every = list(enumerate(boxes(window)))
    left, workers = iter(every), min(thread_count(threads), len(every))

    def go() -> None:
        tile = new_tile()
        for number, box in left:  # one step of a list's iterator at a time: no two threads get the same
            work(number, box, tile)

    if workers == 1:
        go()
        return
    with ThreadPoolExecutor(workers) as pool:
        try:
            finish(pool, [pool.submit(go) for _ in range(workers)])
        except BaseException:
            for _ in left:
                pass
            raise


def sorted_kinds(
    packed: Packed,
    camera: Any,
    window: Window,
    origin: float,
    threads: int | None = None,
    off_centre: float = 0.0,
) -> list[Sorted]:
    """Where to look for each primitive.

    origin: the largest |coordinate| of a ray's origin; off_centre: how far from the centres of pixels rays may pass.
    """

    def sort(kind: Kind, base: int) -> Sorted:
        slack = REACH * (origin + kind.extent) if kind.bounded else 0.0
        spans, reach = np.empty((len(kind.ids), 4), np.int32), (slack, MARGIN + off_centre)
        in_bands(partial(find_spans, kind.prims, camera, window, spans, reach), len(spans), threads)
        return _into_tiles(kind, base, window, spans)

    return [sort(kind, base) for kind, base in zip(packed.kinds, bases(packed), strict=True)]


def _into_tiles(kind: Kind, base: int, window: Window, spans: np.ndarray) -> Sorted:
    across, down = len(range(0, window.width, WIDTH)), len(range(0, window.height, HEIGHT))
    counts = np.zeros(across * down + 1, np.int64)
    count_in_tiles(spans, across, counts)
    ends = np.cumsum(counts)
    runs = ends.tolist()
    order = np.empty(runs[-1], np.int32)
    sort_into_tiles(spans, across, ends, order)
    return Sorted(kind, spans, (base, base + len(kind.ids)), runs, order)
