"""Campaigns: random examples until the time or their number is used up. Failing scenes are shrunk and kept."""

import itertools
import shlex
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.fuzz.cases import case_of, write_kept
from mitsuba_ref.fuzz.checks import SCENE_ERRORS, check_image, check_rays, compare_with_mitsuba, exception_finding, find
from mitsuba_ref.fuzz.findings import JUDGED_KINDS, Failure, Finding, Outcome, Tally, first_of_each_kind
from mitsuba_ref.fuzz.shrink import SHRINK_ATTEMPTS, Shrinker
from mitsuba_ref.hard import FAMILIES
from mitsuba_ref.hard.family import Family, HardScene
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import prepared_scene
from mitsuba_ref.reference.shared_input import packed_float32
from mitsuba_ref.shapes.targets import Rng
from mitsuba_ref.subjects.ray_files import checked_rays, lay_out
from mitsuba_ref.subjects.subject import OURS, Subject

RAYS_PER_EXAMPLE = 40  # before those with limits
KEPT_PER_KIND_AND_FAMILY = 3  # findings of one kind in one family that are shrunk and kept; all are counted
SHRINK_GRACE_S = 5.0  # seconds that a finding may still be shrunk when the time is up
MITSUBA_SHRINK_ATTEMPTS = SHRINK_ATTEMPTS // 10  # each traces the scene with Mitsuba

# Random numbers of an example are independent for each of these purposes.
SCENE_STREAM, AIM_STREAM, LIMIT_STREAM, MITSUBA_STREAM = range(4)


@dataclass(frozen=True)
class Example:
    """Example `number` of a seed: a scene as a scene file describes it, and its rays; always the same."""

    seed: int
    number: int
    family: Family
    made: HardScene

    @property
    def options(self) -> list[str]:
        """The options that reproduce it."""
        return f"--seed {self.seed} --family {self.family.name} --examples {self.number}..{self.number}".split()

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


@dataclass(frozen=True)
class Plan:
    """Parameters of a campaign."""

    seed: int = 0
    families: Sequence[Family] = FAMILIES
    numbers: Iterable[int] = field(default_factory=itertools.count)
    seconds: float | None = None
    folder: Path = Path("fuzz-failures")
    keep: int = KEPT_PER_KIND_AND_FAMILY
    judge_every: int = 16  # one in so many, on average, gets the thorough checks and Mitsuba's comparison; 0: none
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
        for number in self.plan.numbers:
            if time.monotonic() >= self.deadline:
                break
            self._check(example(self.plan.seed, number, self.plan.families))
            self.outcome.last, self.outcome.seconds = number, time.monotonic() - self.start
            yield self.outcome

    def _check(self, tried: Example) -> None:
        tally, family = Tally(examples=1), tried.family.name
        findings = first_of_each_kind(self._findings(tried, tally))
        tally.findings = len(findings)
        tally.kinds.update(finding.kind for finding in findings)
        self.outcome.families.setdefault(family, Tally()).add(tally)
        for finding in findings:
            kept = sum((each.kind, each.family) == (finding.kind, family) for each in self.outcome.failures)
            if kept < self.plan.keep:
                self._keep(tried, finding)

    def _findings(self, tried: Example, tally: Tally) -> list[Finding]:
        if self.plan.subject is not OURS:
            return candidate_findings(tried, self.plan.subject, tally, self.plan.rays)
        every = self.plan.judge_every
        drawn = every > 0 and (tried.family.always_judged or tried.random(MITSUBA_STREAM).random() * every < 1.0)
        findings = check_example(tried, tally, self.plan.rays, thorough=drawn)
        judged = drawn and tried.family.fits_float32
        return findings + (find(case_of(tried.made.data), "judged", tally) if judged else [])

    def _keep(self, tried: Example, finding: Finding) -> None:
        """Shrink the scene and write it; an interruption leaves the smallest so far."""
        attempts = MITSUBA_SHRINK_ATTEMPTS if finding.kind in JUDGED_KINDS else SHRINK_ATTEMPTS
        shrinker = Shrinker(
            case_of(tried.made.data),
            finding,
            lambda case: find(case, finding.kind, subject=self.plan.subject),
            attempts,
            self.deadline + SHRINK_GRACE_S,
        )
        try:
            shrinker.run()
        finally:
            self.outcome.failures.append(self._write(tried, shrinker))

    def _write(self, tried: Example, shrunk: Shrinker) -> Failure:
        finding, family, again = shrunk.finding, tried.family.name, self.plan.options
        rays = [] if self.plan.rays == RAYS_PER_EXAMPLE else ["--rays", str(self.plan.rays)]
        options = shlex.join([*tried.options, *rays, *again])
        name = f"{finding.kind}-{family}-{tried.seed}-{tried.number}"
        file = write_kept(self.plan.folder, name, finding, options, shrunk.case, again)
        return Failure(finding.kind, finding.what, family, options, str(file), again)


def check_example(tried: Example, tally: Tally, count: int = RAYS_PER_EXAMPLE, thorough: bool = False) -> list[Finding]:
    """Findings about an example's rays and image. A scene outside the oracle's domain is counted as such."""
    try:
        prepared = prepared_scene(tried.made.scene())
    except SCENE_ERRORS:
        tally.outside += 1
        return []
    except Exception as error:
        return [exception_finding(error)]
    rays = tried.rays(prepared.packed, count)
    try:
        of_rays = check_rays(prepared, rays, tally, tried.random(LIMIT_STREAM))
        return [*of_rays, *check_image(prepared, tally, thorough)]
    except Exception as error:
        return [*raising_rays(tried, rays), exception_finding(error)]


def raising_rays(tried: Example, rays: RayBatch) -> Iterator[Finding]:
    """Findings of the rays that raise an exception when they are cast alone."""
    for i in range(len(rays.t_min)):
        ray = rays.taken(slice(i, i + 1))
        yield from (replace(each, ray=ray) for each in find(case_of(tried.made.data, ray)) if each.kind == "error")


def candidate_findings(tried: Example, subject: Subject, tally: Tally, count: int = RAYS_PER_EXAMPLE) -> list[Finding]:
    """Findings of the judge about a candidate's image and, if it takes rays, its hits along the example's rays."""
    if not tried.family.fits_float32:
        tally.outside += 1
        return []
    findings = find(case_of(tried.made.data), "judged", tally, subject)
    if not subject.takes_rays:
        return findings
    try:
        scene = tried.made.scene()
        rays = tried.rays(packed_float32(scene), count)
        rows = np.column_stack([rays.o, rays.d, np.zeros_like(rays.t_min), np.full_like(rays.t_max, np.inf)])
        with np.errstate(over="ignore"):
            laid_out, shared = lay_out(scene, checked_rays(rows.astype(np.float32), "rays"))
    except SCENE_ERRORS:
        tally.outside += 1
        return findings
    return findings + compare_with_mitsuba(laid_out, tally, subject, shared)
