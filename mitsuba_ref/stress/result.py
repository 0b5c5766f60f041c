"""What became of a sweep; JSON is the truth, tables and plots are views of it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from mitsuba_ref.stress.family import Family
from mitsuba_ref.stress.score import Bound, Score
from mitsuba_ref.stress.witnesses import OURS, SCREEN, WITNESSES, Absent

FORMAT = 1  # of the JSON; goes up when a key changes its meaning or goes away
OWN = (OURS.key, SCREEN.key)


@dataclass(frozen=True)
class Outcome:
    """One setting."""

    x: float
    rays: int
    hits: int  # exact
    misses: int  # exact
    asked: int  # rays that exact arithmetic was asked about; of a closed mesh it knows without
    closed: bool  # whether all rays start inside a closed mesh
    ties: int  # rays that hit several primitives at exactly the same t
    bound: Bound
    scores: Mapping[str, Score | Absent]  # by witness

    def to_dict(self) -> dict[str, Any]:
        exact = {name: getattr(self, name) for name in ("asked", "hits", "misses", "ties")}
        said = {key: as_dict(score) for key, score in self.scores.items()}
        return {
            "x": self.x,
            "rays": self.rays,
            "exact": exact,
            "bound": asdict(self.bound),
            "witnesses": said,
        }


def as_dict(score: Score | Absent) -> dict[str, Any]:
    if isinstance(score, Absent):
        return {"status": score.status, "why": score.why}
    return {"status": "ok", **score.to_dict()}


@dataclass(frozen=True)
class Sweep:
    """One family, as far as it came."""

    family: Family
    outcomes: tuple[Outcome, ...]
    seconds: float = 0.0

    @property
    def problems(self) -> list[str]:
        """Why the sweep does not pass, in lines."""
        return [
            line for outcome in self.outcomes for line in (*self._vacuous(outcome), *self._faults(outcome))
        ]

    def _vacuous(self, outcome: Outcome) -> list[str]:
        missing = [
            name
            for name, count, wanted in (
                ("hits", outcome.hits, True),
                ("misses", outcome.misses, self.family.misses),
            )
            if wanted and not count
        ]
        why = f"of {outcome.rays} rays, so it shows nothing; more --rays may help"
        return [f"{self.at(outcome)}: exact arithmetic has no {name} {why}" for name in missing]

    def _faults(self, outcome: Outcome) -> list[str]:
        lines = []
        for key in OWN:
            score = outcome.scores[key]
            if isinstance(score, Score) and score.fails:
                lines.append(
                    f"{self.at(outcome)}: {key}: {score.wrong_masks} wrong masks, {score.wrong_primitives} wrong "
                    f"primitives, {score.beyond} errors beyond their bound; rays {list(score.first_wrong)}"
                )
        return lines

    def at(self, outcome: Outcome) -> str:
        return f"{self.family.name}, {self.family.quantity} {outcome.x:g}"

    @property
    def ok(self) -> bool:
        return bool(self.outcomes) and not self.problems

    def breakdowns(self, key: str) -> list[float]:
        """The first x at which a witness breaks down, on either side of where the family is easiest."""
        easy = self.family.easiest
        up = [outcome for outcome in self.outcomes if outcome.x >= easy]
        down = [outcome for outcome in reversed(self.outcomes) if outcome.x < easy]
        firsts = (next((outcome.x for outcome in side if broken(outcome, key)), None) for side in (down, up))
        return [x for x in firsts if x is not None]

    def absence(self, key: str) -> Absent | None:
        """Why a witness has no line at all, if it has none."""
        scores = [outcome.scores[key] for outcome in self.outcomes]
        absent = [score for score in scores if isinstance(score, Absent)]
        return absent[0] if absent and len(absent) == len(scores) else None

    def to_dict(self) -> dict[str, Any]:
        family = self.family
        return {
            "name": family.name,
            "title": family.title,
            "quantity": family.quantity,
            "error": family.error,
            "ok": self.ok,
            "problems": self.problems,
            "seconds": round(self.seconds, 3),
            "breakdowns": {witness.key: self.breakdowns(witness.key) for witness in WITNESSES},
            "settings": [outcome.to_dict() for outcome in self.outcomes],
        }


def broken(outcome: Outcome, key: str) -> bool:
    """Whether a witness breaks down here; one that gives no answer does."""
    score = outcome.scores[key]
    return score.status == "crash" if isinstance(score, Absent) else score.breaks


def as_json(
    sweeps: Sequence[Sweep], asked: Sequence[str], seed: int, versions: Mapping[str, str]
) -> dict[str, Any]:
    """Everything about a run; `asked`: the families it was to sweep, of which it may have done some only."""
    return {
        "format": FORMAT,
        "seed": seed,
        "versions": dict(versions),
        "asked": list(asked),
        "ok": all(sweep.ok for sweep in sweeps) and len(sweeps) == len(asked),
        "families": [sweep.to_dict() for sweep in sweeps],
    }
