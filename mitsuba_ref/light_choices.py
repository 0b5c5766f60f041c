"""A sum of lights, some of which may be lit or not: does any choice that is allowed give the value at hand?"""

import itertools
from typing import NamedTuple

import numpy as np

from mitsuba_ref.pixels import share_of_bound

# So many lights in doubt at one pixel are tried in all 2^8 combinations; of more, the rest stay as they are, which
# only makes the verdict stricter.
MOST_IN_DOUBT = 8


class Choices(NamedTuple):
    """What each light gives at m pixels: the first value, or, where it is in doubt, perhaps the second."""

    first: np.ndarray  # (lights, m, 3)
    first_error: np.ndarray  # (lights, m, 3)
    second: np.ndarray  # (lights, m, 3)
    second_error: np.ndarray  # (lights, m, 3)
    doubt: np.ndarray  # (lights, m) bool


def certain(value: np.ndarray, error: np.ndarray) -> Choices:
    """Lights (lights, m, 3) none of which is in doubt."""
    return Choices(value, error, value, error, np.zeros(value.shape[:2], bool))


def smallest_share(ours: np.ndarray, fixed: np.ndarray, choices: Choices, ku: float) -> np.ndarray:
    """(m,) difference between ours (m, 3) and fixed plus lights, over its bound, for the choice that fits best."""
    sorted_ = _doubtful_first(choices)
    count = min(int(choices.doubt.sum(axis=0).max(initial=0)), MOST_IN_DOUBT)
    best = np.full(len(ours), np.inf)
    for flips in itertools.product((False, True), repeat=count):
        switched = np.zeros_like(choices.doubt)
        switched[:count] = np.array(flips, bool)[:, None] & sorted_.doubt[:count]
        best = np.minimum(best, _share(ours, fixed, sorted_, switched[..., None], ku))
    return best


def _doubtful_first(choices: Choices) -> Choices:
    """The lights of each pixel in another order: those in doubt come first."""
    order = np.argsort(~choices.doubt, axis=0, kind="stable")
    first, first_error, second, second_error = (
        np.take_along_axis(a, order[..., None], axis=0) for a in choices[:4]
    )
    return Choices(first, first_error, second, second_error, np.take_along_axis(choices.doubt, order, axis=0))


def _share(
    ours: np.ndarray, fixed: np.ndarray, choices: Choices, switched: np.ndarray, ku: float
) -> np.ndarray:
    total = fixed + np.where(switched, choices.second, choices.first).sum(axis=0)
    error = np.where(switched, choices.second_error, choices.first_error).sum(axis=0)
    rounded = ku * (fixed + total)  # the ambient light's own product, and the sum
    share = share_of_bound(np.abs(ours - total), error + rounded)
    return np.asarray(share.max(axis=1, initial=0.0))
