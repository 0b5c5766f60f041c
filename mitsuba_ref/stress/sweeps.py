"""What became of a sweep; JSON is the truth, tables and plots are views of it."""

import importlib.metadata
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.variants import usable_variants
from mitsuba_ref.stress import witnesses
from mitsuba_ref.stress.family import Family
from mitsuba_ref.stress.score import Bound, Score, Scorer, exact_answers, score_of
from mitsuba_ref.stress.witnesses import (
    OURS,
    REFERENCES,
    SCREEN,
    WITNESSES,
    Absent,
    Observation,
    PreparedSetting,
)

JSON_FORMAT = 1  # of the JSON; goes up when a key changes its meaning or goes away
OUR_KEYS = (OURS.key, SCREEN.key)


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
        for key in OUR_KEYS:
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
        "format": JSON_FORMAT,
        "seed": seed,
        "versions": dict(versions),
        "asked": list(asked),
        "ok": all(sweep.ok for sweep in sweeps) and len(sweeps) == len(asked),
        "families": [sweep.to_dict() for sweep in sweeps],
    }


# A family through all witnesses.


Progress = Callable[[str], None]
Observations = dict[str, Observation | Absent]  # by witness
PARALLEL_PROCESSES = 2  # at a time: each takes a core


def sweep(family: Family, seed: int, rays: int | None, say: Progress = lambda words: None) -> Sweep:
    """Every setting of a family. The same seed and number of rays give the same result, but for the seconds."""
    start = time.perf_counter()
    say("aiming")
    settings = prepared_settings(family, seed, rays)
    outcomes = []
    for i, (ready, said) in enumerate(zip(settings, observe(settings, say), strict=True)):
        say(f"exact answers {i + 1}/{len(settings)}")
        outcomes.append(score_setting(ready, said))
    return Sweep(family, tuple(outcomes), time.perf_counter() - start)


def prepared_settings(family: Family, seed: int, rays: int | None) -> list[PreparedSetting]:
    return [witnesses.prepare_setting(setting) for setting in family.settings(seed, rays)]


def observe(settings: Sequence[PreparedSetting], say: Progress) -> list[Observations]:
    """What all witnesses say of each setting. Mitsuba works in its own processes, while we do here."""
    pool = ThreadPoolExecutor(PARALLEL_PROCESSES)
    try:
        with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as folder:
            asked = {
                witness.key: pool.submit(
                    witnesses.ask_reference, witness, settings, Path(folder) / witness.key
                )
                for witness in REFERENCES
            }
            own = []
            for i, ready in enumerate(settings):
                say(f"ours {i + 1}/{len(settings)}")
                own.append(
                    {OURS.key: witnesses.cast_by_bvh(ready), SCREEN.key: witnesses.cast_by_raster(ready)}
                )
            say("waiting for Mitsuba")
            theirs = {key: future.result() for key, future in asked.items()}
    finally:  # also on Ctrl-C: no child is left behind
        subprocess_runner.kill_subprocesses()
        pool.shutdown(wait=True, cancel_futures=True)
        subprocess_runner.allow_subprocesses()
    return [sights | {key: each[i] for key, each in theirs.items()} for i, sights in enumerate(own)]


def score_setting(ready: PreparedSetting, said: Observations) -> Outcome:
    """The scores of one setting."""
    missed = [~sight.hit for sight in said.values() if isinstance(sight, Observation)]
    truth = exact_answers(ready, np.any(missed, axis=0))
    scorer = Scorer(ready, truth)
    scores = {key: score_of(scorer, sight, ours=key in OUR_KEYS) for key, sight in said.items()}
    hits = int(truth.hit.sum())
    ties = sum(len(answer.ties) > 1 for answer in truth.answers)
    count = len(ready.setting.o)
    closed = ready.setting.closed
    return Outcome(
        ready.setting.x, count, hits, count - hits, len(truth.rows), closed, ties, scorer.bound, scores
    )


def versions() -> dict[str, str]:
    """What was asked."""
    found = {name: package_version(name) for name in ("mitsuba", "drjit", "numpy")}
    library = usable_variants().libllvm
    return found | {"libllvm": Path(library).name if library else "none"}


def package_version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"
