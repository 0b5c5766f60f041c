"""Scores of witnesses in one setting: wrong hits and misses, wrong primitives, errors of t."""

from typing import Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from mitsuba_ref.experiment.exact_hits import ExactHits
from mitsuba_ref.experiment.results import largest
from mitsuba_ref.stress.witnesses import Absent, Observation, PreparedSetting

# In a closed mesh every ray from inside hits, so exact arithmetic need not decide all of them: it decides this many,
# spread evenly, and the first of those that some witness reports as misses.
ADJUDICATED_IF_CLOSED, CONFIRMED_MISSES = 1000, 200  # rays

WRONG_RAYS_LISTED = 5


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
    status: Literal["ok"] = "ok"

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


@dataclass(frozen=True)
class Bound:
    """Predictions of the error model: the largest bound of the setting's rays, in the family's unit."""

    float32: float | None  # None: float32 resolves none of the rays
    float64: float | None
    unresolved: int  # rays without a float32 bound


class ExactAnswers(NamedTuple):
    """Exact answers of a setting: hit or miss for each ray, everything for the adjudicated ones."""

    hit: np.ndarray  # (n,) bool, of all rays
    rows: np.ndarray  # (m,) the adjudicated rays
    hits: ExactHits  # of these


def exact_answers(ready: PreparedSetting, reported_misses: np.ndarray) -> ExactAnswers:
    """Exact answers; all rays are adjudicated but for a closed mesh.

    reported_misses: (n,) rays that some witness reports as misses. Raises AssertionError if a ray leaves a closed mesh.
    """
    count = len(ready.o)
    if ready.setting.closed:
        sample = np.linspace(0, count - 1, min(count, ADJUDICATED_IF_CLOSED)).astype(int)
        rows = np.union1d(sample, np.flatnonzero(reported_misses)[:CONFIRMED_MISSES])
    else:
        rows = np.arange(count)
    hits = ExactHits(ready, ready.o[rows], ready.d[rows])
    hit = np.ones(count, bool)
    hit[rows] = hits.hit
    if ready.setting.closed and not hit.all():
        raise AssertionError(
            f"ray {int(np.argmin(hit))} leaves a closed mesh from inside by exact arithmetic"
        )
    return ExactAnswers(hit, rows, hits)


class Scorer:
    """Compares witnesses with the exact answers of one setting."""

    def __init__(self, ready: PreparedSetting, exact: ExactAnswers) -> None:
        self.primitives, self.exact = ready.primitives, exact
        length = np.linalg.norm(exact.hits.d, axis=1)
        unit = ready.setting.unit
        self.unit = np.abs(exact.hits.t) if unit is None else unit / length  # (m,) lengths of d
        self.hit_rows = np.flatnonzero(exact.hits.hit)

    @property
    def bound(self) -> Bound:
        hits, rows = self.exact.hits, self.hit_rows
        float32, float64 = (bound[rows] / self.unit[rows] for bound in (hits.float32, hits.float64))
        return Bound(largest(float32), largest(float64), int(np.sum(~np.isfinite(hits.float32[rows]))))

    def score(self, found: Observation | Absent, *, ours: bool) -> Score | Absent:
        if isinstance(found, Absent):
            return found
        hit, rows, hits = self.exact
        both = self.hit_rows[found.hit[rows[self.hit_rows]]]
        errors = hits.errors(both, found.t[rows[both]])
        prim = found.prim[rows[both]]
        other = np.array([int(k) not in hits.ties[i] for i, k in zip(both, prim, strict=True)], bool)
        allowed = (hits.float64 if ours else hits.float32)[both]
        named = np.flatnonzero(other & (prim >= 0) & (prim < self.primitives))
        of_named = hits.bounds(both[named], prim[named])[0 if ours else 1]
        allowed[named] = np.maximum(allowed[named], of_named)
        beyond = ~(errors <= allowed)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(errors > 0.0, errors / allowed, 0.0)
        relative = errors / self.unit[both]
        wrong = found.hit != hit
        wrong[rows[both[beyond | other]]] = True
        return Score(
            false_hits=int(np.sum(found.hit & ~hit)),
            false_misses=int(np.sum(~found.hit & hit)),
            wrong_primitives=int(other.sum()),
            beyond=int(beyond.sum()),
            compared=len(both),
            worst=largest(ratio),
            error=largest(relative),
            median=float(np.median(relative)) if len(both) else None,
            first_wrong=tuple(np.flatnonzero(wrong)[:WRONG_RAYS_LISTED].tolist()),
        )
