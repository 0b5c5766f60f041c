"""The scene as the judge sees it: primitives in float32, stand-ins, error models, and a broad phase for rays.

The broad phase shares no code with the BVH that it judges. It may return too many primitives, but never leaves out one
that a ray hits up to rounding, except for slivers thinner than BOX_MARGIN.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed, Triangles
from mitsuba_ref.error_model.intersections import (
    Array,
    ErrorModel,
    Intersections,
    joined,
    no_intersections,
    norm,
    perpendicular,
    triangle_heights,
    unit,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.oracle.boxes import MAX_RAY_BOX_PAIRS, BoxTree


class Side(NamedTuple):
    """The arithmetic and the primitives of one side of a comparison."""

    ku: float  # K times the unit round-off of its arithmetic
    own: bool = True  # the scene's own primitives, not the reference's stand-ins
    foreign: bool = False  # of an unknown algorithm: a candidate's


REFERENCE_SIDE, OUR_SIDE = Side(KU, own=False), Side(KU_OURS)


class PairIntersections(NamedTuple):
    """All intersections of some pairs of a ray and a primitive: row i belongs to pair[i]."""

    pair: Array  # (m,) index into the requested pairs
    at: Intersections


def joined_pairs(found: Sequence[PairIntersections]) -> PairIntersections:
    """One after the other."""
    if len(found) == 1:
        return found[0]
    pairs, at = zip(*found, strict=True) if found else ([np.zeros(0, int)], [no_intersections(0)])
    return PairIntersections(np.concatenate(pairs), joined(at))


@dataclass(frozen=True)
class SceneModel:
    """The primitives of a scene, numbered as in `packed`, with their error models."""

    packed: Packed
    parts: tuple[Any, ...]  # arrays of each shape, or of its stand-in
    kinds: tuple[Any, ...]  # the same, joined by kind
    models: tuple[ErrorModel, ...]  # one for each kind

    def intersect(self, prim: Array, o: Array, d: Array, side: Side) -> PairIntersections:
        """Intersections of primitive prim[i] (m,) with the ray o[i], d[i] (m, 3), with error bounds."""
        found = []
        for rows, model, arrays, k in self._by_kind(prim):
            intersect = (side.own and model.intersect_ours) or model.intersect
            if side.foreign:
                intersect = model.intersect_foreign or intersect
            for at in intersect(arrays, k, o[rows], d[rows], side.ku):
                if not (side.own or model.uv.reference):
                    at = at._replace(uv=np.zeros_like(at.uv), uv_error=np.zeros_like(at.t))
                found.append(PairIntersections(rows, at))
        pair, at = joined_pairs(found)
        flipped = self.packed.flipped
        if flipped is not None:
            facing = np.where(flipped[self.packed.shape_of(prim[pair])], -1.0, 1.0)[:, None]
            at = at._replace(n=facing * at.n, sh_n=facing * at.sh_n)
        return PairIntersections(pair, at)

    def _by_kind(self, prim: Array) -> Iterator[tuple[Array, ErrorModel, Any, Array]]:
        """(rows of prim (m,), error model, arrays, the rows of these) for each kind among the primitives."""
        kind, k = self.packed.kinds_of(prim)
        for place, model in enumerate(self.models):
            rows = np.flatnonzero(kind == place)
            if len(rows):
                yield rows, model, self.kinds[place], k[rows]

    def uv_points(self, prim: Array, uv: Array, side: Side) -> Array:
        """(n, 3) points that one side's uv (n, 2) of primitive prim[i] map to in its kind's UvSpace.

        0 where prim is -1, or where the reference traces a stand-in.
        """
        points, hits = np.zeros((len(prim), 3)), np.flatnonzero(prim >= 0)
        for rows, model, arrays, k in self._by_kind(prim[hits]):
            space = model.uv.subject if side.own else model.uv.reference
            if space:
                points[hits[rows]] = space(arrays, k, uv[hits[rows]].astype(np.float64))
        return points

    def reference_has_uv(self, prim: Array) -> Array:
        """(n,) bool: the reference has uv of primitive prim[i] itself, not of a stand-in."""
        has = np.array([model.uv.reference is not None for model in self.models], bool)
        return has[self.packed.kinds_of(np.maximum(prim, 0))[0]] if len(has) else prim >= 0

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """(low, high) corners of all primitives, (n, 3) each."""
        low, high = np.empty((2, self.packed.first[-1], 3))
        for place, kind in enumerate(self.packed.kinds):
            low[kind.ids], high[kind.ids] = self.models[place].exact.boxes(self.kinds[place])
        return low, high

    @cached_property
    def nearby(self) -> BoxTree:
        """Boxes of all primitives, shared by all brackets of the model."""
        return BoxTree(*self.boxes, BOX_MARGIN)

    def near_pairs(self, o: Array, d: Array, *, blurred: bool) -> Iterator[Array]:
        """(2, m) pairs of a ray o + t d (n, 3) and a primitive that it may hit, in batches; those of a ray in one.

        blurred: also those that rounding by the reference may let it hit, though it passes their boxes by far.
        """
        further = len(self.blurred[0]) if blurred else 0
        for batch, ray, prim, _ in self.nearby.crossings(o, d):
            pairs = np.stack([ray, prim])
            if not further:
                yield pairs
                continue
            at_once = max(1, MAX_RAY_BOX_PAIRS // further)
            for first in range(batch.start, batch.stop, at_once):
                some = slice(first, min(first + at_once, batch.stop))
                mine = pairs[:, (ray >= some.start) & (ray < some.stop)]
                yield np.unique(np.hstack([mine, self._blurred_pairs(some, o, d)]), axis=1)

    @cached_property
    def blurred(self) -> tuple[Array, Array, Array, Array]:
        """Primitives whose ErrorModel.growth is beyond BOX_MARGIN: the reference may hit them far beside their boxes.

        Their numbers (m,); center (m, 3) and radius (m,) of a sphere around each; growth (m,).
        """
        grown = [
            (kind.ids, model.growth(arrays))
            for kind, model, arrays in zip(self.packed.kinds, self.models, self.kinds, strict=True)
            if model.growth
        ]
        prim, growth = (np.concatenate(each) for each in zip((np.zeros(0, int), np.zeros(0)), *grown, strict=True))
        beyond = growth > 0.5 * BOX_MARGIN  # which counts the largest coordinate, at least 1 / sqrt(3) of a length
        prim, growth = prim[beyond], growth[beyond]
        low, high = (corner[prim] for corner in self.boxes)
        return prim, 0.5 * (low + high), 0.5 * norm(high - low), growth

    @without_overflow_warnings
    def _blurred_pairs(self, batch: slice, o: Array, d: Array) -> Array:
        """(2, m) pairs of a ray of the batch and a blurred primitive whose sphere, with its growth, its line passes."""
        prim, center, radius, growth = self.blurred
        way = center - o[batch, None]
        along = np.einsum("rpi,ri->rp", way, d[batch]) / norm(d[batch])[:, None]
        off = np.sqrt(np.maximum((way**2).sum(axis=2) - along**2, 0.0))
        ray, which = np.nonzero(~(off > radius + growth * (norm(o[batch])[:, None] + norm(center))))
        return np.stack([ray + batch.start, prim[which]])


# Growth of boxes, as a fraction of |o| + their farthest corner. The bound of an edge function, divided by the length of
# the edge, is 6 to 8 KU of that (mitsuba_ref/shapes/surface_errors.py); of a quadric 2 to 4. Primitives beyond it are
# at best possible hits (the ray itself passes the box of a certain one); leaving them out excuses less on either side.
BOX_MARGIN = 16 * KU


@dataclass(frozen=True)
class InstancedModel(SceneModel):
    """The model of a reference that holds some shapes as instances of a group, which the scene has in world space.

    Mitsuba transforms the ray into the group's space in float32. This error, taken back to world space, is that of the
    plain shape times the condition number of the matrix, and adds to the error of the intersection there. Corners are
    rounded in world space: a corner off by half a unit in the last place of each coordinate turns the normal of a
    triangle of height h by up to 2 sqrt(3) u |corner| / h < K u |corner| / h.
    """

    condition: Array  # (shapes,) of the matrix of each instance, a power of two; 0: no instance

    def intersect(self, prim: Array, o: Array, d: Array, side: Side) -> PairIntersections:
        """As SceneModel.intersect, with the errors of instances."""
        if side.own:
            return super().intersect(prim, o, d, side)
        condition, found = self.condition[self.packed.shape_of(prim)], []
        for each in np.unique(condition):
            rows = np.flatnonzero(condition == each)
            widened = side._replace(ku=side.ku * (1.0 + each))
            pair, at = super().intersect(prim[rows], o[rows], d[rows], widened)
            if each:
                turned = self._turned_normals(prim[rows[pair]], side.ku)
                at = at._replace(n_error=at.n_error + turned, sh_error=at.sh_error + turned)
            found.append(PairIntersections(rows[pair], at))
        return joined_pairs(found)

    @without_overflow_warnings
    def _turned_normals(self, prim: Array, ku: float) -> Array:
        """(m,) how far the rounding of corners turns normals; 0 for other kinds than triangles."""
        turned = np.zeros(len(prim))
        for rows, _, arrays, k in self._by_kind(prim):
            if isinstance(arrays, Triangles):
                corners = arrays.vertices[arrays.faces[k]]
                turned[rows] = ku * np.abs(corners).max(axis=(1, 2)) / triangle_heights(corners)
        return turned


# Rays on each ring, and the radii of rings, as fractions of the circle that encloses all possible rays.
RAYS_PER_RING, RING_RADII = 8, [1.0]
REFINED_RAYS_PER_RING, REFINED_RING_RADII = 16, [0.4, 0.7, 1.0]  # at disputed pixels
# A primitive no larger than this many circles of rays may lie between the nine rays, so that hits are undecidable.
UNRESOLVED_SIZE_IN_CIRCLES = 8.0


@dataclass(frozen=True)
class UncertainRaysModel(SceneModel):
    """The model for a subject with a camera of its own, whose rays are known up to a small turn and shift.

    The subject's rays differ from ours by no more than the rounding of a camera. Eight rays around ours, on a circle
    whose octagon encloses all these rays, bound what they may hit: an edge that one of them crosses has been crossed by
    one of the eight, and between them t and normals vary steadily. So each intersection is widened to enclose those of
    all nine rays, which needs no formula per shape. At disputed pixels 48 rays replace the eight, since a corner may
    fall between these. See docs/method.md, "Candidates".

    If the subject traces the primitives of the scene file, not rounded to float32, each intersection is widened to
    enclose those with these primitives as well.
    """

    turn: float = 0.0  # change of the direction, as a fraction of its length
    shift: float = 0.0  # change of the origin, scene units
    as_described: SceneModel | None = None  # the primitives in float64, if they differ
    refined: bool = False  # by more rays, for the few disputed pixels

    def intersect(self, prim: Array, o: Array, d: Array, side: Side) -> PairIntersections:
        """As SceneModel.intersect, widened to enclose the intersections of neighbouring rays."""
        turn = (self.turn * norm(d))[:, None]
        rays = [(o, d), *((o + self.shift * across, d + turn * across) for across in self._around(d))]
        met = []
        for ray in rays:
            met.append(super().intersect(prim, *ray, side))
            if self.as_described:
                met.append(self.as_described.intersect(prim, *ray, side))
        pair = met[0].pair
        # A shift along the ray moves no point, but changes t.
        return PairIntersections(pair, enclosing_intersections([each.at for each in met], self.shift / norm(d)[pair]))

    @without_overflow_warnings
    def is_unresolved(self, prim: Array, d: Array, t: Array) -> Array:
        """(m,) bool: prim[i] (-1: none) is so small at t[i] that the nine rays around d[i] may all miss it."""
        low, high = (corner[np.maximum(prim, 0)] for corner in self.boxes)
        circle = self.shift + self.turn * np.abs(t) * norm(d)
        return (prim >= 0) & (norm(high - low) <= UNRESOLVED_SIZE_IN_CIRCLES * circle)

    def _around(self, d: Array) -> Iterator[Array]:
        """Offsets (m, 3) across the rays: corners of polygons around the rings."""
        along = unit(d)
        right = unit(perpendicular(along))
        up = np.cross(along, right)
        count, radii = RAYS_PER_RING, RING_RADII
        if self.refined:
            count, radii = REFINED_RAYS_PER_RING, REFINED_RING_RADII
        out = 1.0 / np.cos(np.pi / count)
        for ring in radii:
            for angle in 2.0 * np.pi * np.arange(count) / count:
                yield ring * out * (np.cos(angle) * right + np.sin(angle) * up)


@without_overflow_warnings
def enclosing_intersections(found: list[Intersections], along: Array) -> Intersections:
    """The first of several intersections of the same pairs, widened to enclose all. along: (m,) added to t_error."""
    middle = found[0]
    off = [np.abs(at.t - middle.t) + at.t_error + along for at in found]
    t_error = np.max(np.where(np.isnan(off), np.inf, off), axis=0)
    n_error = np.max([norm(at.n - middle.n) + at.n_error for at in found], axis=0)
    sh_error = np.max([norm(at.sh_n - middle.sh_n) + at.sh_error for at in found], axis=0)
    possible = np.any([at.possible for at in found], axis=0)
    certain = np.all([at.certain for at in found], axis=0)
    edge, side = middle.edge.copy(), middle.side.copy()
    steady = np.all([at.certain | (at.side != 0.0) for at in found], axis=0)  # at most one edge is ever in doubt
    for at in found[1:]:
        take = (side == 0.0) & (at.side != 0.0)
        edge[take], side[take] = at.edge[take], at.side[take]
        steady &= (at.side == 0.0) | ((at.side == side) & (at.edge == edge).all(axis=1))
    side, unknown = np.where(steady & ~certain, side, 0.0), np.full(len(t_error), np.inf)
    return middle._replace(
        t_error=t_error,
        n_error=n_error,
        sh_error=sh_error,
        possible=possible,
        certain=certain,
        p_error=unknown,
        uv_error=unknown,
        edge=edge,
        side=side,
    )
