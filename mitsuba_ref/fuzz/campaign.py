"""Campaigns: random examples until the time or their number is used up. Failing scenes are shrunk and kept."""

import contextlib
import itertools
import shlex
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.description.input_files import read_text
from caster.geometry.packing import Packed
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.fuzz.cases import Case, KeptCase, case_of, findings_of, scene_data, write_kept
from mitsuba_ref.fuzz.checks import SCENE_ERRORS, check_image, check_rays, exception_finding
from mitsuba_ref.fuzz.findings import Failure, Finding, Outcome, Tally, first_of_each_kind
from mitsuba_ref.fuzz.shrink import SHRINK_ATTEMPTS, Budget, smallest_case
from mitsuba_ref.hard import FAMILIES
from mitsuba_ref.hard.family import Family, HardScene, scene_of
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import prepared_scene
from mitsuba_ref.judge.verdict import UNDECIDED, WRONG, SceneVerdict
from mitsuba_ref.reference.mitsuba_process import ResidentSession
from mitsuba_ref.reference.shared_input import SharedRays, packed_float32
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.shapes.targets import Rng
from mitsuba_ref.subjects.ray_files import checked_rays, lay_out
from mitsuba_ref.subjects.subject import OURS, Subject

RAYS_PER_EXAMPLE = 40  # before those with limits
TRACE_FILE = "unfinished.txt"
MAX_TRACE_CHARACTERS = 500  # that are shown of it; the options of an example are some 50
KEPT_PER_KIND_AND_FAMILY = 3  # findings of one kind in one family that are shrunk and kept; all are counted
SHRINK_GRACE_S = 5.0  # seconds that a finding may still be shrunk when the time is up
MITSUBA_SHRINK_ATTEMPTS = SHRINK_ATTEMPTS // 10  # each traces the scene with Mitsuba
MITSUBA_TIMEOUT_S = 60.0  # seconds; a scene of a few dozen pixels takes a hundredth of one
MITSUBA_KINDS = ("judged", "answer", "crash")

# Random numbers of an example are independent for each of these purposes.
SCENE_STREAM, AIM_STREAM, LIMIT_STREAM, MITSUBA_STREAM = range(4)


@dataclass(frozen=True)
class Example:
    """Example number of a seed: a scene as a scene file describes it, and its rays; always the same."""

    seed: int
    number: int
    family: Family
    made: HardScene

    @property
    def data(self) -> dict[str, Any]:
        return self.made.data

    @property
    def options(self) -> str:
        """The options that reproduce it."""
        return f"--seed {self.seed} --family {self.family.name} --examples {self.number}..{self.number}"

    def random(self, stream: int) -> Rng:
        """Random numbers of the example, independent for each stream."""
        return random_numbers(self.seed, self.number, self.family, stream)

    def rays(self, packed: Packed, count: int = RAYS_PER_EXAMPLE) -> RayBatch:
        return self.made.aim(self.random(AIM_STREAM), packed, count)


def example(seed: int, number: int, families: Sequence[Family]) -> Example:
    """Families take turns, so a family that is selected alone has other examples of the same numbers."""
    family = families[number % len(families)]
    rng = random_numbers(seed, number, family, SCENE_STREAM)
    value = float(rng.choice(family.values)) if family.values else 0.0
    return Example(seed, number, family, family.make(rng, value))


def random_numbers(seed: int, number: int, family: Family, stream: int) -> Rng:
    """They stay the same when other families are added."""
    return np.random.default_rng([seed, number, zlib.crc32(family.name.encode()), stream])


