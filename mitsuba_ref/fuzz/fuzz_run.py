"""Runs of `fuzz`: random examples until the time or their number is used up. Failing scenes are shrunk and kept."""

import itertools
import shlex
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed, packed
from caster.system.cluster import CallEnded
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.fuzz.cases import case_of, write_kept
from mitsuba_ref.fuzz.checks import SCENE_ERRORS, answers, check_image, check_rays, exception_finding, find
from mitsuba_ref.fuzz.findings import FINDING_KINDS, JUDGED_KINDS, Failure, Finding, Outcome, Tally
from mitsuba_ref.fuzz.shrink import SHRINK_ATTEMPTS, Shrinker
from mitsuba_ref.hard import BY_NAME
from mitsuba_ref.hard.family import Family, HardScene
from mitsuba_ref.hard.random_parts import shape_types
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.runner.engine import LOCAL, outcomes_of
from mitsuba_ref.shapes.targets import Rng
from mitsuba_ref.subjects.subject import OURS, Subject

RAYS_PER_EXAMPLE = 40  # before those with limits
EXAMPLES_A_CALL = 10  # 0.03 s of CPU each, 0.1 s and more where Mitsuba judges
SHRINK_GRACE_S = 5.0  # seconds that a finding may still be shrunk when the time is up
ENDED = "the process that casts and judges ended"
MITSUBA_SHRINK_ATTEMPTS = SHRINK_ATTEMPTS // 10  # each traces the scene with Mitsuba

# Random numbers of an example are independent for each of these purposes.
SCENE_STREAM, AIM_STREAM, LIMIT_STREAM, MITSUBA_STREAM = range(4)


@dataclass(frozen=True)
class Example:
    """Example `number` of a seed in a family: always the same scene and rays, whichever other families there are."""

    seed: int
    number: int
    family: Family
    types: tuple[str, ...] = shape_types()  # of the shapes that the scene keeps

    @cached_property
    def made(self) -> HardScene:
        """The scene, which may have no shape left."""
        rng, family = self.random(SCENE_STREAM), self.family
        made = family.make(rng, float(rng.choice(family.values)) if family.values else 0.0)
        shapes = [each for each in made.data["shape"] if each["type"] in self.types]
        return made._replace(data={**made.data, "shape": shapes})

    def random(self, stream: int) -> Rng:
        """Random numbers of the example, independent for each stream."""
        return np.random.default_rng([self.seed, self.number, zlib.crc32(self.family.name.encode()), stream])

    def rays(self, packed: Packed, count: int = RAYS_PER_EXAMPLE) -> Rays:
        return self.made.aim(self.random(AIM_STREAM), packed, count)


@dataclass(frozen=True)
class Drawing:
    """What all examples of a run have in common; each is tried by itself, in any process."""

    seed: int
    families: tuple[str, ...]
    judge_every: int  # one in so many, on average, gets the thorough checks and Mitsuba's comparison; 0: none
    rays: int  # of an example
    candidate: Subject | None  # is judged alone, by the comparison with Mitsuba and exact arithmetic

    @cached_property
    def types(self) -> tuple[str, ...]:
        """Of the shapes that the scenes keep: those that the candidate does not decline; all if it declines each."""
        subject, types = self.candidate, shape_types()
        if not (subject and subject.takes_rays):
            return types
        return tuple(each for each in types if answers(subject, each)) or types

    def example(self, number: int) -> Example:
        return Example(self.seed, number, BY_NAME[self.families[number % len(self.families)]], self.types)

    def words(self, number: int) -> tuple[str, ...]:
        """The options of `fuzz` that try one example."""
        options = {
            "--seed": self.seed,
            "--family": self.example(number).family.name,
            "--examples": f"{number}..{number}",
            "--rays": self.rays,
            "--judge-every": self.judge_every,
        }
        return tuple(str(word) for item in options.items() for word in item)

    def tried(self, number: int) -> "Tried":
        """An example, checked."""
        example, tally = self.example(number), Tally(examples=1)
        every, family, case = self.judge_every, example.family, case_of(example.made.data)
        if not self.candidate:
            drawn = every > 0 and (family.always_judged or example.random(MITSUBA_STREAM).random() * every < 1.0)
            found = check_example(example, tally, self.rays, thorough=drawn)
            if drawn and family.fits_float32:
                found += find(case, "judged", tally)
        elif family.fits_float32 and example.made.data["shape"]:
            aims = (None, partial(example.rays, count=self.rays)) if self.candidate.takes_rays else (None,)
            found = [each for aim in aims for each in find(case, "judged", tally, self.candidate, aim)]
        else:
            return Tried(number, Tally(), [])
        firsts = {finding.kind: finding for finding in reversed(found)}
        tally.findings, tally.kinds = len(firsts), Counter(firsts.keys())
        return Tried(number, tally, [firsts[kind] for kind in FINDING_KINDS if kind in firsts])


class Tried(NamedTuple):
    """An example by its number, what was checked of it, and one finding of each kind."""

    number: int
    tally: Tally
    findings: list[Finding]


