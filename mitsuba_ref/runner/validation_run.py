"""One run of `mitsuba-ref validate`: the scenes of a shard, waived failures, and the files it writes."""

import json
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from caster.description.fields import Description, Index
from caster.description.input_files import read_text
from caster.description.parsing import model_of_text
from caster.rendering.threads import core_count
from caster.system.terminal import ProgressBar
from mitsuba_ref.judge.checks import run_checks
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.reference.store import PROCESSOR
from mitsuba_ref.report.html_report import HtmlReport, page_record
from mitsuba_ref.report.out_folder import OutFolder
from mitsuba_ref.report.verdict_text import failing_checks
from mitsuba_ref.runner import many_scenes
from mitsuba_ref.runner.engine import LOCAL
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry
from mitsuba_ref.runner.shards import Shard, run_identity, scenes_of_shard


@dataclass(frozen=True)
class RunOptions:
    """Options of a run beside its scenes."""

    judge: JudgeOptions
    workers: int | None = None  # scenes at a time; None: one for each core
    engine: str = LOCAL  # that judges them
    maxfail: int | None = None  # failing scenes after which the run ends
    html: str | None = None  # folder or file of the HTML report
    shard: Shard | None = None
    expected: "ExpectedFailures | None" = None  # known failures, by which the run does not fail
    skip_unsupported: bool = False  # nor by scenes that the candidate declines
    min_scenes: int = 0  # that have to be judged for the run to pass


class ValidationRun:
    """Judges scenes one after the other; `verdict` and `finish` are about the scenes done so far."""

    def __init__(self, entries: Sequence[SceneEntry], options: RunOptions, out: OutFolder | None = None) -> None:
        """entries: the scenes of all shards. out: for the images of both sides. Raises OutputError."""
        self.every, self.options = entries, options
        self.entries = scenes_of_shard(entries, options.shard) if options.shard else list(entries)
        self.candidate_name = options.judge.subject.name if options.judge.subject else ""
        self.done: list[SceneVerdict] = []
        self.processors = frozenset[str]()  # of the machines that judged
        self.errors: list[Exception] = []  # of scenes that could not be loaded, judged or written
        self.checks: tuple[SceneCheck, ...] = ()
        self.out = out
        self.html = HtmlReport(options.html, len(self.entries), self.candidate_name) if options.html else None

    def verdicts(self) -> Generator[SceneVerdict, None, None]:
        """Verdicts in the order of the scenes, each as soon as it and those before it are done."""
        workers = self.options.workers or core_count()
        self.checks = run_checks(self.options.judge.subject)
        # A thread for each core: more would wait for each other, a twentieth of the time.
        threads = None if self.candidate_name else max(1, core_count() // max(1, min(workers, len(self.entries))))
        threads = threads if self.options.engine == LOCAL else 1
        folder, page_of = self.out.folder if self.out else None, page_record if self.html else None
        judge = self.options.judge._replace(folder=folder, page_of=page_of, threads=threads)
        with (
            many_scenes.engine_for(self.entries, judge, self.options.engine, workers) as engine,
            closing(
                many_scenes.run(self.entries, judge, engine, self.options.maxfail, self._recorded, self.errors.append)
            ) as running,
            closing(ProgressBar("validating", len(self.entries))) as bar,
        ):
            for verdict in running:
                self.done.append(verdict)
                self.processors = engine.processors
                if self.html:
                    self.html.add(verdict)
                with bar.aside():
                    yield verdict
                bar.add(1, f"{len(self.done)} of {len(self.entries)} scenes")

    def _recorded(self, found: SceneVerdict) -> SceneVerdict:
        """The verdict with its page written and, if it is waived, with the reason."""
        verdict = self.html.keep(found) if self.html else found
        if verdict.unsupported and self.options.skip_unsupported:
            return replace(verdict, waived=UNSUPPORTED)
        expected = self.options.expected
        return replace(verdict, waived=EXPECTED) if expected and expected.covers(verdict) else verdict

    def verdict(self) -> Verdict:
        """The verdict of the scenes done so far."""
        names = tuple(entry.name for entry in self.entries)
        judged_on = {PROCESSOR: " and ".join(sorted(self.processors))} if self.processors else {}
        return Verdict(
            tuple(self.done),
            scene_count=len(names),
            names=names,
            requested_candidate=self.candidate_name,
            checks=self.checks,
            min_scenes=self.options.min_scenes,
            fixed=self.options.expected.fixed(self.done) if self.options.expected else (),
            **self._identity | {"judged_with": self._identity["judged_with"] | judged_on},
        )

    @cached_property
    def _identity(self) -> dict[str, Any]:
        return run_identity(self.every, self.options.shard)

    def finish(self) -> str:
        """Write verdict.json and the report; what was removed of an earlier run. Raises OutputError."""
        try:
            return self.out.finish(self.verdict()) if self.out else ""
        finally:
            if self.html:
                self.html.write()


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
