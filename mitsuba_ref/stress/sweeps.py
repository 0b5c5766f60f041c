"""Stress sweeps: each family traced by several ray casters, and the scores, shown as tables, JSON and pages."""

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.system.terminal import folded
from mitsuba_ref.hard.family import Family
from mitsuba_ref.report.results import NOTHING, aligned
from mitsuba_ref.stress import score
from mitsuba_ref.stress.origins import OriginSweep
from mitsuba_ref.stress.score import (
    BESIDE_CANDIDATE,
    CANDIDATE,
    CASTERS,
    REFERENCES,
    Absent,
    Bound,
    Caster,
    PreparedSetting,
    Score,
    Scorer,
)
from mitsuba_ref.subjects.subject import Answer, Subject

JSON_FORMAT = 3  # goes up when a key changes its meaning or goes away

Answers = Mapping[str, Answer | Absent]  # by caster


@dataclass(frozen=True)
class ExactCounts:
    """Rays of a setting by their exact answers."""

    adjudicated: int  # rays decided by exact arithmetic; a closed mesh needs only a sample
    hits: int
    misses: int
    ties: int  # rays that hit several primitives at exactly the same t


@dataclass(frozen=True)
class SettingResult:
    """Scores of all casters in one setting."""

    x: float
    rays: int
    exact: ExactCounts
    bound: Bound
    witnesses: Mapping[str, Score | Absent]  # by caster
    replay: str = ""  # the command that shows the first wrong ray of the subject


@dataclass(frozen=True)
class SweepResult:
    """The results of one family."""

    name: str
    title: str
    quantity: str
    error: str
    easiest: float
    misses: bool  # whether exact misses are expected; not from inside a closed mesh
    settings: tuple[SettingResult, ...]
    seconds: float = 0.0
    declined: str = ""  # the candidate's own words, where it declined every setting
    ended: str = ""  # how the process that traced the family ended, where it did

    @property
    def casters(self) -> tuple[Caster, ...]:
        with_candidate = any(CANDIDATE.key in setting.witnesses for setting in self.settings)
        return BESIDE_CANDIDATE if with_candidate else CASTERS

    @classmethod
    def of(
        cls,
        family: Family,
        settings: Sequence[SettingResult],
        seconds: float = 0.0,
        declined: str = "",
        ended: str = "",
    ) -> "SweepResult":
        words = (family.name, family.title, family.quantity, family.error)
        return cls(*words, family.easiest, not family.closed, tuple(settings), round(seconds, 3), declined, ended)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return bool(self.settings) and not self.problems

    @computed_field  # type: ignore[prop-decorator]
    @property
    def problems(self) -> list[str]:
        """Why the sweep fails, in lines."""
        if self.ended:
            return [f"{self.name}: the process that casts and judges ended: {self.ended}"]
        if self.declined:
            return [f"{self.name}: the candidate declined every setting: {self.declined}"]
        return [
            f"{self.name}, {self.quantity} {setting.x:g}: {problem}"
            for setting in self.settings
            for problem in self._problems_in(setting)
        ]

    def _problems_in(self, setting: SettingResult) -> Iterator[str]:
        """A setting without hits or misses, and errors of the subject: the candidate, or ours without one."""
        counts = {"hits": setting.exact.hits} | ({"misses": setting.exact.misses} if self.misses else {})
        for name in (name for name, count in counts.items() if not count):
            yield (
                f"exact arithmetic has no {name} of {setting.rays} rays, so the setting tests nothing; "
                "more --rays may help"
            )
        key = self.casters[0].key
        score = setting.witnesses[key]
        if isinstance(score, Absent):
            if score.status == "crash":
                yield f"{key}: no answer: {score.why}"
        elif score.breaks:
            yield (
                f"{key}:\n      {score.false_hits} false hits, {score.false_misses} false misses, "
                f"{score.beyond} hits beyond their bounds\n"
                f"      rays {list(score.first_wrong)}\n      {score.example}\n"
                f"      replay: {setting.replay}"
            )

    @computed_field  # type: ignore[prop-decorator]
    @property
    def breakdowns(self) -> dict[str, list[float]]:
        """By caster, the first x at which it breaks down, on either side of where the family is easiest."""
        found = {}
        for caster in self.casters:
            broken = [setting.x for setting in self.settings if setting.witnesses[caster.key].breaks]
            below, above = ([x for x in broken if (x < self.easiest) == side] for side in (True, False))
            found[caster.key] = [*below[-1:], *above[:1]]
        return found

    def absence(self, key: str) -> Absent | None:
        """Why a caster has no score in any setting; None if it has one."""
        scores = [setting.witnesses[key] for setting in self.settings]
        absent = [score for score in scores if isinstance(score, Absent)]
        return absent[0] if absent and len(absent) == len(scores) else None


@dataclass(frozen=True)
class StressRun:
    """A run of `mitsuba-ref stress`. requested: the selected families; an interrupted run has results of some only."""

    seed: int
    versions: Mapping[str, str]
    requested: tuple[str, ...]
    families: tuple[SweepResult | OriginSweep, ...]
    skip_unsupported: bool = False  # families that the candidate declined do not fail the run, others being judged
    format: int = JSON_FORMAT

    @property
    def judged(self) -> list[SweepResult | OriginSweep]:
        return [sweep for sweep in self.families if not (self.skip_unsupported and sweep.declined)]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        finished = len(self.families) == len(self.requested)
        return bool(self.judged) and finished and all(sweep.ok for sweep in self.judged)


