"""One run of `mitsuba-ref validate`: the scenes of a shard, waived failures, and the files it writes."""

import json
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import ClassVar

from caster.description.fields import Description, Index
from caster.description.input_files import read_text
from caster.description.parsing import model_of_text
from caster.rendering.threads import core_count
from caster.system.atomic_files import write_text
from caster.system.cluster import CallEnded
from caster.system.terminal import ProgressBar
from mitsuba_ref.judge.checks import run_checks
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.store import PROCESSOR
from mitsuba_ref.report.html_report import HtmlReport, page_record
from mitsuba_ref.report.output import json_text
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.report.verdict_text import failing_checks, failing_scenes
from mitsuba_ref.runner.engine import LOCAL, opened
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, judge_entry, problem_of, with_inputs_hash
from mitsuba_ref.runner.shards import run_identity
from mitsuba_ref.runner.workers import CALL_TIMEOUTS

VERDICT = "verdict.json"  # in the folder of --out


@dataclass
class ValidationRun:
    """Judges scenes one after the other; `verdict` and `finish` are about the scenes done so far.

    A scene that cannot be loaded, judged or written has a verdict with the problem, and its exception is in `errors`.
    """

    all_entries: Sequence[SceneEntry]  # the scenes of all shards
    judge: JudgeOptions
    out: Path | None = None  # the folder of the images of both sides
    html: str | None = None  # that of the HTML report
    _: KW_ONLY
    workers: int | None = None  # scenes at a time; None: one for each core
    engine: str = LOCAL
    maxfail: int | None = None  # failing scenes after which the run ends
    shard: tuple[int, int] | None = None  # part I of N, which is judged
    expected: "ExpectedFailures | None" = None  # known failures, by which the run does not fail
    skip_unsupported: bool = False  # nor does it by scenes that the candidate declines
    min_scenes: int = 0  # that have to be judged for the run to pass

    def __post_init__(self) -> None:
        """Raises OutputError."""
        self.entries = self.all_entries[self.shard[0] - 1 :: self.shard[1]] if self.shard else self.all_entries
        self.candidate_name = self.judge.subject.name if self.judge.subject else ""
        self.report = HtmlReport(self.html, len(self.entries), self.candidate_name) if self.html else None
        self.judge = self.judge._replace(folder=self.out, page_of=page_record if self.html else None)
        self.done: list[SceneVerdict] = []
        self.processors = frozenset[str]()  # of the machines that judged
        self.errors: list[Exception] = []
        self.checks: tuple[SceneCheck, ...] = ()

    def verdicts(self) -> Generator[SceneVerdict, None, None]:
        """Verdicts in the order of the scenes, each as soon as it and those before it are done."""
        self.checks = run_checks(self.judge.subject)
        # A thread for each core: more would wait for each other, a twentieth of the time.
        workers = min(self.workers or core_count(), len(self.entries))
        threads = None if self.candidate_name else max(1, core_count() // max(1, workers))
        judge = self.judge._replace(threads=threads if self.engine == LOCAL else 1)
        ours = judge.subject is None and all(entry.subject is None for entry in self.entries)
        seconds = CALL_TIMEOUTS * max(judge.timeout, DEFAULT_TIMEOUT)
        with opened(self.engine, self.workers, seconds, forks=ours) as engine:  # a candidate runs in this process
            calls = ((with_inputs_hash(entry) if engine.cluster else entry, judge) for entry in self.entries)
            with (
                closing(engine.map(judge_entry, calls, self._recorded)) as outcomes,
                closing(ProgressBar("validating", len(self.entries))) as bar,
            ):
                for entry, outcome in zip(self.entries, outcomes, strict=True):
                    verdict = outcome.result
                    if error := outcome.error:
                        self.errors += [] if isinstance(error, CallEnded) else [error]
                        verdict = with_replay(SceneVerdict(entry.name, entry.path, problem=problem_of(error)))
                    self.done.append(verdict)
                    self.processors = engine.processors
                    if self.report:
                        self.report.add(verdict)
                    with bar.aside():
                        yield verdict
                    bar.add(1, f"{len(self.done)} of {len(self.entries)} scenes")
                    if self.maxfail and len(failing_scenes(self.done)) >= self.maxfail:
                        return

    def _recorded(self, found: SceneVerdict) -> SceneVerdict:
        """The verdict with its page written and, if it is waived, with the reason."""
        verdict = self.report.keep(found) if self.report else found
        if verdict.unsupported and self.skip_unsupported:
            return replace(verdict, waived=UNSUPPORTED)
        return replace(verdict, waived=EXPECTED) if self.expected and self.expected.covers(verdict) else verdict

    def verdict(self) -> Verdict:
        """The verdict of the scenes done so far."""
        names = tuple(entry.name for entry in self.entries)
        identity = run_identity(self.all_entries, self.shard)
        judged_on = {PROCESSOR: " and ".join(sorted(self.processors))} if self.processors else {}
        return Verdict(
            tuple(self.done),
            scene_count=len(names),
            names=names,
            requested_candidate=self.candidate_name,
            checks=self.checks,
            min_scenes=self.min_scenes,
            fixed=self.expected.fixed(self.done) if self.expected else (),
            **identity | {"judged_with": identity["judged_with"] | judged_on},
        )

    def finish(self, verdict: Verdict) -> None:
        """Write verdict.json and the report. Raises OutputError."""
        try:
            if self.out:
                write_text(self.out / VERDICT, json_text(verdict))
        finally:
            if self.report:
                self.report.write()


# ---- known failures ----

EXPECTED_HEAD = """\
# Known failures: `mitsuba-ref validate --expected FILE` passes with these and no others.
# A scene may fail these checks, at so many pixels at most. Add a line `why = "..."` where the cause is known.
"""


class ExpectedFailure(Description):
    """A scene that is known to fail."""

    scene: str
    checks: tuple[str, ...]  # names of the checks that may fail
    pixels: Index  # how many may fail at most
    why: str = ""


class ExpectedFailures(Description):
    """The contents of the file of --expected."""

    ELEMENTS: ClassVar[dict[str, int]] = {"failure": 2}

    failure: tuple[ExpectedFailure, ...] = ()

    def covers(self, found: SceneVerdict) -> bool:
        """Whether a scene fails only in a known way."""
        listed = [each for each in self.failure if each.scene == found.name]
        checks = failing_checks(found)
        return not found.ok and any(checks <= set(each.checks) and found.failing <= each.pixels for each in listed)

    def fixed(self, done: Sequence[SceneVerdict]) -> tuple[str, ...]:
        """Names of the listed scenes that pass."""
        named = {each.scene for each in self.failure}
        return tuple(found.name for found in done if found.ok and found.name in named)


def read_expected(path: str) -> ExpectedFailures:
    """The known failures of a file. Raises FileMissing, or SceneError with every error and its line."""
    return model_of_text(ExpectedFailures, read_text(path, "file of known failures"), "toml", path)


def expected_toml(done: Sequence[SceneVerdict]) -> str:
    """The failures of a run as a file for --expected, without scenes that the candidate declined."""
    parts = [EXPECTED_HEAD]
    for found in (each for each in done if not each.ok and not each.unsupported):
        checks = ", ".join(json.dumps(name) for name in sorted(failing_checks(found)))
        parts.append(
            f"\n[[failure]]\nscene = {json.dumps(found.name)}\nchecks = [{checks}]\npixels = {found.failing}\n"
        )
    return "".join(parts)
