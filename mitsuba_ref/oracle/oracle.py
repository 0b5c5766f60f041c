"""Exact oracle: the first hit of a ray, computed in integers without any rounding."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Root, integer_ray
from mitsuba_ref.oracle.interface import (
    EXACT_KINDS,
    STAND_INS,
    Contact,
    ExactAnswer,
    ExactHit,
    OutsideDomain,
    check_rays,
)
from mitsuba_ref.oracle.primitive_index import CandidatePrimitive, PrimitiveArray, PrimitiveIndex, RayColumns

__all__ = ["EXACT_KINDS", "ExactAnswer", "ExactHit", "Oracle", "OutsideDomain", "Root"]


class PackedKind(Protocol):
    """All primitives of one kind: their arrays, and the number of each in the scene."""

    @property
    def prims(self) -> Any: ...
    @property
    def ids(self) -> np.ndarray: ...


class PackedScene(Protocol):
    """The packed primitives of a scene, as the oracle reads them; first[-1] is how many there are."""

    @property
    def kinds(self) -> Sequence[PackedKind]: ...
    @property
    def first(self) -> np.ndarray: ...


class Oracle:
    """Exact first hits and roots on the packed primitives of one scene."""

    def __init__(self, packed: PackedScene, stand_ins: Sequence[Any] | None = None) -> None:
        """stand_ins: arrays that replace those of packed.kinds: what the reference traces (SceneModel.kinds).

        Raises OutsideDomain for a primitive with a number that is not finite (a face is dropped instead), and
        LookupError for a kind that has no exact arithmetic.
        """
        arrays = [kind.prims for kind in packed.kinds] if stand_ins is None else stand_ins
        ids = [np.asarray(kind.ids) for kind in packed.kinds]
        self.primitives = PrimitiveIndex([part_of(*pair) for pair in zip(arrays, ids, strict=True)])
        self.count = int(packed.first[-1])
        self._always = frozenset() if self.primitives.present.all() else frozenset({"dropped"})

    def first_hit(
        self, o: Iterable[float], d: Iterable[float], t_min: float = 0.0, t_max: float = math.inf
    ) -> ExactAnswer:
        """The first hit of the ray o + t d, three floats each, at t_min < t <= t_max.

        Raises OutsideDomain for a ray that is not finite or has no direction.
        """
        (answer,) = self.first_hits(np.array([[*o]], np.float64), np.array([[*d]], np.float64), t_min, t_max)
        return answer

    def first_hits(
        self,
        o: np.ndarray,
        d: np.ndarray,
        t_min: np.ndarray | float = 0.0,
        t_max: np.ndarray | float = math.inf,
    ) -> list[ExactAnswer]:
        """First hits of rays (n, 3), (n, 3), with one t_min and t_max for all or (n,) of them; faster per ray.

        Raises OutsideDomain, naming the first ray that is not finite or has no direction.
        """
        o, d = np.asarray(o, np.float64).reshape(-1, 3), np.asarray(d, np.float64).reshape(-1, 3)
        starts, ends = (np.broadcast_to(np.asarray(t, np.float64), len(o)) for t in (t_min, t_max))
        check_rays(o, d, starts, ends)
        candidates = self.primitives.candidates(RayColumns(o.T.copy(), d.T.copy(), starts, ends))
        rays = zip(o.tolist(), d.tolist(), starts.tolist(), ends.tolist(), candidates, strict=True)
        return [self._first(integer_ray(*line), (start, end), near) for *line, start, end, near in rays]

    def _first(
        self, ray: IntegerRay, span: tuple[float, float], candidates: Iterable[CandidatePrimitive]
    ) -> ExactAnswer:
        """The first hit among candidates, which are sorted by a lower bound of t."""
        best: Root | None = None
        ties: dict[int, ExactHit] = {}
        contacts: list[Contact] = []
        for part, k, near in candidates:
            if best is not None and best < near:
                break
            crossed = part.intersect(k, ray)
            contacts += crossed.contacts
            t, where = next((root for root in crossed.roots if root[0] > span[0]), (None, ""))
            if t is None or t > span[1]:
                continue
            order = -1 if best is None else t.compare(best)
            if order < 0:
                best, ties = t, {}
            if order <= 0:
                prim = int(part.ids[k])
                ties.setdefault(prim, ExactHit(prim, t, where))
        flags = (
            self._always
            | contacts_before(contacts, span, best)
            | {hit.where for hit in ties.values()} & {"tangent"}
        )
        return ExactAnswer(best, tuple(ties[prim] for prim in sorted(ties)), flags)

    def roots(self, prim: int, o: Iterable[float], d: Iterable[float]) -> tuple[ExactHit, ...]:
        """Every root of primitive number `prim`, at any t, ascending; none for a face that is dropped.

        Raises OutsideDomain for a ray that is not finite or has no direction, IndexError for a number that is none.
        """
        if not 0 <= prim < self.count:
            raise IndexError(f"the scene has primitives 0 to {self.count - 1}, got {prim}")
        line = np.array([[*o]], np.float64), np.array([[*d]], np.float64)
        check_rays(*line, np.zeros(1), np.zeros(1))
        ray = integer_ray(*(vector[0].tolist() for vector in line))
        crossed = [part.intersect(k, ray) for part, k in self.primitives.numbered(prim)]
        found = {t: ExactHit(prim, t, where) for roots, _ in crossed for t, where in roots}
        return tuple(found[t] for t in sorted(found))


def contacts_before(
    contacts: Iterable[Contact], span: tuple[float, float], best: Root | None
) -> frozenset[str]:
    """Kinds of contacts after t_min and not after the first hit, or else t_max."""
    end = span[1] if best is None else best
    return frozenset(
        why
        for why, first, last in contacts
        if first is None or last is None or (first <= end and last > span[0])
    )


def part_of(prims: Any, ids: np.ndarray) -> PrimitiveArray:
    """The primitives with their exact arithmetic; stand-ins in pieces that have one."""
    if type(prims) in STAND_INS:
        prims, owner = STAND_INS[type(prims)](prims)
        ids = ids[owner]
    if type(prims) not in EXACT_KINDS:
        raise LookupError(
            f"{type(prims).__name__} has no exact arithmetic: write an ExactKind (mitsuba_ref/oracle/interface.py) "
            "and name it as `exact` in the ErrorModel of the kind, in mitsuba_ref/shapes, which has to be imported"
        )
    return PrimitiveArray(EXACT_KINDS[type(prims)], prims, ids, {})