def sweep(
    family: Family,
    seed: int,
    rays: int | None,
    candidate: Subject | None = None,
    folder: Path = Path("stress-failures"),
    words: Sequence[str] = (),
) -> SweepResult:
    """Sweep a family. The same seed and number of rays give the same result, except for the time.

    candidate: one that takes rays, judged in place of our caster. folder: for the first wrong ray of each setting;
    words: options that name the candidate, for replays.
    """
    start = time.perf_counter()
    settings = [score.prepare_setting(family, seed, x, rays) for x in family.values]
    casters: Sequence[Caster] = CASTERS
    answers: list[Answers] = [{} for _ in settings]
    if candidate:
        casters = BESIDE_CANDIDATE[1:]
        answers = [{CANDIDATE.key: score.ask_candidate(candidate, ready)} for ready in settings]
        asked = [each[CANDIDATE.key] for each in answers]
        declined = [each.why for each in asked if isinstance(each, Absent) and each.status == "not applicable"]
        if len(declined) == len(settings):
            return SweepResult.of(family, (), time.perf_counter() - start, declined[0])
    results = []
    for ready, given in zip(settings, answers, strict=True):
        results.append(found := score_setting(ready, casters, given))
        subject = found.witnesses[CANDIDATE.key if candidate else CASTERS[0].key]
        if isinstance(subject, Score) and subject.breaks:
            file = ready.write_ray(folder, subject.first_wrong[0])
            replay = shlex.join(["mitsuba-ref", "probe", str(file), "0", "0", *words])
            results[-1] = replace(found, replay=replay)
    return SweepResult.of(family, results, time.perf_counter() - start)


def score_setting(ready: PreparedSetting, casters: Sequence[Caster], given: Answers | None = None) -> SettingResult:
    """Trace a setting by ours and Mitsuba's configurations and score their answers, after the given ones."""
    answers: dict[str, Answer | Absent] = dict(given or {})
    for each in casters:
        answers[each.key] = score.trace_by_reference(each, ready) if each.variant else score.cast_by_bvh(ready)
    missed = [~found.hit for found in answers.values() if not isinstance(found, Absent)]
    scorer = Scorer(ready, np.any(missed, axis=0))
    traced = {each.key for each in REFERENCES}
    scores = {
        key: found if isinstance(found, Absent) else scorer.score(found, reference=key in traced)
        for key, found in answers.items()
    }
    hits, count = int(scorer.hit.sum()), len(ready.o)
    ties = sum(len(answer.prims) > 1 for answer in scorer.exact.answers)
    counts = ExactCounts(len(scorer.rows), hits, count - hits, ties)
    return SettingResult(ready.x, count, counts, scorer.bound, scores)


# ---- a sweep as a table: its cells, and the text for a terminal


def as_text(sweep: SweepResult, skip_unsupported: bool = False) -> str:
    """The table of a sweep with breakdowns and failures; one line if everything was declined."""
    if sweep.declined:
        mark, why = "SKIP" if skip_unsupported else "FAIL", sweep.declined.partition("\n")[0]
        return folded(f"{mark}  {sweep.name}: {sweep.title}; the candidate declined every setting: {why}")
    mark = "PASS" if sweep.ok else "FAIL"
    head = f"{mark}  {sweep.name}: {sweep.title}   {sweep.seconds:.1f} s"
    about = f"x: {sweep.quantity}\nof each caster: {sweep.error}, !: beyond its bound; wrong hits and misses"
    (_, *names), *settings = rows(sweep)
    problems = (f"FAIL  {line}" for line in sweep.problems)
    return folded("\n".join([head, about, *aligned([["x", *names], *settings], step=2), *footnotes(sweep), *problems]))


def rows(sweep: SweepResult) -> list[list[str]]:
    """The head and one row a setting."""
    names = [name for caster in sweep.casters for name in (caster.key, "wrong")]
    found = [[sweep.quantity, "rays", "hits", "ties", "bound 64", "bound 32", *names]]
    for setting in sweep.settings:
        counts = [f"{setting.x:.4g}", str(setting.rays), str(setting.exact.hits), str(setting.exact.ties)]
        bounds = [_number(setting.bound.float64), _number(setting.bound.float32)]
        scores = (setting.witnesses[caster.key] for caster in sweep.casters)
        found.append([*counts, *bounds, *(cell for score in scores for cell in _score_cells(score))])
    return found


def _score_cells(score: Score | Absent) -> list[str]:
    """Largest error, with a ! where one is beyond its bound, and the number of wrong hits and misses."""
    if isinstance(score, Absent):
        return [score.status, NOTHING]
    return [_number(score.error) + ("!" if score.beyond else ""), str(score.wrong_masks)]


def _number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1e}" if value else "0"


def footnotes(sweep: SweepResult) -> Iterator[str]:
    """Where each caster first breaks down; why one is absent."""
    yield f"breaks down at: {', '.join(f'{each.key} {breakdown(sweep, each.key)}' for each in sweep.casters)}"
    if not sweep.misses:
        yield leaks(sweep)
    for caster in sweep.casters:
        if (absent := sweep.absence(caster.key)) and absent.status != "missing":
            yield f"{caster.title}: {absent.status}: {absent.why}"


def breakdown(sweep: SweepResult, key: str) -> str:
    if absent := sweep.absence(key):
        return absent.status
    return " and ".join(f"{x:.4g}" for x in sweep.breakdowns[key]) or "never"


def leaks(sweep: SweepResult) -> str:
    """Rays that leave a closed mesh, all settings together."""
    found = []
    for caster in sweep.casters:
        scores = [setting.witnesses[caster.key] for setting in sweep.settings]
        out = sum(score.false_misses for score in scores if isinstance(score, Score))
        absent = sweep.absence(caster.key)
        found.append(f"{caster.key} {absent.status if absent else out}")
    return f"leaks of {sum(setting.rays for setting in sweep.settings)} rays: {', '.join(found)}"
