"""Both sides' pictures of one scene, pixel by pixel, with the bounds that hold between them."""

from dataclasses import dataclass

import numpy as np

from caster.rendering import Aovs
from mitsuba_ref.bounds import Bounds


@dataclass(frozen=True)
class Pixels:
    """What every check looks at: n pixels, row by row."""

    ours: Aovs
    reference: Aovs
    bounds: Bounds
    t_ours: np.ndarray  # (n,) float64 lengths of d, inf on a miss
    length: np.ndarray  # (n,) of each ray's d
    point: np.ndarray  # (n, 3) o + t d at our own hits

    def pair(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(ours, the reference's) of one AOV, (n,) or (n, c)."""
        return flat(self.ours, name), flat(self.reference, name)

    @property
    def hits(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) bool each."""
        return self.ours.hit.ravel(), self.reference.hit.ravel()

    @property
    def both_hit(self) -> np.ndarray:
        ours, reference = self.hits
        return ours & reference

    def held_twice(self, name: str, bound: np.ndarray, own: np.ndarray, own_bound: np.ndarray) -> np.ndarray:
        """(n,) where both hit, the larger of two shares of bounds: ours from the reference, and ours from our own
        primitive's value (n, 3); 0 elsewhere."""
        share = share_of_bound(apart(*self.pair(name)), bound)
        alone = share_of_bound(apart(flat(self.ours, name), own), own_bound)
        return np.where(self.both_hit, np.maximum(share, alone), 0.0)


def flat(aovs: Aovs, name: str) -> np.ndarray:
    image = aovs[name]
    rows: np.ndarray = image.reshape(-1, *image.shape[2:])
    return rows


def share_of_bound(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """error / bound; inf for anything that is not a number, or where there is no bound to hold on to."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(error == 0.0, 0.0, error / bound)
    fine = np.isfinite(error) & np.isfinite(bound) & np.isfinite(share)
    return np.where(fine, share, np.inf)


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Euclidean distance of rows (n, c); NaN where either is not finite."""
    with np.errstate(invalid="ignore"):
        distance: np.ndarray = np.sqrt(np.sum((a - b) ** 2, axis=1))
    return np.where(np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1), distance, np.nan)