def try_examples(drawing: Drawing, numbers: Sequence[int]) -> list[Tried]:
    """Try examples in this process, one after the other."""
    return [drawing.tried(number) for number in numbers]


@dataclass
class FuzzRun:
    """Tries many examples. `outcome` is complete at any moment: an interruption loses nothing."""

    drawing: Drawing
    numbers: Iterable[int]
    seconds: float | None
    folder: Path
    keep: int  # findings of one kind in one family that are shrunk and kept; all are counted
    options: tuple[str, ...]  # of the command line that name the candidate, for replays
    engine: str
    workers: int | None  # of the engine; None: one a core

    def __post_init__(self) -> None:
        self.subject = self.drawing.candidate or OURS
        self.outcome = Outcome(self.drawing.seed, candidate=self.subject.name)
        # A candidate, which may not bear forks or threads, runs in this process on its own.
        self.here = self.drawing.candidate is not None and self.engine == LOCAL

    def run(self) -> Iterator[Outcome]:
        """Yield the outcome after each example, in their order."""
        start = monotonic()
        self.deadline = float("inf") if self.seconds is None else start + self.seconds
        self.outcome.left_out = tuple(each for each in shape_types() if each not in self.drawing.types)
        for tried in self._tried(self.numbers, 1 if self.here else EXAMPLES_A_CALL, self.deadline):
            if tried.tally.examples:
                example = self.drawing.example(tried.number)
                family = example.family.name
                self.outcome.families.setdefault(family, Tally()).add(tried.tally)
                for finding in tried.findings:
                    kept = sum((each.kind, each.family) == (finding.kind, family) for each in self.outcome.failures)
                    if kept < self.keep:
                        self._keep(example, finding)
            self.outcome.last_example, self.outcome.seconds = tried.number, monotonic() - start
            yield self.outcome
        self.outcome.interrupted = False

    def _tried(self, numbers: Iterable[int], at_once: int, deadline: float) -> Iterator[Tried]:
        """What came of each example. Those of a call that ended its process are tried again, each by itself."""
        source = iter(numbers)
        batches, again = itertools.tee(iter(lambda: tuple(itertools.islice(source, at_once)), ()))
        calls = ((self.drawing, each) for each in itertools.takewhile(lambda _: monotonic() < deadline, again))
        with closing(
            outcomes_of(self.engine, 1 if self.here else self.workers, try_examples, calls, forks=not self.here)
        ) as outcomes:
            for outcome, batch in zip(outcomes, batches, strict=False):
                if not isinstance(outcome.error, CallEnded):
                    yield from outcome.value()
                elif len(batch) > 1:
                    yield from self._tried(batch, 1, float("inf"))
                else:
                    finding = Finding("crash", f"{ENDED}: {outcome.error}")
                    yield Tried(batch[0], Tally(examples=1, findings=1, kinds=Counter(["crash"])), [finding])
                if monotonic() >= deadline:
                    break

    def _keep(self, tried: Example, finding: Finding) -> None:
        """Shrink the scene and write it; an interruption leaves the smallest so far."""
        attempts = MITSUBA_SHRINK_ATTEMPTS if finding.kind in JUDGED_KINDS else SHRINK_ATTEMPTS
        judge = partial(find, kind=finding.kind, subject=self.subject)
        shrinker = Shrinker(case_of(tried.made.data), finding, judge, attempts, self.deadline + SHRINK_GRACE_S)
        family = tried.family.name
        found_by = shlex.join([*self.drawing.words(tried.number), *self.options])
        name = f"{finding.kind}-{family}-{tried.seed}-{tried.number}"
        try:
            if not finding.what.startswith(ENDED):  # which would end this process
                shrinker.run()
        finally:
            smallest = shrinker.finding
            file = str(write_kept(self.folder, name, smallest, found_by, shrinker.case, self.options))
            replay = shlex.join(["mitsuba-ref", "fuzz", "--replay", file, *self.options])
            about = finding.kind, smallest.what, family, found_by
            self.outcome.failures.append(Failure(*about, file, replay))


def check_example(tried: Example, tally: Tally, count: int = RAYS_PER_EXAMPLE, thorough: bool = False) -> list[Finding]:
    """Findings about an example's rays and image. A scene outside the oracle's domain is counted as such."""
    try:
        scene = tried.made.scene()
        oracle = Oracle(packed(scene))
    except SCENE_ERRORS:
        tally.outside += 1
        return []
    except Exception as error:
        return [exception_finding(error)]
    rays = tried.rays(oracle.packed, count)
    try:
        of_rays = check_rays(scene, oracle, rays, tally, tried.random(LIMIT_STREAM))
        return [*of_rays, *check_image(scene, oracle, tally, thorough)]
    except Exception as error:
        alone = (rays.take([i]) for i in range(len(rays.o)))
        found = [(ray, each) for ray in alone for each in find(case_of(tried.made.data, ray))]
        raising = [replace(each, ray=ray) for ray, each in found if each.kind == "error"]
        return [*raising, exception_finding(error)]
