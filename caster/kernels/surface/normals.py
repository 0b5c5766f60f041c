"""Normals of the hits of a tile without the rest of their surfaces, and films of such AOVs in one go.

A normal that is the same all over a primitive is computed once for a run of pixels; others several at a time.
"""

from typing import Any

from caster.jit.decorators import inlined, jit
from caster.jit.simd import ALL_LANES, LANES, lanes_in_range
from caster.kernels.protocol import Vec3, fast_normal, normal, normal_setup
from caster.kernels.raster.tile import PRIM, T_ERROR, T_MAX, T_MIN, WIDTH, Box, T, lane
from caster.kernels.surface.per_hit import UNKNOWN, Hit, per_hit, ray_of, store_misses, store_value

# Once all is cast, three fields of a tile are free for normals.
NX, NY, NZ = T_ERROR, T_MIN, T_MAX

CONSTANT_NORMAL_LENGTH = 2  # members of the `normal_setup` of a primitive whose normal is the same all over


@jit
def normals_in_tile(
    aov: Any, prims: Any, numbers: Any, reach: float, tile: Any, box: Box, misses: bool, image: Any
) -> None:
    """An AOV that needs normals alone, of hits on one kind; its primitives are numbers[0] to numbers[1] in the tile.

    misses: whether it writes these, too; depth counts from the origins. reach: the largest |coordinate| of an origin,
    if all d are of length 1, or inf.
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        first = lane((y - y0) * WIDTH)
        x, stop = 0, x1 - x0
        while x < stop:
            prim = tile[PRIM + first + lane(x)]
            end = run_end(tile, PRIM + first, x, stop)
            if numbers[0] <= prim < numbers[1]:
                k = int(prim) - numbers[0]
                run = y, x0, x, end
                write_run(aov, prims, k, normal_setup(prims, k, reach), tile, first, image, run)
            elif misses and prim < 0.0:
                store_misses(image, y, x0 + x, x0 + end, aov.miss)
            x = end


@inlined
def run_end(tile: Any, row: Any, x: int, stop: int) -> int:
    """Where what a row of the tile has at x ends, `stop` at the latest."""
    value, end = tile[row + lane(x)], x + 1
    while end < stop and tile[row + lane(end)] == value:
        end += 1
        # a long one: several at once, of whole numbers
        while end - x >= LANES and end + LANES <= stop:
            if lanes_in_range(tile, row + lane(end), value, value + 1.0) != ALL_LANES:
                break
            end += LANES
    return end


@inlined
def write_run(aov: Any, prims: Any, k: int, setup: Any, tile: Any, first: Any, image: Any, run: Any) -> None:
    """Pixels in a row that show one primitive; run: row, left end of the tile, start and stop there."""
    y, x0, begin, stop = run
    if len(setup) == CONSTANT_NORMAL_LENGTH:
        n = setup[1]
        for x in range(lane(begin), lane(stop)):
            value = per_hit(aov, hit_with_normal(tile, first + x, n))
            store_value(image, y, lane(x0) + x, value)
        return
    if setup[0]:  # apart from the image, so that several are done at once
        for i in range(first + lane(begin), first + lane(stop)):
            o, d = ray_of(tile, i)
            tile[NX + i], tile[NY + i], tile[NZ + i] = fast_normal(prims, setup, o, d, tile[T + i])
    else:
        for i in range(first + lane(begin), first + lane(stop)):
            o, d = ray_of(tile, i)
            tile[NX + i], tile[NY + i], tile[NZ + i] = normal(prims, k, o, d, tile[T + i])
    for x in range(lane(begin), lane(stop)):
        i = first + x
        n = tile[NX + i], tile[NY + i], tile[NZ + i]
        store_value(image, y, lane(x0) + x, per_hit(aov, hit_with_normal(tile, i, n)))


@inlined
def hit_with_normal(tile: Any, i: Any, n: Vec3) -> Hit:
    """The hit of pixel i, without anything but its ray and normal."""
    o, d = ray_of(tile, i)
    unknown = UNKNOWN
    return Hit(o, d, tile[T + i], 0.0, unknown, n, unknown, (0.0, 0.0), unknown, unknown, -1, -1)
