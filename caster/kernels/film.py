"""Depth and normals of many tiles in one go, for scenes of one kind: rays, hits and images without a step of Python.

Steps of Python are taken by one thread at a time, and waiting for one's turn costs more than they do.
"""

from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.paint import paint_normals, paint_nothing, paint_seen
from caster.kernels.screen import cast_own_origins, cast_shared_origin
from caster.kernels.tile import HEIGHT, WIDTH, Box, shoot_rays


@inlined
def box_of(window: Any, number: int) -> Box:
    """The pixels of a tile of the window; tiles go row by row."""
    across = -(-window.width // WIDTH)
    x, y = number % across * WIDTH, number // across * HEIGHT
    return x, y, min(x + WIDTH, window.width), min(y + HEIGHT, window.height)


@jit
def film_from_one_point(
    camera: Any, window: Any, kind: Any, reach: float, tiles: Any, tile: Any, images: Any
) -> None:
    """Tiles tiles[0]..tiles[1] of a film whose rays start in one point.

    kind: (prims, order, runs, spans) of film_casting.Sorted; images: hit, doubt, depth and normal, without size where
    they were not asked for.
    """
    prims, order, runs, spans = kind
    for number in range(tiles[0], tiles[1]):
        box, run = box_of(window, number), (runs[number], runs[number + 1])
        if run[0] == run[1]:
            paint_nothing(box, images[2])
            continue
        shoot_rays(camera, window, box, tile)
        cast_shared_origin(prims, order, run, spans, 0, box, tile)
        _paint(prims, spans, reach, tile, box, images)


@jit
def film_in_one_direction(
    camera: Any, window: Any, kind: Any, reach: float, tiles: Any, tile: Any, images: Any
) -> None:
    """The same for parallel rays."""
    prims, order, runs, spans = kind
    for number in range(tiles[0], tiles[1]):
        box, run = box_of(window, number), (runs[number], runs[number + 1])
        if run[0] == run[1]:
            paint_nothing(box, images[2])
            continue
        shoot_rays(camera, window, box, tile)
        cast_own_origins(prims, order, run, spans, 0, box, tile)
        _paint(prims, spans, reach, tile, box, images)


@inlined
def _paint(prims: Any, spans: Any, reach: float, tile: Any, box: Box, images: Any) -> None:
    hit, doubt, depth, normal = images
    if normal.size > 0:
        paint_normals(prims, (0, len(spans.near)), reach, tile, box, normal)
    paint_seen(tile, box, hit, doubt, depth)
