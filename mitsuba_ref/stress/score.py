"""The exact answers about a setting."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mitsuba_ref.error_model.bounds import reference_bounds
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.stress.witnesses import Absent, Observation, PreparedSetting

# In a closed mesh every ray from inside hits, so that exact arithmetic need not look at all of them: it looks at
# this many, spread evenly, and at the first of those that some witness says are misses.
ADJUDICATED_IF_CLOSED, CONFIRMED_MISSES = 1000, 200


@dataclass(frozen=True)
class ExactAnswers:
    """Exact answers, one for each of the rays that were asked about."""

    hit: np.ndarray  # (n,) bool, of all rays
    rows: np.ndarray  # (m,) the rays that exact arithmetic was asked about
    answers: tuple[ExactAnswer, ...]  # m of them

    @cached_property
    def t(self) -> np.ndarray:
        """(m,) to the nearest float64, inf on a miss."""
        return np.array([np.inf if answer.t is None else float(answer.t) for answer in self.answers])


def exact_answers(ready: PreparedSetting, reported_misses: np.ndarray) -> ExactAnswers:
    """doubted: (n,) rays of which some witness says that they miss. Only a closed mesh leaves rays unasked."""
    count = len(ready.setting.o)
    if ready.setting.closed:
        sample = np.linspace(0, count - 1, min(count, ADJUDICATED_IF_CLOSED)).astype(int)
        rows = np.union1d(sample, np.flatnonzero(reported_misses)[:CONFIRMED_MISSES])
    else:
        rows = np.arange(count)
    o, d = (a[rows].astype(np.float64) for a in (ready.setting.o, ready.setting.d))
    answers = tuple(Oracle(ready.packed).first_hits(o, d))
    hit = np.ones(count, bool)
    hit[rows] = [answer.hit for answer in answers]
    if ready.setting.closed and not hit.all():
        raise AssertionError(
            f"ray {int(np.argmin(hit))} leaves a closed mesh from inside, says exact arithmetic"
        )
    return ExactAnswers(hit, rows, answers)


# What one witness got wrong in one setting.


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


MAX_RAYS_NAMED = 5  # rays that are named, of those that are wrong


@dataclass(frozen=True)
class Bound:
    """What the error model predicts for a setting: the largest bound of its rays, in the family's unit."""

    float32: float | None  # None: float32 resolves none of the rays
    float64: float | None
    unresolved: int  # rays without a float32 bound


class Scorer:
    """One setting's exact answers, and the bounds around them."""

    def __init__(self, ready: PreparedSetting, truth: ExactAnswers) -> None:
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
        found = reference_bounds(self.ready.model, prim, o, d, self.truth.t[self.hits[hit]])
        own, theirs = (np.where(np.isnan(at.t_error), np.inf, at.t_error) for at in (found.own, found.at))
        return own, theirs

    @property
    def bound(self) -> Bound:
        resolved = np.isfinite(self.float32)
        return Bound(
            largest(self.float32 / self.unit), largest(self.float64 / self.unit), int(np.sum(~resolved))
        )

    def score(self, sight: Observation, *, ours: bool) -> Score:
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
            first_wrong=tuple(np.flatnonzero(wrong)[:MAX_RAYS_NAMED].tolist()),
        )

    def _off(self, i: int, t: float) -> float:
        """|t - exact|, exactly rounded; NaN for a NaN."""
        exact = self.truth.answers[self.hits[i]].t
        return float("nan") if exact is None or np.isnan(t) else exact.off(t)


def largest(values: np.ndarray) -> float | None:
    """The largest finite one; None where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def score_of(scorer: Scorer, sight: Observation | Absent, *, ours: bool) -> Score | Absent:
    return sight if isinstance(sight, Absent) else scorer.score(sight, ours=ours)
