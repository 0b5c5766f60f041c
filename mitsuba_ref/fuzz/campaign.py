"""Campaigns: random examples until the time or their number is used up, and the long run of millions of rays.

Failing scenes are shrunk and kept.
"""

import contextlib
import itertools
import shlex
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.description.input_files import read_own
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.fuzz import cases
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, Case, exception_finding, findings_of, write_kept
from mitsuba_ref.fuzz.checks import adjudicate, check_image, check_rays
from mitsuba_ref.fuzz.families import (
    FAMILIES,
    LIMIT_STREAM,
    MITSUBA_STREAM,
    Example,
    Family,
    example,
    nearly_equal_spheres,
    scene_of,
    seed_of_name,
)
from mitsuba_ref.fuzz.findings import Failure, Finding, Outcome, Tally, first_of_each_kind
from mitsuba_ref.fuzz.settings import Fields, random_camera, random_setting, random_shape
from mitsuba_ref.fuzz.shrink import SHRINK_ATTEMPTS, Budget, smallest_case
from mitsuba_ref.judge.checks.adversarial_rays import RayBatch, Setting, Targets, aimed_rays
from mitsuba_ref.judge.checks.knife_edges import cast_by_culling, concatenated, prepared_scene, with_limits
from mitsuba_ref.judge.verdict import UNDECIDED, WRONG, SceneVerdict
from mitsuba_ref.reference.mitsuba_process import ResidentSession
from mitsuba_ref.reference.shared_input import SharedRays, packed_float32
from mitsuba_ref.report.results import aligned
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.shapes.targets import Rng
from mitsuba_ref.subjects.ray_files import checked_rays, lay_out
from mitsuba_ref.subjects.subject import OURS, Subject

TRACE_FILE = "unfinished.txt"
MAX_TRACE_CHARACTERS = 500  # that are shown of it; the options of an example are some 50
KEPT_PER_KIND_AND_FAMILY = 3  # findings of one kind in one family that are shrunk and kept; all are counted
SHRINK_GRACE_S = 5.0  # seconds that a finding may still be shrunk when the time is up
MITSUBA_SHRINK_ATTEMPTS = SHRINK_ATTEMPTS // 10  # each traces the scene with Mitsuba
MITSUBA_TIMEOUT_S = 60.0  # seconds; a scene of a few dozen pixels takes a hundredth of one
MITSUBA_KINDS = ("judged", "answer", "crash")


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
        return read_own(folder / TRACE_FILE, "trace").strip()[:MAX_TRACE_CHARACTERS]
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
                trace.note(tried.options)
                self._check(tried, resident)
                self.outcome.last, self.outcome.seconds = number, time.monotonic() - self.start
                yield self.outcome

    def _check(self, tried: Example, resident: ResidentSession) -> None:
        tally = Tally(examples=1)
        if self.plan.subject is OURS:
            findings = check_example(tried, tally)
            if self._is_judged(tried):
                findings += mitsuba_findings(case_of(tried.data, None), resident, tally)
        elif tried.family.fits_float32:
            findings = candidate_findings(tried, self.plan.subject, resident, tally)
        else:
            findings = []
            tally.outside += 1
        findings = first_of_each_kind(findings)
        for finding in findings:
            tally.count_finding(finding)
        self.outcome.families.setdefault(tried.family.name, Tally()).add(tally)
        for finding in findings:
            self._keep(tried, finding, resident)

    def _is_judged(self, tried: Example) -> bool:
        every = self.plan.judge_every
        drawn = tried.family.always_judged or tried.random(MITSUBA_STREAM).random() * every < 1.0
        return every > 0 and tried.family.fits_float32 and drawn

    def _keep(self, tried: Example, finding: Finding, resident: ResidentSession) -> None:
        """Keep the scene, then replace it by the shrunk one: an interruption in between leaves the large one."""
        if not self.outcome.keeps(finding, tried.family.name, self.plan.keep):
            return
        case = case_of(tried.data, finding.ray if finding.pixel is None else None)
        index = len(self.outcome.failures)
        self.outcome.failures.append(self._write(tried, finding, case))
        by_mitsuba = finding.kind in MITSUBA_KINDS
        subject = self.plan.subject
        judge = (lambda case: mitsuba_findings(case, resident, Tally(), subject)) if by_mitsuba else findings_of
        budget = Budget(MITSUBA_SHRINK_ATTEMPTS if by_mitsuba else SHRINK_ATTEMPTS, self.deadline + SHRINK_GRACE_S)
        small = smallest_case(case, finding, judge, budget)
        again = next((f for f in judge(small) if f.mode == finding.mode), finding)
        self.outcome.failures[index] = self._write(tried, again, small)

    def _write(self, tried: Example, finding: Finding, case: Case) -> Failure:
        name = f"{finding.kind}-{tried.family.name}-{tried.seed}-{tried.number}"
        again = self.plan.options
        options = shlex.join([*tried.options.split(), *again])
        file = cases.write_kept(self.plan.folder, name, finding.kind, finding.what, options, case, again)
        return Failure(finding.kind, finding.what, tried.family.name, options, str(file), self.plan.options)