class Trace:
    """The current example in a file, which is left behind if compiled code takes this process down. A context."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / TRACE_FILE

    def __enter__(self) -> "Trace":
        """Raises OutputError before any work if the folder cannot be written."""
        self.made = not self.folder.exists()
        check_folder(self.folder)
        write_text(self.file, "")
        return self

    def note(self, options: str) -> None:
        """Write the options of the next example."""
        with self.file.open("w", encoding="utf-8") as file:
            file.write(f"mitsuba-ref fuzz {options}\n")

    def __exit__(self, *_: object) -> None:
        self.file.unlink(missing_ok=True)
        if self.made:
            with contextlib.suppress(OSError):  # failures are kept there
                self.folder.rmdir()


def unfinished_example(folder: Path) -> str:
    """The command of the example that a process died in; "" if none did."""
    try:
        return read_text(folder / TRACE_FILE, "trace").strip()[:MAX_TRACE_CHARACTERS]
    except SceneError:
        return ""


@dataclass(frozen=True)
class Plan:
    """Parameters of a campaign."""

    seed: int = 0
    families: Sequence[Family] = FAMILIES
    numbers: Iterable[int] = field(default_factory=itertools.count)
    seconds: float | None = None
    folder: Path = Path("fuzz-failures")
    keep: int = KEPT_PER_KIND_AND_FAMILY
    judge_every: int = 16  # one example in so many, on average, is also compared with Mitsuba; 0: none
    rays: int = RAYS_PER_EXAMPLE
    subject: Subject = OURS  # a candidate is judged alone, by the comparison with Mitsuba and exact arithmetic
    options: tuple[str, ...] = ()  # of the command line that name the candidate, for replays


class Campaign:
    """Runs a plan. `outcome` is complete at any moment, so that an interruption loses nothing."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.outcome = plan, Outcome(plan.seed, candidate=plan.subject.name)
        self.start = time.monotonic()
        self.deadline = float("inf") if plan.seconds is None else self.start + plan.seconds

    def run(self) -> Iterator[Outcome]:
        """One example after another; yields the outcome after each."""
        with ResidentSession() as resident, Trace(self.plan.folder) as trace:
            for number in self.plan.numbers:
                if time.monotonic() >= self.deadline:
                    break
                tried = example(self.plan.seed, number, self.plan.families)
                trace.note(self._options(tried))
                self._check(tried, resident)
                self.outcome.last, self.outcome.seconds = number, time.monotonic() - self.start
                yield self.outcome

    def _check(self, tried: Example, resident: ResidentSession) -> None:
        tally = Tally(examples=1)
        if self.plan.subject is OURS:
            findings = check_example(tried, tally, self.plan.rays)
            if self._is_judged(tried):
                findings += mitsuba_findings(case_of(tried.data, None), resident, tally)
        elif tried.family.fits_float32:
            findings = candidate_findings(tried, self.plan.subject, resident, tally, self.plan.rays)
        else:
            findings = []
            tally.outside += 1
        findings = first_of_each_kind(findings)
        for finding in findings:
            tally.count_finding(finding)
        self.outcome.families.setdefault(tried.family.name, Tally()).add(tally)
        for finding in findings:
            if self.outcome.keeps(finding, tried.family.name, self.plan.keep):
                self._keep(tried, finding, resident)

    def _is_judged(self, tried: Example) -> bool:
        every = self.plan.judge_every
        drawn = tried.family.always_judged or tried.random(MITSUBA_STREAM).random() * every < 1.0
        return every > 0 and tried.family.fits_float32 and drawn

    def _keep(self, tried: Example, finding: Finding, resident: ResidentSession) -> None:
        """Keep the scene, then replace it by the shrunk one: an interruption in between leaves the large one."""
        case = case_of(tried.data, finding.ray if finding.pixel is None else None)
        index = len(self.outcome.failures)
        self.outcome.failures.append(self._write(tried, finding, case))
        judge: Callable[[Case], list[Finding]] = findings_of
        attempts = SHRINK_ATTEMPTS
        if finding.kind in MITSUBA_KINDS:
            judge = lambda case: mitsuba_findings(case, resident, Tally(), self.plan.subject)  # noqa: E731
            attempts = MITSUBA_SHRINK_ATTEMPTS
        small = smallest_case(case, finding, judge, Budget(attempts, self.deadline + SHRINK_GRACE_S))
        again = next((f for f in judge(small) if f.mode == finding.mode), finding)
        self.outcome.failures[index] = self._write(tried, again, small)

    def _options(self, tried: Example) -> str:
        rays = [] if self.plan.rays == RAYS_PER_EXAMPLE else ["--rays", str(self.plan.rays)]
        return shlex.join([*tried.options.split(), *rays, *self.plan.options])

    def _write(self, tried: Example, finding: Finding, case: Case) -> Failure:
        name = f"{finding.kind}-{tried.family.name}-{tried.seed}-{tried.number}"
        options, again = self._options(tried), self.plan.options
        file = write_kept(self.plan.folder, name, finding, options, case, again)
        return Failure(finding.kind, finding.what, tried.family.name, options, str(file), again)


