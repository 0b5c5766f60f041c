"""Which primitives are to be looked for in which tile of the film, near ones first."""

from typing import Any

from caster.kernels.jit import inlined, jit
from caster.kernels.tile import HEIGHT, WIDTH

# Within a tile, primitives are sorted into drawers by their least depth: by its exponent and 4 bits of the fraction.
# The farthest 8 powers of two have drawers of their own; what is nearer, or behind, shares the first.
DRAWERS, SHIFT = 128, 52 - 4


@inlined
def is_seen(pixels: Any, k: int) -> bool:
    return (pixels[k, 0] < pixels[k, 2]) & (pixels[k, 1] < pixels[k, 3])


@inlined
def drawer(bits: int, last: int) -> int:
    """Farther primitives are in later drawers; bits, last: of depths, as int64, and of the largest that may be."""
    return min(max(DRAWERS - 1 - ((last >> SHIFT) - (bits >> SHIFT)), 0), DRAWERS - 1)


@jit
def count_in_tiles(
    pixels: Any, bits: Any, last: int, queue: Any, across: int, counts: Any, start: int, stop: int
) -> int:
    """How many spans reach into each tile, of primitives queue[start:stop]: counts[n * DRAWERS + drawer].

    Tiles go row by row, `across` in a row. A queue without members stands for all primitives in their own order.
    Returns how many primitives are looked for anywhere.
    """
    seen = 0
    for place in range(start, stop):
        k = queue[place] if len(queue) > 0 else place
        if is_seen(pixels, k):
            seen += 1
            into = drawer(bits[k], last)
            for y in range(pixels[k, 1] // HEIGHT, (pixels[k, 3] - 1) // HEIGHT + 1):
                for x in range(pixels[k, 0] // WIDTH, (pixels[k, 2] - 1) // WIDTH + 1):
                    counts[(y * across + x) * DRAWERS + into] += 1
    return seen


@jit
def sort_into_tiles(
    pixels: Any, bits: Any, last: int, queue: Any, across: int, ends: Any, order: Any, start: int, stop: int
) -> None:
    """Write them to order[ends[n * DRAWERS + drawer]:], for each tile n they reach into, moving that end on."""
    for place in range(start, stop):
        k = queue[place] if len(queue) > 0 else place
        if is_seen(pixels, k):
            into = drawer(bits[k], last)
            for y in range(pixels[k, 1] // HEIGHT, (pixels[k, 3] - 1) // HEIGHT + 1):
                for x in range(pixels[k, 0] // WIDTH, (pixels[k, 2] - 1) // WIDTH + 1):
                    n = (y * across + x) * DRAWERS + into
                    order[ends[n]] = k
                    ends[n] += 1