def check_example(tried: Example, tally: Tally) -> list[Finding]:
    """Findings about an example's rays and image. A scene outside the oracle's domain is counted as such."""
    try:
        subject = prepared_scene(scene_of(tried.data))
    except SCENE_ERRORS:
        tally.outside += 1
        return []
    except Exception as error:
        return [exception_finding(error)]
    rays = tried.rays(subject.packed)
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


def case_of(data: dict[str, Any], ray: RayBatch | None) -> Case:
    return Case.of(data)._replace(ray=ray)


def candidate_findings(tried: Example, subject: Subject, resident: ResidentSession, tally: Tally) -> list[Finding]:
    """Findings of the judge about a candidate's image and, if it takes rays, its hits along the example's rays."""
    image = case_of(tried.data, None)
    findings = mitsuba_findings(image, resident, tally, subject)
    if not subject.takes_rays:
        return findings
    try:
        scene = scene_of(tried.data)
        rays = tried.rays(packed_float32(scene))
        rows = np.column_stack([rays.o, rays.d, np.zeros_like(rays.t_min), np.full_like(rays.t_max, np.inf)])
        with np.errstate(over="ignore"):
            laid_out, shared = lay_out(scene, checked_rays(rows.astype(np.float32), "rays"), "rays")
    except SCENE_ERRORS:
        tally.outside += 1
        return findings
    found = compare_with_mitsuba(laid_out, resident, tally, subject, shared)
    for finding in found:
        ray = None
        if finding.pixel is not None:
            row = finding.pixel[1] * laid_out.film.width + finding.pixel[0]
            ray = RayBatch(shared.o[row : row + 1], shared.d[row : row + 1], np.zeros(1), np.full(1, np.inf))
        findings.append(replace(finding, ray=ray, pixel=None))
    return findings


def mitsuba_findings(case: Case, resident: ResidentSession, tally: Tally, subject: Subject = OURS) -> list[Finding]:
    """Findings of the judge about a case."""
    try:
        scene = case.scene()
    except SCENE_ERRORS:
        return []
    try:
        return compare_with_mitsuba(scene, resident, tally, subject)
    except Exception as error:
        return [exception_finding(error)]


def recheck(one: cases.KeptCase, resident: ResidentSession, subject: Subject = OURS) -> list[Finding]:
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
    options: dict[str, Any] = {"timeout": MITSUBA_TIMEOUT_S, "send": resident.send, "thorough": True}
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


# A shape none of whose random scenes can be judged would keep the long run for ever; of a hundred a few are outside.
MAX_SCENES_OUTSIDE = 1000

# ---- the long run: millions of rays per shape type, in scenes of a few shapes of that type ----

RAYS_PER_SCENE = 2048
LIMITED_RAYS_PER_SCENE = RAYS_PER_SCENE // 8  # cast again with other limits
MAX_SHAPES_PER_SCENE = 3
COLUMNS = ("shape", "rays", "hits", "edges", "ties", "worst t", "wrong", "rays/s")