def check_example(tried: Example, tally: Tally, count: int = RAYS_PER_EXAMPLE) -> list[Finding]:
    """Findings about an example's rays and image. A scene outside the oracle's domain is counted as such."""
    try:
        subject = prepared_scene(scene_of(tried.data))
    except SCENE_ERRORS:
        tally.outside += 1
        return []
    except Exception as error:
        return [exception_finding(error)]
    rays = tried.rays(subject.packed, count)
    try:
        return [*check_rays(subject, rays, tally, tried.random(LIMIT_STREAM)), *check_image(subject, tally)]
    except Exception as error:
        return [*raising_rays(tried, rays), exception_finding(error)]


def raising_rays(tried: Example, rays: RayBatch) -> Iterator[Finding]:
    """Findings of the rays that raise an exception when they are cast alone."""
    for i in range(len(rays.t_min)):
        ray = rays.taken(slice(i, i + 1))
        for finding in findings_of(case_of(tried.data, ray)):
            if finding.kind == "error":
                yield replace(finding, ray=ray)


def candidate_findings(
    tried: Example, subject: Subject, resident: ResidentSession, tally: Tally, count: int = RAYS_PER_EXAMPLE
) -> list[Finding]:
    """Findings of the judge about a candidate's image and, if it takes rays, its hits along the example's rays."""
    findings = mitsuba_findings(case_of(tried.data, None), resident, tally, subject)
    if not subject.takes_rays:
        return findings
    try:
        scene = scene_of(tried.data)
        rays = tried.rays(packed_float32(scene), count)
        rows = np.column_stack([rays.o, rays.d, np.zeros_like(rays.t_min), np.full_like(rays.t_max, np.inf)])
        with np.errstate(over="ignore"):
            laid_out, shared = lay_out(scene, checked_rays(rows.astype(np.float32), "rays"))
    except SCENE_ERRORS:
        tally.outside += 1
        return findings
    for finding in compare_with_mitsuba(laid_out, resident, tally, subject, shared):
        ray = None
        if finding.pixel is not None:
            row = finding.pixel[1] * laid_out.film.width + finding.pixel[0]
            ray = RayBatch(shared.o[row : row + 1], shared.d[row : row + 1], np.zeros(1), np.full(1, np.inf))
        findings.append(replace(finding, ray=ray, pixel=None))
    return findings


def mitsuba_findings(case: Case, resident: ResidentSession, tally: Tally, subject: Subject = OURS) -> list[Finding]:
    """Findings of the judge about a case."""
    try:
        scene = scene_of(scene_data(case))
    except SCENE_ERRORS:
        return []
    try:
        return compare_with_mitsuba(scene, resident, tally, subject)
    except Exception as error:
        return [exception_finding(error)]


def recheck(one: KeptCase, resident: ResidentSession, subject: Subject = OURS) -> list[Finding]:
    """Findings about a kept case today."""
    if one.kind in MITSUBA_KINDS or subject is not OURS:
        return mitsuba_findings(one.case, resident, Tally(), subject)
    return findings_of(one.case)


def compare_with_mitsuba(
    scene: Scene, resident: ResidentSession, tally: Tally, subject: Subject = OURS, rays: SharedRays | None = None
) -> list[Finding]:
    """Findings of the judge about a scene. Vacuous scenes pass: images of a few pixels may hit nothing.

    rays: of a list, laid out as the film. Of a candidate, only what it has wrong is a finding.
    """
    options: dict[str, Any] = {"timeout": MITSUBA_TIMEOUT_S, "send": resident.send}
    try:
        verdict = validate_scene(scene, "fuzz", subject=subject, rays=rays, **options)
    except SceneError:  # numbers beyond float32
        tally.outside += 1
        return []
    if verdict.unsupported:
        tally.declined += 1
        return []
    tally.judged += 1
    tally.pixels += verdict.pixels
    if verdict.problem:
        return [Finding("crash" if subject is OURS else "answer", verdict.problem)]
    if subject is not OURS and not (verdict.counts[WRONG] or verdict.counts[UNDECIDED]):
        return []
    if verdict.failing or not verdict.checks_pass:
        return [_finding_of(verdict)]
    return []


def _finding_of(verdict: SceneVerdict) -> Finding:
    subject = "the candidate" if verdict.candidate else "ours"
    for check in verdict.checks:
        if not check.ok:
            what = f"{check.name}: {check.ratio:.3g} times its bound; {check.what}"
            return Finding("judged", what, detail=check.name)
    first = verdict.failures[0]
    sides = f"{subject} {first.subject}; Mitsuba {first.reference}; exactly {first.exact}; {first.reason}"
    what = f"{first.verdict}: {first.check} {first.ratio:.3g} times its bound; {sides}"
    return Finding("judged", what, pixel=(first.x, first.y), detail=first.verdict)
