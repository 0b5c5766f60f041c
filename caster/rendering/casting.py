"""Nearest hits of any rays, on all cores. Rays that float64 leaves uncertain are cast again and decided exactly."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.kernels.bvh.traversal import find_first_in_tree
from caster.kernels.nearest import Nearest, Rays, find_first, hit_precedes, no_hits
from caster.kernels.raster.tile import load_rays, store_nearest
from caster.rendering.bvh_construction import bvh_of, has_bvh, uses_bvh
from caster.rendering.ray_fans import fan_tiles
from caster.rendering.ray_tiles import Piece, RayTiles, TileCaster, TileWorkspace, new_workspace, tiles_in_order
from caster.rendering.threads import parallel_for, parallel_for_pieces, thread_count, unwritten_array

__all__ = ["Culling", "find_any", "find_nearest"]

Culling = Literal["brute-force", "raster", "bvh"]


def trees_of(culling: Culling) -> Callable[[Kind], bool]:
    """Which kinds are cast at through their trees, if none are rasterized."""
    return uses_bvh if culling == "bvh" else lambda kind: False


def find_nearest(packed: Packed, rays: Rays, culling: Culling = "bvh", threads: int | None = None) -> Nearest:
    """The nearest hit of any rays."""
    trees = culling != "brute-force"
    tiles = fan_tiles(packed, rays, threads) if trees else None
    if tiles is None:
        tiles = tiles_in_order(TileCaster(packed, any_hit=False, uses_tree=trees_of(culling)), rays, threads)
    nearest, uncertain = cast_tiles(packed, rays, tiles, threads)
    rows = np.flatnonzero(uncertain)
    if len(rows):
        exact = exact_nearest(packed, rays.take(rows), threads, trees=trees)
        for everywhere, here in zip(nearest, exact, strict=True):
            everywhere[rows] = here
    return nearest


def cast_tiles(packed: Packed, rays: Rays, tiles: RayTiles, threads: int | None) -> tuple[Nearest, np.ndarray]:
    """(hits by float64, whether others may be nearer (n,) bool)."""
    count, ids = len(rays.t_min), packed.prim_ids
    # threads write all of it
    nearest = Nearest(*(unwritten_array((count,), dtype) for dtype in (float, np.int32, float)))
    uncertain = unwritten_array((count,), bool)
    tiles.caster.prepare(threads)

    def begin() -> Callable[[Piece], None]:
        workspace = TileWorkspace()
        tile = workspace.tile
        cast = tiles.caster.begin(tile, workspace.ray_groups)

        def work(piece: Piece) -> None:
            numbers = tiles.numbers(piece)
            load_rays(rays, numbers, tile)
            cast(len(numbers))
            store_nearest(tile, numbers, ids, nearest, uncertain)

        return work

    parallel_for_pieces(begin, tiles.pieces, min(thread_count(threads), len(tiles.pieces)))
    return nearest, uncertain


def find_any(packed: Packed, rays: Rays, threads: int | None = None) -> np.ndarray:
    """(n,) bool: whether rays hit anything at all (any-hit). Traversal ends at the first certain hit."""
    hits, uncertain = cast_tiles(packed, rays, tiles_in_order(TileCaster(packed, any_hit=True), rays, threads), threads)
    blocked = hits.prim >= 0
    rows = np.flatnonzero(uncertain & ~blocked)
    if len(rows):
        blocked[rows] = exact_nearest(packed, rays.take(rows), threads).prim >= 0
    return blocked


# For fewer rays, brute force takes less time than building a tree.
BVH_MIN_RAYS = 64

# Like MIN_RAYS_PER_THREAD, for rays that integers decide.
MIN_EXACT_PER_THREAD = 64


def exact_nearest(packed: Packed, rays: Rays, threads: int | None = None, *, trees: bool = True) -> Nearest:
    """The nearest hits of rays, decided exactly where float64 is uncertain; without trees, by brute force.

    The hits of float64 bound where the first hit is. Among all primitives that may be hit before, integers choose.
    """
    count, nearest = len(rays.t_min), no_hits(len(rays.t_min))

    def through_tree(kind: Kind) -> bool:
        return trees and uses_bvh(kind) and (count > BVH_MIN_RAYS or has_bvh(kind))

    caster = TileCaster(packed, any_hit=False, uses_tree=through_tree)
    sketch = cast_tiles(packed, rays, tiles_in_order(caster, rays, threads), threads)[0]
    for kind in packed.kinds:
        found = no_hits(count)

        def work(start: int, stop: int, kind: Kind = kind, found: Nearest = found) -> None:
            if through_tree(kind):
                find_first_in_tree(kind.prims, bvh_of(kind), new_workspace(), rays, sketch, found, start, stop)
            else:
                find_first(kind.prims, len(kind.ids), rays, sketch, found, start, stop)

        parallel_for(work, count, threads, least=MIN_EXACT_PER_THREAD)
        with np.errstate(over="ignore"):
            nearer = found.t + found.error < nearest.t - nearest.error
            uncertain = ~nearer & (found.t - found.error <= nearest.t + nearest.error)
        for i in np.flatnonzero(uncertain & (found.prim >= 0)).tolist():  # which kind comes first?
            k, held = int(found.prim[i]), int(nearest.prim[i])
            other, j = packed.place_of(held) if held >= 0 else (kind, k)
            nearer[i] = held < 0 or hit_precedes(kind.prims, k, int(kind.ids[k]), other.prims, j, held, rays, i)
        nearest.t[nearer], nearest.error[nearer] = found.t[nearer], found.error[nearer]
        nearest.prim[nearer] = kind.ids[found.prim[nearer]]
    hit = nearest.prim >= 0  # the exact t is in (t_min, t_max]; rounded to float64 it may lie outside
    nearest.t[hit] = np.clip(nearest.t[hit], np.nextafter(rays.t_min[hit], np.inf), rays.t_max[hit])
    return nearest
