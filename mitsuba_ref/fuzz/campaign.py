"""Example after example until the time or the numbers are used up; what fails is made small and kept."""

import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mitsuba_ref.fuzz import kept
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.case import NO_SCENE, Case, findings_of, raised
from mitsuba_ref.fuzz.example import CHOOSING, LIMITING, Example, example, scene_of
from mitsuba_ref.fuzz.families import FAMILIES, Family
from mitsuba_ref.fuzz.finding import Finding, Tally, first_of_each_kind
from mitsuba_ref.fuzz.judged import judge_scene
from mitsuba_ref.fuzz.picture_check import check_picture
from mitsuba_ref.fuzz.rays_check import check_rays, subject_of
from mitsuba_ref.fuzz.resident import Resident
from mitsuba_ref.fuzz.shrink import ATTEMPTS, Budget
from mitsuba_ref.fuzz.smaller import smallest
from mitsuba_ref.fuzz.trace import Trace

KEPT_OF_A_SORT = 3  # findings of one kind in one family that are made small and kept; all are counted
GRACE = 5.0  # seconds that a finding may still be made smaller when the time is up
JUDGED_ATTEMPTS = ATTEMPTS // 10  # each asks Mitsuba
BY_MITSUBA = ("judged", "crash")


@dataclass(frozen=True)
class Failure:
    """A finding that was kept."""

    kind: str
    what: str  # of the smallest case
    family: str
    example: str  # the options that make the scene it was shrunk from
    file: str


@dataclass
class Outcome:
    """What has been done so far."""

    seed: int
    families: dict[str, Tally] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    last: int = -1  # number of the last example that was finished
    seconds: float = 0.0

    @property
    def total(self) -> Tally:
        total = Tally()
        for tally in self.families.values():
            total.add(tally)
        return total

    @property
    def ok(self) -> bool:
        return self.total.findings == 0


@dataclass(frozen=True)
class Plan:
    """What is to be done."""

    seed: int = 0
    families: Sequence[Family] = FAMILIES
    numbers: Iterable[int] = field(default_factory=itertools.count)
    seconds: float | None = None
    folder: Path = Path("fuzz-failures")
    keep: int = KEPT_OF_A_SORT
    judge_every: int = 16  # about one example in so many is held to Mitsuba, too; 0: none


class Campaign:
    """Runs a plan. `outcome` is whole at any moment, so that an interruption loses nothing."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.outcome = plan, Outcome(plan.seed)
        self.start = time.monotonic()
        self.deadline = float("inf") if plan.seconds is None else self.start + plan.seconds

    def run(self) -> Iterator[Outcome]:
        """Does one example after another; gives the outcome after each."""
        with Resident() as resident, Trace(self.plan.folder) as trace:
            for number in self.plan.numbers:
                if time.monotonic() >= self.deadline:
                    break
                tried = example(self.plan.seed, number, self.plan.families)
                trace.note(tried.options)
                self._try(tried, resident)
                self.outcome.last, self.outcome.seconds = number, time.monotonic() - self.start
                yield self.outcome

    def _try(self, tried: Example, resident: Resident) -> None:
        tally = Tally(examples=1)
        findings = look_at(tried, tally)
        if self._is_judged(tried):
            findings += judged(case_of(tried.data, None), resident, tally)
        findings = first_of_each_kind(findings)
        for finding in findings:
            tally.found(finding)
        self.outcome.families.setdefault(tried.family.name, Tally()).add(tally)
        for finding in findings:
            self._keep(tried, finding, resident)

    def _is_judged(self, tried: Example) -> bool:
        every = self.plan.judge_every
        return every > 0 and tried.family.fits_float32 and tried.random(CHOOSING).random() * every < 1.0

    def _keep(self, tried: Example, finding: Finding, resident: Resident) -> None:
        """Keep it as it is, then smaller: an interruption in between leaves the large one."""
        sort = [f for f in self.outcome.failures if (f.kind, f.family) == (finding.kind, tried.family.name)]
        if len(sort) >= self.plan.keep:
            return
        case = case_of(tried.data, finding.ray if finding.pixel is None else None)
        place = len(self.outcome.failures)
        self.outcome.failures.append(self._written(tried, finding, case))
        by_mitsuba = finding.kind in BY_MITSUBA
        judge = (lambda case: judged(case, resident, Tally())) if by_mitsuba else findings_of
        budget = Budget(JUDGED_ATTEMPTS if by_mitsuba else ATTEMPTS, self.deadline + GRACE)
        small = smallest(case, finding, judge, budget)
        again = next((f for f in judge(small) if f.way == finding.way), finding)
        self.outcome.failures[place] = self._written(tried, again, small)

    def _written(self, tried: Example, finding: Finding, case: Case) -> Failure:
        name = f"{finding.kind}-{tried.family.name}-{tried.seed}-{tried.number}"
        file = kept.write(self.plan.folder, name, finding.kind, finding.what, tried.options, case)
        return Failure(finding.kind, finding.what, tried.family.name, tried.options, str(file))


def look_at(tried: Example, tally: Tally) -> list[Finding]:
    """Its rays and its picture against the oracle. A scene outside the domain is counted as such."""
    try:
        subject = subject_of(scene_of(tried.data))
    except NO_SCENE:
        tally.outside += 1
        return []
    except Exception as error:
        return [raised(error)]
    shots = tried.shots(subject.packed)
    try:
        return [*check_rays(subject, shots, tally, tried.random(LIMITING)), *check_picture(subject, tally)]
    except Exception as error:
        return [*errors_of_rays(tried, shots), raised(error)]


def errors_of_rays(tried: Example, shots: Shots) -> Iterator[Finding]:
    """Rays that raise an exception when they are cast alone, each with what it raises."""
    for i in range(len(shots.t_min)):
        ray = shots.taken(slice(i, i + 1))
        for finding in findings_of(case_of(tried.data, ray)):
            if finding.kind == "error":
                yield replace(finding, ray=ray)


def case_of(data: dict[str, Any], ray: Shots | None) -> Case:
    return Case(data["film"], data["camera"], data["shape"], ray)


def judged(case: Case, resident: Resident, tally: Tally) -> list[Finding]:
    """What the judge finds wrong with a case."""
    try:
        scene = case.scene()
    except NO_SCENE:
        return []
    try:
        return judge_scene(scene, resident, tally)
    except Exception as error:
        return [raised(error)]


def recheck(one: kept.Kept, resident: Resident) -> list[Finding]:
    """What is wrong with a kept case today."""
    return judged(one.case, resident, Tally()) if one.kind in BY_MITSUBA else findings_of(one.case)
