"""What the oracle says, and what it does not answer."""

from dataclasses import dataclass

import numpy as np

from mitsuba_ref.exact_arithmetic.root import Root


class OutsideDomain(ValueError):  # noqa: N818 - a place, not a mistake of the program
    """A ray or a primitive with a number that is not finite, a direction of no length, a radius below 0."""


@dataclass(frozen=True)
class ExactHit:
    """One root of one primitive."""

    prim: int  # its number in the scene
    t: Root
    where: str  # "inside", "edge", "vertex", "rim" or "tangent"; a tangent at a rim is "tangent"


@dataclass(frozen=True)
class ExactAnswer:
    """What one ray meets first."""

    t: Root | None  # None: a miss
    ties: tuple[ExactHit, ...]  # all hits with exactly this t, by prim

    # What the ray met on its way, not later than t: "edge_on" (it runs along a flat primitive or a cylinder's wall),
    # "degenerate" (it touches a triangle without area, or the box of a primitive without an inverse), "dropped" (it
    # would have hit a face that is too large; or some face of the scene is nowhere); and "tangent", if a hit is one.
    flags: frozenset[str]

    @property
    def hit(self) -> bool:
        return self.t is not None

    @property
    def prim(self) -> int:
        """The lowest number of a primitive that is hit there, -1 on a miss."""
        return self.ties[0].prim if self.ties else -1


def refuse_rays(o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray) -> None:
    """Raises OutsideDomain, naming the first ray (n, 3), (n, 3), (n,), (n,) that cannot be asked about."""
    fits = np.isfinite(o).all(axis=1) & np.isfinite(d).all(axis=1) & (d != 0.0).any(axis=1)
    bad = np.flatnonzero(~fits | np.isnan(t_min) | np.isnan(t_max))
    if len(bad):
        i = int(bad[0])
        line = f"o = {o[i].tolist()}, d = {d[i].tolist()}, t_min = {t_min[i]}, t_max = {t_max[i]}"
        raise OutsideDomain(
            f"ray {i}: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got {line}"
        )
