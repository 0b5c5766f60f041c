"""From the hits of a tile to AOVs: one pass a tile for each thing that was asked for."""

import math
from typing import Any

from caster.jit.decorators import inlined, jit
from caster.jit.simd import LANES
from caster.kernels.protocol import fast_normal, normal, normal_setup
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    HEIGHT,
    NX,
    NY,
    NZ,
    OX,
    OY,
    OZ,
    PRIM,
    UNCERTAIN,
    WIDTH,
    Box,
    T,
    generate_camera_rays,
    lane,
)
from caster.kernels.raster.tile_casting import cast_own_origins, cast_shared_origin

# Images are (height, width) or (height, width, c) arrays of the whole window; box says where the tile lies.


@jit
def paint_seen(tile: Any, box: Any, hit: Any, doubt: Any, depth: Any) -> None:
    """Whether anything was hit, whether that has to be found exactly, and depth; without size: not asked for.

    Doubt is all false before. Depth is t times the length of d, inf on a miss.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first, count = lane((y - y0) * WIDTH), lane(x1 - x0)
        any_doubt = 0.0
        for x in range(count):
            hit[y, lane(x0) + x] = tile[PRIM + first + x] >= 0.0
            any_doubt += tile[UNCERTAIN + first + x]
        if any_doubt > 0.0:
            for x in range(count):
                doubt[y, lane(x0) + x] = tile[UNCERTAIN + first + x] != 0.0
        if depth.size > 0:
            for x in range(count):
                i = first + x
                a, b, c = tile[DX + i], tile[DY + i], tile[DZ + i]
                depth[y, lane(x0) + x] = tile[T + i] * math.sqrt(a * a + b * b + c * c)


@jit
def paint_nothing(box: Any, depth: Any) -> None:
    """Of a tile where nothing can be seen, the one image that is not empty to begin with."""
    if depth.size > 0:
        for y in range(box[1], box[3]):
            for x in range(box[0], box[2]):
                depth[y, x] = math.inf


@jit
def paint_numbers(tile: Any, box: Any, table: Any, image: Any) -> None:
    """table[place] of what was hit; the image stays as it is elsewhere."""
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x1 - x0):
            place = int(tile[PRIM + lane((y - y0) * WIDTH + x)])
            if place >= 0:
                image[y, x0 + x] = table[place]


@jit
def paint_albedo(tile: Any, box: Any, shapes: Any, table: Any, image: Any) -> None:
    """table[shapes[place]], three numbers each; the image stays as it is on a miss."""
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x1 - x0):
            place = int(tile[PRIM + lane((y - y0) * WIDTH + x)])
            if place >= 0:
                for c in range(3):
                    image[y, x0 + x, c] = table[shapes[place], c]


CONSTANT_NORMAL_LENGTH = 2  # members of what `facing` says of a primitive whose normal is the same all over


@jit
def paint_normals(prims: Any, places: Any, reach: float, tile: Any, box: Any, image: Any) -> None:
    """Geometric normals of the hits on one kind, whose places are places[0] to places[1]; run by run of pixels.

    The first kind paints the misses, too: 0. reach: the largest |coordinate| of an origin.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first = lane((y - y0) * WIDTH)
        x, stop = 0, x1 - x0
        while x < stop:
            place = tile[PRIM + first + lane(x)]
            end = run_end(tile, PRIM + first, x, stop)
            if places[0] <= place < places[1]:
                k = int(place) - places[0]
                paint_run(prims, k, normal_setup(prims, k, reach), tile, first, image, (y, x0, x, end))
            elif place < 0.0 and places[0] == 0:
                for i in range(x0 + x, x0 + end):
                    image[y, i, 0], image[y, i, 1], image[y, i, 2] = 0.0, 0.0, 0.0
            x = end


@inlined
def run_end(tile: Any, row: Any, x: int, stop: int) -> int:
    """Where what a row of the tile has at x ends, `stop` at the latest."""
    value, end = tile[row + lane(x)], x + 1
    while end < stop and tile[row + lane(end)] == value:
        end += 1
        while end - x >= LANES and end + LANES <= stop:  # a long one: several at once
            alike = 0
            for j in range(lane(LANES)):
                alike += 1 if tile[row + lane(end) + j] == value else 0
            if alike < LANES:
                break
            end += LANES
    return end


@inlined
def paint_run(prims: Any, k: int, face: Any, tile: Any, first: Any, image: Any, run: Any) -> None:
    """The normals of pixels in a row that show one primitive; run: row, left end of the tile, start and stop there."""
    y, x0, start, stop = run
    if len(face) == CONSTANT_NORMAL_LENGTH:
        n = face[1]
        for x in range(x0 + start, x0 + stop):
            image[y, x, 0], image[y, x, 1], image[y, x, 2] = n[0], n[1], n[2]
        return
    if face[0]:  # apart from the image, so that several are done at once
        for i in range(first + lane(start), first + lane(stop)):
            o, d = (tile[OX + i], tile[OY + i], tile[OZ + i]), (tile[DX + i], tile[DY + i], tile[DZ + i])
            tile[NX + i], tile[NY + i], tile[NZ + i] = fast_normal(prims, face, o, d, tile[T + i])
    else:
        for i in range(first + lane(start), first + lane(stop)):
            o, d = (tile[OX + i], tile[OY + i], tile[OZ + i]), (tile[DX + i], tile[DY + i], tile[DZ + i])
            tile[NX + i], tile[NY + i], tile[NZ + i] = normal(prims, k, o, d, tile[T + i])
    for x in range(start, stop):
        i = first + lane(x)
        image[y, x0 + x, 0], image[y, x0 + x, 1], image[y, x0 + x, 2] = (
            tile[NX + i],
            tile[NY + i],
            tile[NZ + i],
        )


# Depth and normals of many tiles in one go, for scenes of one kind: rays, hits and images without a step of Python.
#
# Steps of Python are taken by one thread at a time, and waiting for one's turn costs more than they do.


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
        generate_camera_rays(camera, window, box, tile)
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
        generate_camera_rays(camera, window, box, tile)
        cast_own_origins(prims, order, run, spans, 0, box, tile)
        _paint(prims, spans, reach, tile, box, images)


@inlined
def _paint(prims: Any, spans: Any, reach: float, tile: Any, box: Box, images: Any) -> None:
    hit, doubt, depth, normal = images
    if normal.size > 0:
        paint_normals(prims, (0, len(spans.near)), reach, tile, box, normal)
    paint_seen(tile, box, hit, doubt, depth)
