"""How values are spread, as counts and as one line of text."""

from collections.abc import Sequence
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

BINS = 24  # columns of a line that also holds ranges and counts
BLOCKS = " ▁▂▃▄▅▆▇█"
ASCII = " .:-=+*#@"


def counts(values: Array, bins: int = BINS) -> list[int]:
    """How many of the values fall into each of `bins` equal parts of min..max; values: (n,), all finite.

    Equal values are all in one part. Empty without values.
    """
    if not values.size:
        return []
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return [int(values.size)]
    # by halves, since the whole span of float64 values may be beyond float64
    share = (0.5 * values - 0.5 * low) / (0.5 * high - 0.5 * low)
    place = np.minimum((bins * share).astype(int), bins - 1)
    return [int(count) for count in np.bincount(place, minlength=bins)]


def bars(counts: Sequence[int], ramp: str = BLOCKS) -> str:
    """A character for each count: blank for none, then by its share of the largest, the lowest for very few."""
    most, steps = max(counts, default=0), len(ramp) - 1
    return "".join(ramp[0 if not count else max(1, round(steps * count / most))] for count in counts)


def ramp_for(encoding: str | None) -> str:
    """Blocks where the terminal's encoding has them."""
    try:
        BLOCKS.encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return ASCII
    return BLOCKS
