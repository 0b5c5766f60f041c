"""What is being tried, in a file, for the case that compiled code takes this process down with it."""

import contextlib
import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from caster.image.atomic_files import check_folder, write_text
from mitsuba_ref.fuzz import cases
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, Case, exception_finding, findings_of
from mitsuba_ref.fuzz.checks import check_image, check_rays, prepared_scene
from mitsuba_ref.fuzz.families import (
    FAMILIES,
    LIMIT_STREAM,
    MITSUBA_STREAM,
    Example,
    Family,
    example,
    scene_of,
)
from mitsuba_ref.fuzz.findings import Finding, Tally, first_of_each_kind
from mitsuba_ref.fuzz.mitsuba_checks import compare_with_mitsuba
from mitsuba_ref.fuzz.shrink import SHRINK_ATTEMPTS, Budget, smallest_case
from mitsuba_ref.reference.session import ResidentSession

TRACE_FILE = "unfinished.txt"


class Trace:
    """A context: the file is there while it lasts, and stays where the process dies in it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / TRACE_FILE

    def __enter__(self) -> "Trace":
        """Raises OutputError if nothing can be written there, before any work."""
        self.made = not self.folder.exists()
        check_folder(self.folder)
        write_text(self.file, "")
        return self

    def note(self, options: str) -> None:
        """Say what is tried next."""
        with self.file.open("w", encoding="utf-8") as file:
            file.write(f"mitsuba-ref fuzz {options}\n")

    def __exit__(self, *_: object) -> None:
        self.file.unlink(missing_ok=True)
        if self.made:
            with contextlib.suppress(OSError):  # failures are kept there
                self.folder.rmdir()


def unfinished_example(folder: Path) -> str:
    """What a process was at that died here; "" if none did."""
    try:
        return (folder / TRACE_FILE).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


# Example after example until the time or the numbers are used up; what fails is made small and kept.


KEPT_PER_KIND_AND_FAMILY = (
    3  # findings of one kind in one family that are made small and kept; all are counted
)
SHRINK_GRACE_S = 5.0  # seconds that a finding may still be made smaller when the time is up
MITSUBA_SHRINK_ATTEMPTS = SHRINK_ATTEMPTS // 10  # each asks Mitsuba
MITSUBA_KINDS = ("judged", "crash")


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
    keep: int = KEPT_PER_KIND_AND_FAMILY
    judge_every: int = 16  # about one example in so many is held to Mitsuba, too; 0: none


class Campaign:
    """Runs a plan. `outcome` is whole at any moment, so that an interruption loses nothing."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.outcome = plan, Outcome(plan.seed)
        self.start = time.monotonic()
        self.deadline = float("inf") if plan.seconds is None else self.start + plan.seconds

    def run(self) -> Iterator[Outcome]:
        """Does one example after another; gives the outcome after each."""
        with ResidentSession() as resident, Trace(self.plan.folder) as trace:
            for number in self.plan.numbers:
                if time.monotonic() >= self.deadline:
                    break
                tried = example(self.plan.seed, number, self.plan.families)
                trace.note(tried.options)
                self._try(tried, resident)
                self.outcome.last, self.outcome.seconds = number, time.monotonic() - self.start
                yield self.outcome

    def _try(self, tried: Example, resident: ResidentSession) -> None:
        tally = Tally(examples=1)
        findings = look_at(tried, tally)
        if self._is_judged(tried):
            findings += mitsuba_findings(case_of(tried.data, None), resident, tally)
        findings = first_of_each_kind(findings)
        for finding in findings:
            tally.found(finding)
        self.outcome.families.setdefault(tried.family.name, Tally()).add(tally)
        for finding in findings:
            self._keep(tried, finding, resident)

    def _is_judged(self, tried: Example) -> bool:
        every = self.plan.judge_every
        return every > 0 and tried.family.fits_float32 and tried.random(MITSUBA_STREAM).random() * every < 1.0

    def _keep(self, tried: Example, finding: Finding, resident: ResidentSession) -> None:
        """Keep it as it is, then smaller: an interruption in between leaves the large one."""
        sort = [f for f in self.outcome.failures if (f.kind, f.family) == (finding.kind, tried.family.name)]
        if len(sort) >= self.plan.keep:
            return
        case = case_of(tried.data, finding.ray if finding.pixel is None else None)
        place = len(self.outcome.failures)
        self.outcome.failures.append(self._written(tried, finding, case))
        by_mitsuba = finding.kind in MITSUBA_KINDS
        judge = (lambda case: mitsuba_findings(case, resident, Tally())) if by_mitsuba else findings_of
        budget = Budget(
            MITSUBA_SHRINK_ATTEMPTS if by_mitsuba else SHRINK_ATTEMPTS, self.deadline + SHRINK_GRACE_S
        )
        small = smallest_case(case, finding, judge, budget)
        again = next((f for f in judge(small) if f.way == finding.way), finding)
        self.outcome.failures[place] = self._written(tried, again, small)

    def _written(self, tried: Example, finding: Finding, case: Case) -> Failure:
        name = f"{finding.kind}-{tried.family.name}-{tried.seed}-{tried.number}"
        file = cases.write_kept(self.plan.folder, name, finding.kind, finding.what, tried.options, case)
        return Failure(finding.kind, finding.what, tried.family.name, tried.options, str(file))


def look_at(tried: Example, tally: Tally) -> list[Finding]:
    """Its rays and its picture against the oracle. A scene outside the domain is counted as such."""
    try:
        subject = prepared_scene(scene_of(tried.data))
    except SCENE_ERRORS:
        tally.outside += 1
        return []
    except Exception as error:
        return [exception_finding(error)]
    shots = tried.shots(subject.packed)
    try:
        return [*check_rays(subject, shots, tally, tried.random(LIMIT_STREAM)), *check_image(subject, tally)]
    except Exception as error:
        return [*raising_rays(tried, shots), exception_finding(error)]


def raising_rays(tried: Example, shots: Shots) -> Iterator[Finding]:
    """Rays that raise an exception when they are cast alone, each with what it raises."""
    for i in range(len(shots.t_min)):
        ray = shots.taken(slice(i, i + 1))
        for finding in findings_of(case_of(tried.data, ray)):
            if finding.kind == "error":
                yield replace(finding, ray=ray)


def case_of(data: dict[str, Any], ray: Shots | None) -> Case:
    return Case(data["film"], data["camera"], data["shape"], ray)


def mitsuba_findings(case: Case, resident: ResidentSession, tally: Tally) -> list[Finding]:
    """What the judge finds wrong with a case."""
    try:
        scene = case.scene()
    except SCENE_ERRORS:
        return []
    try:
        return compare_with_mitsuba(scene, resident, tally)
    except Exception as error:
        return [exception_finding(error)]


def recheck(one: cases.KeptCase, resident: ResidentSession) -> list[Finding]:
    """What is wrong with a kept case today."""
    return (
        mitsuba_findings(one.case, resident, Tally()) if one.kind in MITSUBA_KINDS else findings_of(one.case)
    )