class LongRun:
    """A number of rays per shape type; the outcome is complete at any moment."""

    def __init__(
        self, seed: int, rays: int, shapes: Sequence[str], folder: Path, keep: int = KEPT_PER_KIND_AND_FAMILY
    ) -> None:
        self.rays, self.folder, self.keep = rays, folder, keep
        self.outcome = Outcome(seed, {shape: Tally() for shape in shapes})
        self.seconds = dict.fromkeys(shapes, 0.0)

    @property
    def ok(self) -> bool:
        """Whether every shape type has had its rays, without a finding."""
        done = all(tally.rays >= self.rays for tally in self.outcome.families.values())
        return done and self.outcome.ok

    def run(self) -> Iterator[str]:
        """One scene after another; a line of progress after each."""
        for shape, tally in self.outcome.families.items():
            number = 0
            while tally.rays < self.rays and tally.outside <= tally.examples + MAX_SCENES_OUTSIDE:
                start = time.monotonic()
                self._check_scene(shape, number, tally)
                self.seconds[shape] += time.monotonic() - start
                number += 1
                yield f"{shape}: {tally.rays} of {self.rays} rays, {tally.findings} wrong"

    def _check_scene(self, shape: str, number: int, tally: Tally) -> None:
        rng = np.random.default_rng([self.outcome.seed, number, seed_of_name(shape)])
        setting, shapes = random_scene_of(rng, shape)
        film, camera = random_camera(rng, setting)
        data = {"film": film, "camera": camera, "shape": shapes}
        try:
            scene = prepared_scene(scene_of(data))
        except SCENE_ERRORS:
            tally.outside += 1
            return
        tally.examples += 1
        wanted = min(RAYS_PER_SCENE, self.rays - tally.rays)
        rays = aimed_rays(rng, Targets(scene.packed), setting, wanted)
        ours = cast_by_culling(scene.packed, rays, "bvh")
        limited = with_limits(rng, rays, ours, LIMITED_RAYS_PER_SCENE)
        unlimited = rays.taken(slice(max(wanted - len(limited.t_min), 1)))
        rays = concatenated(unlimited, limited.taken(slice(wanted - 1)))
        findings = adjudicate(scene, rays, cast_by_culling(scene.packed, rays, "bvh"), tally)
        for finding in findings:
            tally.count_finding(finding)
        for finding in first_of_each_kind(findings):
            if self.outcome.keeps(finding, shape, self.keep):
                self._keep(shape, number, data, finding)

    def _keep(self, shape: str, number: int, data: dict[str, Any], finding: Finding) -> None:
        small = smallest_case(case_of(data, finding.ray), finding)
        again = next((f for f in findings_of(small) if f.kind == finding.kind), finding)
        seed = self.outcome.seed
        options = f"--seed {seed} --shape {shape} --rays {self.rays}"
        name = f"{finding.kind}-{shape}-rays-{seed}-{number}"
        file = write_kept(self.folder, name, finding.kind, again.what, options, small)
        self.outcome.failures.append(Failure(finding.kind, again.what, shape, options, str(file)))

    def text(self) -> str:
        """A table with a row per shape type, the failures, and the sum."""
        lines = aligned([COLUMNS, *(self._cells(shape) for shape in self.outcome.families)], left=1)
        for failure in self.outcome.failures:
            lines.append(f"FAIL  {failure.kind}: {failure.what}")
            lines.append(f"      replay: {failure.replay}")
        total = self.outcome.total
        wrong = f", {total.kinds_text}" if total.kinds else ""
        lines.append(
            f"seed {self.outcome.seed}: {total.rays} rays in {total.examples} scenes, {total.findings} wrong{wrong}, "
            f"t off by at most {total.worst:.3f} of its bound, "
            f"in {sum(self.seconds.values()):.1f} s"
        )
        return "\n".join(lines)

    def _cells(self, shape: str) -> list[str]:
        tally = self.outcome.families[shape]
        speed = tally.rays / max(self.seconds[shape], 1e-9)
        counts = [str(count) for count in (tally.rays, tally.hits, tally.edges, tally.ties)]
        return [shape, *counts, f"{tally.worst:.3f}", str(tally.findings), f"{speed:.0f}"]

    def to_dict(self, *, interrupted: bool) -> dict[str, Any]:
        """The JSON of a long run."""
        return {
            "ok": self.ok,
            "interrupted": interrupted,
            "seed": self.outcome.seed,
            "rays_a_shape": self.rays,
            "seconds": {shape: round(s, 3) for shape, s in self.seconds.items()},
            "total": self.outcome.total.to_dict(),
            "shapes": {shape: tally.to_dict() for shape, tally in self.outcome.families.items()},
            "failures": [dict(vars(failure)) for failure in self.outcome.failures],
        }


def random_scene_of(rng: Rng, shape: str) -> tuple[Setting, list[Fields]]:
    """One to three shapes of a type; a third of the time two of them coincide."""
    setting = random_setting(rng)
    if shape == "sphere" and rng.random() < 0.2:
        return setting, nearly_equal_spheres(rng, setting)
    count = int(rng.integers(1, MAX_SHAPES_PER_SCENE + 1))
    shapes = [random_shape(rng, shape, setting) for _ in range(count)]
    if rng.random() < 1.0 / 3.0:
        shapes.append(dict(shapes[0]))
    return setting, shapes
