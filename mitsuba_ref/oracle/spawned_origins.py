"""Where the next ray starts: origins of rays that leave a surface, judged in exact arithmetic (docs/method.md).

A parent ray hits the exact point p; a ray is to leave p along w, and starts at q instead, since p is no float32 point.
That is an error if the ray from q meets the surface of p again, which the one from p does not (self-hit), if another
surface lies between p and q (skipped), or if q is not on the side of the surface that w leads to (wrong side).
"""

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Root, cross, dot, integer_rays, sign, sub
from mitsuba_ref.oracle.implicit_surfaces import Approximate, ImplicitSurface, Vector, approximate_vector, exact_vector
from mitsuba_ref.oracle.interface import OutsideDomain
from mitsuba_ref.oracle.oracle import BOX_MARGIN, Oracle, PrimitiveArray

FINDINGS = ("self-hit", "skipped surface", "wrong side", "undecided")
SELF_HIT, SKIPPED, WRONG_SIDE, UNDECIDED = 1, 2, 4, 8
WRONG = SELF_HIT | SKIPPED | WRONG_SIDE

# An irrational t is enclosed by two fractions that are this much apart in relation to it, and p by two points. What
# holds at both is taken to hold at p: a difference between them leaves the ray undecided.
ENCLOSURE_BITS = 256

# A quarter of the growth of boxes covers the error of p in float64.
LARGEST_POINT_ERROR = BOX_MARGIN / 4.0


# An origin this close to p, relative to the largest coordinate, is at most four spacings of float32 from it: surfaces
# between them are closer than float32 points can be told apart from.
FLOAT32_RESOLUTION = 4.0 * 2.0**-24


class Departures(NamedTuple):
    """Rays that leave the hits of parent rays, one a row; all numbers are exact as they are given."""

    o: np.ndarray  # (n, 3) float64, of the parent
    d: np.ndarray  # (n, 3)
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)
    prim: np.ndarray  # (n,) the primitive that it hits first, -1: none
    t: np.ndarray  # (n,) where, rounded, like the next two
    n: np.ndarray  # (n, 3) the normal there, outwards
    p: np.ndarray  # (n, 3) the point
    p_error: np.ndarray  # (n, 3) bound on its error; inf: not known
    w: np.ndarray  # (n, 3) direction of the ray
    q: np.ndarray  # (n, 3) its origin

    @property
    def point(self) -> Vector:
        """p as approximate numbers."""
        return tuple(map(Approximate, np.ascontiguousarray(self.p.T), np.ascontiguousarray(self.p_error.T)))

    @property
    def unresolved(self) -> np.ndarray:
        """(n,) bool: q is as close to p as float32 can tell."""
        off, size = (np.abs(a).max(axis=-1) for a in (self.q - self.p, self.p))
        return np.asarray(off <= FLOAT32_RESOLUTION * size)

    def rows(self, rows: Any) -> "Departures":
        return Departures(*(a[rows] for a in self))


