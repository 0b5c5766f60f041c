"""Sweeps of families through all witnesses, and their results; tables, JSON and pages are views of these."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.hard.family import Family
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.report.results import NOTHING, aligned
from mitsuba_ref.stress import score
from mitsuba_ref.stress.score import (
    BESIDE_CANDIDATE,
    CANDIDATE,
    OURS,
    REFERENCES,
    WITNESSES,
    Absent,
    Bound,
    Observation,
    PreparedSetting,
    Score,
    Scorer,
    Witness,
    exact_answers,
)
from mitsuba_ref.subjects.subject import Answer, Subject

JSON_FORMAT = 1  # goes up when a key changes its meaning or goes away
PARALLEL_PROCESSES = 2  # Mitsuba's child processes at a time: each takes a core

Progress = Callable[[str], None]
Observations = dict[str, Observation | Answer | Absent]  # by witness; an Answer of the candidate


@dataclass(frozen=True)
class ExactCounts:
    """Rays of a setting by their exact answers."""

    adjudicated: int  # rays decided by exact arithmetic; a closed mesh needs only a sample
    hits: int
    misses: int
    ties: int  # rays that hit several primitives at exactly the same t


@dataclass(frozen=True)
class SettingResult:
    """Scores of all witnesses in one setting."""

    x: float
    rays: int
    exact: ExactCounts
    bound: Bound
    witnesses: Mapping[str, Score | Absent]

    def breaks(self, key: str) -> bool:
        """Whether a witness breaks down here; one that crashes does."""
        score = self.witnesses[key]
        return score.breaks if isinstance(score, Score) else score.status == "crash"


@dataclass(frozen=True)
class SweepResult:
    """One family, as far as it was swept."""

    name: str
    title: str
    quantity: str
    error: str
    easiest: float
    misses: bool  # whether exact misses are expected; not from inside a closed mesh
    settings: tuple[SettingResult, ...]
    seconds: float = 0.0
    declined: str = ""  # the candidate's own words, where it declined every setting

    @property
    def witnesses(self) -> tuple[Witness, ...]:
        """Those that were asked."""
        with_candidate = any(CANDIDATE.key in setting.witnesses for setting in self.settings)
        return BESIDE_CANDIDATE if with_candidate else WITNESSES

    @property
    def judged(self) -> str:
        """Key of the witness that has to be right."""
        return (CANDIDATE if self.witnesses is BESIDE_CANDIDATE else OURS).key

    @classmethod
    def of(
        cls, family: Family, settings: Sequence[SettingResult], seconds: float = 0.0, declined: str = ""
    ) -> "SweepResult":
        words = (family.name, family.title, family.quantity, family.error)
        return cls(*words, family.easiest, not family.closed, tuple(settings), round(seconds, 3), declined)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return bool(self.settings) and not self.problems

    @computed_field  # type: ignore[prop-decorator]
    @property
    def problems(self) -> list[str]:
        """Why the sweep fails, in lines."""
        if self.declined:
            return [f"{self.name}: the candidate declined every setting: {self.declined}"]
        return [line for setting in self.settings for line in (*self._vacuous(setting), *self._faults(setting))]

    def _vacuous(self, setting: SettingResult) -> Iterator[str]:
        counts = {"hits": setting.exact.hits} | ({"misses": setting.exact.misses} if self.misses else {})
        for name, count in counts.items():
            if not count:
                yield (
                    f"{self._where(setting)}: exact arithmetic has no {name} of {setting.rays} rays, "
                    "so the setting tests nothing; more --rays may help"
                )

    def _faults(self, setting: SettingResult) -> Iterator[str]:
        key = self.judged
        score = setting.witnesses[key]
        if isinstance(score, Score) and score.fails:
            primitives = f"{score.wrong_primitives} wrong primitives, " if key == OURS.key else ""
            yield (
                f"{self._where(setting)}: {key}: {score.false_hits} false hits, {score.false_misses} false misses, "
                f"{primitives}{score.beyond} hits beyond their bounds; rays {list(score.first_wrong)}"
                f"{score.example and '; ' + score.example}"
            )
        elif isinstance(score, Absent) and score.status == "crash":
            yield f"{self._where(setting)}: {key}: no answer: {score.why}"

    def _where(self, setting: SettingResult) -> str:
        return f"{self.name}, {self.quantity} {setting.x:g}"

    @computed_field  # type: ignore[prop-decorator]
    @property
    def breakdowns(self) -> dict[str, list[float]]:
        """By witness, the first x at which it breaks down, on either side of where the family is easiest."""
        return {witness.key: self._breakdowns(witness.key) for witness in self.witnesses}

    def _breakdowns(self, key: str) -> list[float]:
        up = [setting for setting in self.settings if setting.x >= self.easiest]
        down = [setting for setting in reversed(self.settings) if setting.x < self.easiest]
        firsts = (next((each.x for each in side if each.breaks(key)), None) for side in (down, up))
        return [x for x in firsts if x is not None]

    def absence(self, key: str) -> Absent | None:
        """Why a witness has no score in any setting; None if it has one."""
        scores = [setting.witnesses[key] for setting in self.settings]
        absent = [score for score in scores if isinstance(score, Absent)]
        return absent[0] if absent and len(absent) == len(scores) else None


@dataclass(frozen=True)
class StressRun:
    """A run of `mitsuba-ref stress`. requested: the selected families; an interrupted run has results of some only."""

    seed: int
    versions: Mapping[str, str]
    requested: tuple[str, ...]
    families: tuple[SweepResult, ...]
    skip_unsupported: bool = False  # families that the candidate declined do not fail the run, others being judged
    format: int = JSON_FORMAT

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        judged = [sweep for sweep in self.families if not (self.skip_unsupported and sweep.declined)]
        return all(sweep.ok for sweep in judged) and bool(judged) and len(self.families) == len(self.requested)


def sweep(
    family: Family,
    seed: int,
    rays: int | None,
    on_progress: Progress = lambda words: None,
    candidate: Subject | None = None,
) -> SweepResult:
    """Every setting of a family. The same seed and number of rays give the same result, but for the seconds.

    candidate: one that takes rays, judged in place of our caster.
    """
    start = time.perf_counter()
    on_progress("aiming")
    settings = [score.prepare_setting(family, seed, x, rays) for x in family.values]
    if candidate and (declined := declined_words(candidate, settings)):
        return SweepResult.of(family, (), time.perf_counter() - start, declined)
    results = []
    for i, (ready, observations) in enumerate(zip(settings, observe(settings, on_progress, candidate), strict=True)):
        on_progress(f"exact answers {i + 1}/{len(settings)}")
        results.append(score_setting(ready, observations))
    return SweepResult.of(family, results, time.perf_counter() - start)


def declined_words(candidate: Subject, settings: Sequence[PreparedSetting]) -> str:
    """Why a candidate declines every setting, of the first; "" where it answers one, before anything else is done."""
    words = ""
    for ready in settings:
        found = score.ask_candidate(candidate, ready)
        if not isinstance(found, Absent) or found.status != "not applicable":
            return ""
        words = words or found.why
    return words


def observe(
    settings: Sequence[PreparedSetting], on_progress: Progress, candidate: Subject | None = None
) -> list[Observations]:
    """What each witness finds in each setting. Mitsuba runs in child processes beside our caster."""
    references = [each for each in REFERENCES if candidate is None or each in BESIDE_CANDIDATE]
    pool = ThreadPoolExecutor(PARALLEL_PROCESSES)
    try:
        with ScratchFolder() as folder:
            submitted = {
                witness.key: pool.submit(score.trace_by_reference, witness, settings, Path(folder) / witness.key)
                for witness in references
            }
            own: list[Observations] = []
            for i, ready in enumerate(settings):
                on_progress(f"{'candidate' if candidate else 'ours'} {i + 1}/{len(settings)}")
                own.append({OURS.key: score.cast_by_bvh(ready)})
                if candidate:
                    own[-1] = {CANDIDATE.key: score.ask_candidate(candidate, ready), **own[-1]}
            on_progress("waiting for Mitsuba")
            theirs = {key: future.result() for key, future in submitted.items()}
    finally:  # also on Ctrl-C: no child is left behind
        subprocess_runner.kill_subprocesses()
        pool.shutdown(wait=True, cancel_futures=True)
        subprocess_runner.allow_subprocesses()
    return [found | {key: each[i] for key, each in theirs.items()} for i, found in enumerate(own)]


def score_setting(ready: PreparedSetting, observations: Observations) -> SettingResult:
    """The scores of one setting."""
    missed = [~found.hit for found in observations.values() if not isinstance(found, Absent)]
    exact = exact_answers(ready, np.any(missed, axis=0))
    scorer = Scorer(ready, exact)
    scores = {
        key: scorer.score_candidate(found) if isinstance(found, Answer) else scorer.score(found, ours=key == OURS.key)
        for key, found in observations.items()
    }
    hits, count = int(exact.hit.sum()), len(ready.o)
    ties = sum(len(tied) > 1 for tied in exact.hits.ties)
    counts = ExactCounts(len(exact.rows), hits, count - hits, ties)
    return SettingResult(ready.x, count, counts, scorer.bound, scores)


# A sweep as a table: its cells, and the text for a terminal.


def as_text(sweep: SweepResult, skip_unsupported: bool = False) -> str:
    """Head, one row a setting, the breakdowns of each witness, and the failures; a line where all is declined."""
    if sweep.declined:
        mark, why = "SKIP" if skip_unsupported else "FAIL", sweep.declined.partition("\n")[0]
        return f"{mark}  {sweep.name}: {sweep.title}; the candidate declined every setting: {why}"
    mark = "PASS" if sweep.ok else "FAIL"
    head = f"{mark}  {sweep.name}: {sweep.title}; {sweep.error}, wrong hits or misses   {sweep.seconds:.1f} s"
    problems = (f"FAIL  {line}" for line in sweep.problems)
    return "\n".join([head, *aligned(rows(sweep)), *footnotes(sweep), *problems])


def rows(sweep: SweepResult) -> list[list[str]]:
    """The head and one row a setting."""
    names = [name for witness in sweep.witnesses for name in (witness.key, "wrong")]
    head = [sweep.quantity, "rays", "hits", "ties", "bound 64", "bound 32", *names]
    return [head, *(_row(sweep, setting) for setting in sweep.settings)]


def _row(sweep: SweepResult, setting: SettingResult) -> list[str]:
    counts = [f"{setting.x:.4g}", str(setting.rays), str(setting.exact.hits), str(setting.exact.ties)]
    bounds = [_number(setting.bound.float64), _number(setting.bound.float32)]
    scores = (setting.witnesses[witness.key] for witness in sweep.witnesses)
    return [*counts, *bounds, *(cell for score in scores for cell in _score_cells(score))]


def _score_cells(score: Score | Absent) -> list[str]:
    """Largest error, with a ! beyond its bound; wrong masks, and wrong primitives behind a +."""
    if isinstance(score, Absent):
        return [score.status, NOTHING]
    wrong = str(score.wrong_masks) + (f"+{score.wrong_primitives}" if score.wrong_primitives else "")
    return [_number(score.error) + ("!" if score.beyond else ""), wrong]


def _number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1e}" if value else "0"


def footnotes(sweep: SweepResult) -> Iterator[str]:
    """Where each witness first breaks down; why one is absent."""
    found = [f"{witness.key} {breakdown(sweep, witness.key)}" for witness in sweep.witnesses]
    yield f"breaks down at: {', '.join(found)}"
    if not sweep.misses:
        yield leaks(sweep)
    for witness in sweep.witnesses:
        if absent := sweep.absence(witness.key):
            yield f"{witness.title}: {absent.status}: {absent.why}"


def breakdown(sweep: SweepResult, key: str) -> str:
    if absent := sweep.absence(key):
        return absent.status
    return " and ".join(f"{x:.4g}" for x in sweep.breakdowns[key]) or "never"


def leaks(sweep: SweepResult) -> str:
    """Rays that leave a closed mesh, all settings together."""
    found = []
    for witness in sweep.witnesses:
        scores = [setting.witnesses[witness.key] for setting in sweep.settings]
        out = sum(score.false_misses for score in scores if isinstance(score, Score))
        absent = sweep.absence(witness.key)
        found.append(f"{witness.key} {absent.status if absent else out}")
    return f"leaks of {sum(setting.rays for setting in sweep.settings)} rays: {', '.join(found)}"
