"""Rasterization: primitives are bounded on the screen, sorted into tiles and tested in the pixels of their bounds."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.jit.command_list import Command, CommandList
from caster.jit.decorators import implements
from caster.kernels.bvh.build import BOX_PADDING, hulls_of
from caster.kernels.protocol import distortion_bound, project_bounding_sphere, tight_sphere
from caster.kernels.raster.screen_bounds import (
    PROJECTION_MARGIN,
    ScreenBounds,
    Window,
    bound_hulls,
    bound_spheres,
    project_vertices,
)
from caster.kernels.raster.tile import BOX, DEPTH_BUCKETS, HEIGHT, WIDTH, bin_into_tiles
from caster.kernels.triangles import Triangles
from caster.rendering.ray_tiles import placed_kinds
from caster.rendering.threads import even_pieces, parallel_for, parallel_for_pieces, thread_count, unwritten_array

# Points or primitives: to bound fewer takes less time than a second thread takes to begin.
PARALLEL_MIN_PRIMITIVES = 4096


@dataclass(frozen=True)
class BinnedKind:
    """The primitives of a kind, and those of each tile of the window."""

    kind: Kind
    bounds: ScreenBounds
    base: int  # place of its first primitive, counted kind by kind
    runs: np.ndarray  # int64; tile n has primitives order[runs[n]:runs[n + 1]]
    order: np.ndarray  # int32, primitive numbers within the kind, roughly from front to back

    @property
    def on_film(self) -> np.ndarray:
        """(n,) bool: the primitives of any tile."""
        x_start, y_start, x_stop, y_stop = self.bounds.pixels.T
        return (x_start < x_stop) & (y_start < y_stop)


PIECES_PER_THREAD = 32  # few enough that Python code does not count, enough to share the work evenly
MAX_TILES_PER_PIECE = 16  # so that signals are handled and progress is reported often, between pieces


def parallel_for_tiles(
    begin: Callable[[], Iterable[Command]],
    rows: np.ndarray,
    threads: int | None,
    on_progress: Callable[[int], None] | None = None,
) -> None:
    """Run commands for the rows of all tiles (`tile_rows`); `begin` makes those of each thread.

    on_progress: is called with the number of pixels just done.
    """

    def done(piece: tuple[int, int]) -> None:
        assert on_progress is not None
        x0, y0, x1, y1 = rows[slice(*piece), BOX].T
        on_progress(int(((x1 - x0) * (y1 - y0)).sum()))

    def begin_pieces() -> Callable[[tuple[int, int]], None]:
        run = CommandList(begin(), rows).run
        return lambda piece: run(*piece)

    workers = thread_count(threads)
    number = min(len(rows), max(workers * PIECES_PER_THREAD, -(-len(rows) // MAX_TILES_PER_PIECE)))
    parallel_for_pieces(begin_pieces, even_pieces(len(rows), number), workers, done if on_progress else None)


def bin_kinds(
    packed: Packed, camera: Any, window: Window, origin: float, threads: int | None = None
) -> list[BinnedKind]:
    """Sort all primitives into tiles. origin: the largest |coordinate| of a camera ray's origin."""
    rectilinear = not implements(distortion_bound, type(camera))

    def sort(kind: Kind, base: int) -> BinnedKind:
        slack = BOX_PADDING * (origin + kind.extent) if kind.bounded else 0.0
        reach, number, triangles = (slack, PROJECTION_MARGIN), len(kind.ids), isinstance(kind.prims, Triangles)
        spheres = implements(tight_sphere, type(kind.prims)) and implements(project_bounding_sphere, type(camera))
        points, corners = (np.empty((0, 3)), NO_FACES) if spheres else hulls_of(kind.prims, number)
        pixels, near = unwritten_array((number, 4), np.int32), unwritten_array((number,), np.float64)
        projected = unwritten_array((len(points), 4), np.float64)
        # a rectilinear camera keeps edges straight
        faces = corners if rectilinear and triangles else NO_FACES
        bounds = ScreenBounds(pixels, near, faces, projected)
        find = partial(project_vertices, points, camera, window, projected, reach)
        parallel_for(find, len(points), threads, least=PARALLEL_MIN_PRIMITIVES)
        if spheres:
            find = partial(bound_spheres, kind.prims, camera, window, bounds, reach)
        else:
            find = partial(bound_hulls, points, corners, camera, window, bounds, reach)
        parallel_for(find, number, threads, least=PARALLEL_MIN_PRIMITIVES)
        # the eye is no farther from a point than sqrt(3) times the largest coordinates together
        farthest = 2.0 * (origin + kind.extent) if kind.bounded else 1.0
        return _bin_into_tiles(kind, base, window, bounds, farthest, threads)

    return [sort(kind, base) for kind, base in placed_kinds(packed)]


NO_FACES = np.empty((0, 3), np.int32)


def _bin_into_tiles(
    kind: Kind, base: int, window: Window, bounds: ScreenBounds, farthest: float, threads: int | None
) -> BinnedKind:
    """Sort primitives into tiles, in parallel. farthest: an upper bound of all depths."""
    across, down = len(range(0, window.width, WIDTH)), len(range(0, window.height, HEIGHT))
    bits, number = bounds.near.view(np.int64), len(bounds.near)
    last = int(np.float64(farthest).view(np.int64))
    # Few primitives are sorted completely, since large ones may hide many.
    queue = np.argsort(bounds.near, kind="stable") if number < PARALLEL_MIN_PRIMITIVES else np.empty(0)
    about = bounds.pixels, bits, last, queue.astype(np.int32), across
    workers = max(1, min(thread_count(threads), number // PARALLEL_MIN_PRIMITIVES))
    parts = [(i, number * i // workers, number * (i + 1) // workers) for i in range(workers)]
    counts = np.zeros((workers, across * down * DEPTH_BUCKETS), np.int64)

    def work(ends: np.ndarray, order: np.ndarray, part: tuple[int, int, int]) -> None:
        i, start, stop = part
        bin_into_tiles(*about, ends[i], order, start, stop)

    parallel_for_pieces(lambda: partial(work, counts, np.empty(0, np.int32)), parts, workers)
    # in each depth bucket of each tile, what the first part has comes first: the same order for any number of threads
    ends = np.cumsum(counts.T.reshape(-1)).reshape(-1, workers).T
    starts = np.ascontiguousarray(ends - counts)
    order = np.empty(ends[-1, -1], np.int32)
    runs = np.append(starts[0, ::DEPTH_BUCKETS], len(order))
    parallel_for_pieces(lambda: partial(work, starts, order), parts, workers)
    return BinnedKind(kind, bounds, base, runs, order)
