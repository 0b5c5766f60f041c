"""The outcome of what is checked once a scene, and how it is found among pixels."""

import numpy as np

from caster.rendering.images import Aovs
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound
from mitsuba_ref.judge.verdict import SceneCheck


class Shares:
    """Errors over their bounds by what was checked; a second value of one name would hide the first and is refused."""

    def __init__(self) -> None:
        self._shares: dict[str, float] = {}

    def add(self, what: str, share: float) -> None:
        if what in self._shares:
            raise ValueError(f"{what} is checked twice, and a verdict has room for one share of it")
        self._shares[what] = share

    def worst(self) -> tuple[str, float]:
        """The largest share and what it is of."""
        what = max(self._shares, key=lambda name: self._shares[name], default="nothing to look at")
        return what, self._shares.get(what, 0.0)


def bits_differ(a: Aovs, b: Aovs, name: str) -> np.ndarray:
    """(n,) bool: pixels where one AOV of two images has other bits."""
    rows, others = aov_rows(a, name), aov_rows(b, name)
    different = rows.view(f"u{rows.itemsize}") != others.view(f"u{rows.itemsize}")
    return different if different.ndim == 1 else different.any(axis=1)


def pixel_centers(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the window's pixel centres, row by row."""
    x0, y0, x1, y1 = scene.film.crop or (0, 0, scene.film.width, scene.film.height)
    y, x = np.meshgrid(np.arange(y0, y1) + 0.5, np.arange(x0, x1) + 0.5, indexing="ij")
    return x.ravel(), y.ravel()


def worst_pixel(name: str, shares: dict[str, np.ndarray], among: np.ndarray, scene: Scene) -> SceneCheck:
    """The largest share of all, and the pixel it is at."""
    table = np.array([np.where(among, error_over_bound(share, np.ones(1)), 0.0) for share in shares.values()])
    if not table.size:
        return SceneCheck(name, 0.0, "nothing to look at")
    part, pixel = np.unravel_index(int(np.argmax(table)), table.shape)
    x0, y0, x1, _y1 = scene.film.window
    x, y = x0 + int(pixel) % (x1 - x0), y0 + int(pixel) // (x1 - x0)
    return SceneCheck(name, float(table[part, pixel]), f"{list(shares)[int(part)]} at ({x}, {y})")
