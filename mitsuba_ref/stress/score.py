"""What one witness got wrong in one setting."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mitsuba_ref.bounds import bounds_of
from mitsuba_ref.stress.truth import Truth
from mitsuba_ref.stress.witnesses import Absent, Prepared, Sight


@dataclass(frozen=True)
class Score:
    """Counts of rays; errors of t in the family's unit, over rays that both the witness and exact arithmetic hit."""

    false_hits: int
    false_misses: int
    wrong_primitives: int  # hits of another primitive than those that are hit first, exactly
    beyond: int  # errors beyond the bound of their ray
    compared: int  # rays whose t was compared
    worst: float | None  # largest error over its bound
    error: float | None  # largest
    median: float | None
    first_wrong: tuple[int, ...] = ()  # the first rays that are wrong in any of these ways

    @property
    def wrong_masks(self) -> int:
        return self.false_hits + self.false_misses

    @property
    def fails(self) -> bool:
        """Whether this is beyond what our caster may do."""
        return bool(self.wrong_masks or self.wrong_primitives or self.beyond)

    @property
    def breaks(self) -> bool:
        """Whether this is a breakdown: a wrong mask, or an error beyond what rounding explains."""
        return bool(self.wrong_masks or self.beyond)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"first_wrong": list(self.first_wrong)}


SHOWN = 5  # rays that are named, of those that are wrong


@dataclass(frozen=True)
class Bound:
    """What the error model predicts for a setting: the largest bound of its rays, in the family's unit."""

    float32: float | None  # None: float32 resolves none of the rays
    float64: float | None
    unresolved: int  # rays without a float32 bound


class Scorer:
    """One setting's exact answers, and the bounds around them."""

    def __init__(self, ready: Prepared, truth: Truth) -> None:
        self.ready, self.truth = ready, truth
        self.hits = np.array([i for i, answer in enumerate(truth.answers) if answer.hit], int)
        d = ready.setting.d[truth.rows[self.hits]].astype(np.float64)
        t = truth.t[self.hits]
        unit = ready.setting.unit
        self.unit = np.abs(t) if unit is None else unit / np.linalg.norm(d, axis=1)
        every = [[tie.prim for tie in answer.ties] for answer in truth.answers if answer.hit]
        pair = np.repeat(np.arange(len(self.hits)), [len(prims) for prims in every])
        prims = np.array([prim for prims in every for prim in prims], int)
        self.ties = [frozenset(prims) for prims in every]
        self.float64, self.float32 = (np.zeros(len(self.hits)) for _ in range(2))
        for out, bound in zip((self.float64, self.float32), self.bounds(pair, prims), strict=True):
            np.maximum.at(out, pair, bound)

    def bounds(self, hit: np.ndarray, prim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of ours and of a float32 caster: how far t may be off at primitive prim[i] for the exact hit hit[i]."""
        rows = self.truth.rows[self.hits[hit]]
        o, d = (a[rows].astype(np.float64) for a in (self.ready.setting.o, self.ready.setting.d))
        found = bounds_of(self.ready.model, prim, o, d, self.truth.t[self.hits[hit]])
        own, theirs = (np.where(np.isnan(at.t_error), np.inf, at.t_error) for at in (found.own, found.at))
        return own, theirs

    @property
    def bound(self) -> Bound:
        resolved = np.isfinite(self.float32)
        return Bound(
            largest(self.float32 / self.unit), largest(self.float64 / self.unit), int(np.sum(~resolved))
        )

    def score(self, sight: Sight, *, ours: bool) -> Score:
        truth, said = self.truth, sight.hit
        rows = truth.rows[self.hits]
        both = np.flatnonzero(said[rows])
        errors = np.array([self._off(i, sight.t[rows[i]]) for i in both.tolist()])
        named = sight.prim[rows[both]]
        other = np.array([int(prim) not in self.ties[i] for i, prim in zip(both, named, strict=True)], bool)
        allowed = (self.float64 if ours else self.float32)[both]
        told = np.flatnonzero(other & (named >= 0) & (named < self.ready.packed.first[-1]))
        of_named = self.bounds(both[told], named[told])[0 if ours else 1]
        allowed[told] = np.maximum(allowed[told], of_named)
        beyond = ~(errors <= allowed)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(errors > 0.0, errors / allowed, 0.0)
        wrong = said != truth.hit
        wrong[rows[both[beyond | other]]] = True
        return Score(
            false_hits=int(np.sum(said & ~truth.hit)),
            false_misses=int(np.sum(~said & truth.hit)),
            wrong_primitives=int(other.sum()),
            beyond=int(beyond.sum()),
            compared=len(both),
            worst=largest(ratio),
            error=largest(errors / self.unit[both]),
            median=float(np.median(errors / self.unit[both])) if len(both) else None,
            first_wrong=tuple(np.flatnonzero(wrong)[:SHOWN].tolist()),
        )

    def _off(self, i: int, t: float) -> float:
        """|t - exact|, exactly rounded; NaN for a NaN."""
        exact = self.truth.answers[self.hits[i]].t
        return float("nan") if exact is None or np.isnan(t) else exact.off(t)


def largest(values: np.ndarray) -> float | None:
    """The largest finite one; None where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def judged(scorer: Scorer, sight: Sight | Absent, *, ours: bool) -> Score | Absent:
    return sight if isinstance(sight, Absent) else scorer.score(sight, ours=ours)
