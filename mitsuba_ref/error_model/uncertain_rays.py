"""The judge's view of a candidate whose rays come from a camera of its own, and so are not ours to the bit.

Its rays leave ours by no more than what rounding does to a camera. All that such rays may meet lies within what eight
rays around ours meet, on a circle so wide that their octagon holds every ray it may have shot: an edge that any of them
crosses, one of the eight has crossed, and between them t and normals change steadily. So each meeting is widened to
hold the meetings of all nine, which asks nothing of the shape. Where an answer is disputed, 48 rays are looked along in
place of eight, since a corner may fall between them. See docs/method.md, "Candidates".
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mitsuba_ref.error_model.intersections import Intersections, norm, unit
from mitsuba_ref.error_model.scene_model import PairIntersections, SceneModel, with_edges

RAYS_PER_RING, RING_RADII = 8, (1.0,)
REFINED_RAYS_PER_RING, REFINED_RING_RADII = 16, (0.4, 0.7, 1.0)  # where an answer is disputed
# A primitive may lie between the nine rays if it is no larger than a few of the circles that they stand for: which of
# several such is hit, nobody can say.
UNRESOLVED_SIZE_IN_CIRCLES = 8.0


@dataclass(frozen=True)
class UncertainRaysModel(SceneModel):
    """A model of rays that are known up to a turn and a shift."""

    turn: float = 0.0  # of the direction, as a share of its length
    shift: float = 0.0  # of the origin, scene units
    around: int = RAYS_PER_RING  # rays on each ring
    rings: tuple[float, ...] = RING_RADII  # shares of the circle that holds all rays there may be

    def refined(self) -> "UncertainRaysModel":
        """The same with more rays, for the few pixels that are disputed."""
        return replace(self, around=REFINED_RAYS_PER_RING, rings=REFINED_RING_RADII)

    def intersect(
        self, prim: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float, *, ours: bool
    ) -> PairIntersections:
        """Each meeting, widened by what the rays around find at the same primitive and root."""
        met = super().intersect(prim, o, d, ku, ours=ours)
        found = [met.at]
        for across in self._around(d):
            found.append(
                super()
                .intersect(prim, o + self.shift * across, d + self._turned(d) * across, ku, ours=ours)
                .at
            )
        # A shift along the ray moves no point, but t by as much.
        return PairIntersections(met.pair, enclosing_intersections(found, self.shift / norm(d)[met.pair]))

    def is_unresolved(self, prim: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
        """(m,) bool: primitive prim[i], -1 for none, is so small that the ray with d[i] may pass it unseen at t[i]."""
        low, high = (corner[np.maximum(prim, 0)] for corner in self.boxes)
        with np.errstate(invalid="ignore"):
            circle = self.shift + self.turn * np.abs(t) * norm(d)
            lost: np.ndarray = (prim >= 0) & (norm(high - low) <= UNRESOLVED_SIZE_IN_CIRCLES * circle)
        return lost

    def _turned(self, d: np.ndarray) -> np.ndarray:
        return (self.turn * norm(d))[:, None]

    def _around(self, d: np.ndarray) -> Iterator[np.ndarray]:
        """Ways to go across each ray, (m, 3) each: corners of polygons around the rings, of radius 1 and less."""
        along = unit(d)
        other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        right = unit(np.cross(along, other))
        up = np.cross(along, right)
        out = 1.0 / np.cos(np.pi / self.around)
        for ring in self.rings:
            for angle in 2.0 * np.pi * np.arange(self.around) / self.around:
                yield ring * out * (np.cos(angle) * right + np.sin(angle) * up)


def enclosing_intersections(found: list[Intersections], along: np.ndarray) -> Intersections:
    """The first of these meetings of the same pairs and roots, made to hold all of them. along: (m,) more for t."""
    middle = with_edges(found[0])
    with np.errstate(invalid="ignore"):
        off = [np.abs(at.t - middle.t) + at.t_error + along for at in found]
        t_error = np.max(np.where(np.isnan(off), np.inf, off), axis=0)
        n_error = np.max([norm(at.n - middle.n) + at.n_error for at in found], axis=0)
        sh_error = np.max([norm(at.sh_n - middle.sh_n) + at.sh_error for at in found], axis=0)
    possible = np.any([at.possible for at in found], axis=0)
    certain = np.all([at.certain for at in found], axis=0)
    edge, side = middle.edge, middle.side
    assert edge is not None and side is not None  # with_edges
    edge, side = edge.copy(), side.copy()
    steady = np.all(
        [at.certain | (_side(at) != 0.0) for at in found], axis=0
    )  # nowhere is more than one edge in doubt
    for at in map(with_edges, found[1:]):
        assert at.edge is not None and at.side is not None
        take = (side == 0.0) & (at.side != 0.0)
        edge[take], side[take] = at.edge[take], at.side[take]
        steady &= (at.side == 0.0) | ((at.side == side) & (at.edge == edge).all(axis=1))
    side = np.where(steady & ~certain, side, 0.0)
    return middle._replace(
        t_error=t_error,
        n_error=n_error,
        sh_error=sh_error,
        possible=possible,
        certain=certain,
        p_error=np.full(len(t_error), np.inf),
        edge=edge,
        side=side,
    )


def _side(at: Intersections) -> np.ndarray:
    side = with_edges(at).side
    assert side is not None
    return side