class OriginJudge:
    """Judges origins of rays on the primitives of an oracle."""

    def __init__(self, oracle: Oracle) -> None:
        self.oracle = oracle
        numbers = np.concatenate([np.zeros(0, np.int64), *(part.ids for part in oracle.parts)])
        self.row_of = np.append(np.argsort(numbers), -1)  # by number of a primitive, its index among all rows

    def judge(self, rays: Departures) -> tuple[np.ndarray, np.ndarray]:
        """On each origin (sum of findings, number of a skipped primitive or -1), exact where float64 is unsure."""
        found, between = np.zeros(len(rays.q), np.uint8), np.full(len(rays.q), -1)
        for row in np.flatnonzero(~self.certainly_right(rays)).tolist():
            found[row], between[row] = self.judge_exactly(rays.rows(row))
        return found, between

    # ---- float64

    def certainly_right(self, rays: Departures) -> np.ndarray:
        """(n,) bool: the error bounds of float64 exclude all errors."""
        with np.errstate(all="ignore"):
            right = self._on_right_side(rays)
            nearby = np.abs(rays.p).max(axis=1) * LARGEST_POINT_ERROR
            right &= np.isfinite(rays.q).all(axis=1) & (rays.p_error.max(axis=1) <= nearby)
            rows = np.flatnonzero(right)
            some = rays.rows(rows)
            for _, ray, box, _ in self.oracle.tree.crossings(some.p, some.q - some.p, 0.0, 1.0):
                others = box != self.row_of[some.prim[ray]]
                ray, box = ray[others], box[others]
                right[rows[ray[~self._clear(some.rows(ray), box)]]] = False
        return right

    def _on_right_side(self, rays: Departures) -> np.ndarray:
        """(n,) bool: the ray certainly starts on the side that it leads to, and stays there."""
        own = self.row_of[rays.prim]
        right = np.zeros(len(own), bool)
        for rows, surface in self._surfaces(own):
            some = rays.rows(rows)
            p, w, q = some.point, approximate_vector(some.w), approximate_vector(some.q)
            side, wanted = surface.value(q).sign(), surface.slope(p, w).sign()
            right[rows] = side * wanted > 0
            if surface.curved:  # and convex: outside, a distance that grows at q along w never falls again
                right[rows] &= (wanted < 0) | (surface.slope(q, w).sign() > 0)
        return right

    def _clear(self, rays: Departures, other: np.ndarray) -> np.ndarray:
        """(m,) bool: primitive other[i], an index among all rows, certainly does not cross the way from p to q."""
        clear = np.zeros(len(other), bool)
        for rows, surface in self._surfaces(other):
            some = rays.rows(rows)
            p, q = some.point, approximate_vector(some.q)
            here, there, back = surface.value(p).sign(), surface.value(q).sign(), sub(p, q)
            same = here * there > 0
            if surface.curved:
                leaving = (surface.slope(q, back).sign() > 0) | (surface.slope(p, back).sign() < 0)
                same &= (here < 0) | leaving
            elif surface.corners:
                corners = [sub(corner, q) for corner in surface.corners]
                edges: list[Any] = [dot(cross(corners[i], corners[i - 1]), back) for i in range(3)]
                signs = [edge.sign() for edge in edges]
                same |= (np.max(signs, axis=0) > 0) & (np.min(signs, axis=0) < 0)
            clear[rows] = same
        return clear

    def _surfaces(self, index: np.ndarray) -> Iterator[tuple[np.ndarray, ImplicitSurface]]:
        """(rows of index, their surfaces) for each array of primitives that has them."""
        for part, rows, k in self.oracle.by_part(index):
            if part.kind.surface is not None:
                vectors = part.kind.vectors(part.prims, k).swapaxes(0, 1)
                yield rows, part.kind.surface([*map(approximate_vector, vectors)])

    # ---- exactly

    def judge_exactly(self, ray: Departures) -> tuple[int, int]:
        """(finding, skipped primitive) of one ray, a row of Departures."""
        try:
            answer = self.oracle.first_hit(ray.o, ray.d, float(ray.t_min), float(ray.t_max))
        except OutsideDomain:
            return UNDECIDED, -1
        prims = answer.prims.tolist()
        if answer.t is None or ray.prim not in prims or not np.isfinite(ray.q).all():
            return UNDECIDED, -1
        (line,) = integer_rays(ray.q[None], ray.w[None])
        found, places = 0, points_at(answer.t, ray)
        for part, _, rows in self.oracle.by_part(self.row_of[prims]):
            for k in rows.tolist():
                of_member = _own_surface(part, k, places, ray, line)
                found |= of_member if part.ids[k] == ray.prim or not of_member else UNDECIDED
        between, *others = {self._between(p, ray, line, prims) for p in places}
        if others:
            return found | UNDECIDED, -1
        found |= SKIPPED if between >= 0 else 0
        return (found & WRONG or found), between

    def _between(self, p: Vector, ray: Departures, line: IntegerRay, members: list[int]) -> int:
        """A primitive other than the members that meets the way from q to p, or -1."""
        way = sub(exact_vector(ray.q), p)
        scale = math.lcm(*(x.denominator for x in way))
        x, y, z = (int(scale * each) for each in way)
        if not (x or y or z):
            return -1
        # From p to q, so that what rays meet from outside only counts as they would meet it.
        at_p, line = Fraction(-1, scale), IntegerRay(line.o, line.ko, (x, y, z), 0)
        start = np.array([[float(each) for each in p]])
        (near,) = self.oracle.candidates(start, ray.q - start, 0.0, 1.0)
        others = [(part, k) for part, k, _ in near if part.ids[k] not in members]
        return min(
            (int(part.ids[k]) for part, k in others if any(at_p < t <= 0 for t, _ in part.intersect(k, line))),
            default=-1,
        )


def _own_surface(part: PrimitiveArray, k: int, places: list[Vector], ray: Departures, line: IntegerRay) -> int:
    """The finding of self-hit and side for one primitive that passes through p, which is within `places`."""
    if part.kind.surface is None:
        return UNDECIDED
    surface = part.kind.surface([*map(exact_vector, part.kind.vectors(part.prims, k))])
    w = exact_vector(ray.w)
    wanted, *others = {sign(surface.slope(p, w)) for p in places}
    if others or not wanted:
        return UNDECIDED
    side = sign(surface.value(exact_vector(ray.q)))
    stays_inside = surface.curved and side == wanted == -1  # it may leave the surface on the far side
    hits_itself = not stays_inside and any(at >= 0 for at, _ in part.intersect(k, line))
    return (SELF_HIT if hits_itself else 0) | (WRONG_SIDE if side != wanted else 0)


def points_at(t: Root, ray: Departures) -> list[Vector]:
    """The exact point o + t d of the parent ray, or two points that enclose it."""
    bits = ENCLOSURE_BITS + abs(t.p).bit_length() if t.q else 0
    scale = Fraction(2) ** (t.e - bits) / t.s
    pairs = list(zip(exact_vector(ray.o), exact_vector(ray.d), strict=True))
    return [tuple(o + n * scale * d for o, d in pairs) for n in dict.fromkeys(t.numerators(bits))]
