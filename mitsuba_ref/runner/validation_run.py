"""One run of `mitsuba-ref validate`: scenes of a shard, judged or resumed, with the files and pages that they leave."""

import hashlib
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.reference.session import DEFAULT_TIMEOUT
from mitsuba_ref.report.html_report import HtmlReport, page_record
from mitsuba_ref.report.output_manifest import OutFolder, RemovedFiles
from mitsuba_ref.runner import scene_runner
from mitsuba_ref.runner.isolation import CALL_TIMEOUTS, Isolated, WorkerEnded
from mitsuba_ref.runner.resume import ResumableResults, code_hash, recorded
from mitsuba_ref.runner.scene_runner import Entry, JudgeScene
from mitsuba_ref.runner.shards import Shard, judged_with, scenes_of_shard
from mitsuba_ref.subjects.subject import Subject


@dataclass(frozen=True)
class RunOptions:
    """Options of a run beside its scenes."""

    workers: int | None = None  # scenes at a time; None: one a core
    maxfail: int | None = None  # scenes that fail, after which the run ends
    out: Path | None = None  # folder of verdict.json, images and reproducers
    html: str | None = None  # folder or file of the HTML report
    resume: bool = False  # reuse what `out` holds of the same inputs
    shard: Shard | None = None
    timeout: float = DEFAULT_TIMEOUT  # seconds that Mitsuba may take for one scene
    store: bool = True  # take what Mitsuba answered in earlier runs to the very same request
    whole_folders: bool = False  # every scene of the folders was selected: files of other scenes are obsolete


class ValidationRun:
    """Judges scenes one after the other; `verdict` and `finish` hold for those that are done so far."""

    def __init__(
        self, entries: Sequence[Entry], options: RunOptions, candidate: Subject | None = None
    ) -> None:
        """entries: the scenes of all shards; candidate: in place of our caster. Raises OutputError."""
        self.every, self.options, self.candidate = entries, options, candidate
        self.entries = scenes_of_shard(entries, options.shard) if options.shard else list(entries)
        self.candidate_name = candidate.name if candidate else ""
        self.done: list[SceneVerdict] = []
        self.errors: list[Exception] = []  # of scenes that could not be loaded, judged or written
        self.out = OutFolder(options.out) if options.out else None
        self.html = HtmlReport(options.html, len(self.entries), self.candidate_name) if options.html else None

    def verdicts(self) -> Generator[SceneVerdict, None, None]:
        """Verdicts in the order of the scenes, each as soon as it and those before it are done."""
        judge = self._judge()
        if self.out:
            self.out.begin()
        workers = self.options.workers or scene_runner.default_workers()
        record = self.html.keep if self.html else None
        running = scene_runner.run(
            self.entries,
            workers,
            self.options.maxfail,
            self.options.out,
            judge,
            record,
            self.errors.append,
        )
        with closing(running), closing(scene_runner.progress_bar(self.entries)) as bar:
            for verdict in running:
                self.done.append(verdict)
                if self.html:
                    self.html.add(verdict)
                with bar.aside():
                    yield verdict
                scene_runner.count_scene(bar, self.entries, len(self.done))

    def verdict(self) -> Verdict:
        """Of all scenes that are done."""
        names = tuple(entry.name for entry in self.entries)
        identity = self._identity
        return Verdict(
            tuple(self.done),
            scene_count=len(names),
            names=names,
            requested_candidate=self.candidate_name,
            **identity,
        )

    @cached_property
    def _identity(self) -> dict[str, Any]:
        return run_identity(self.every, self.options.shard)

    def remove_obsolete(self, verdict: Verdict) -> RemovedFiles:
        """Remove files that earlier runs wrote into `out` and this one did not. Raises OutputError."""
        names = tuple(entry.name for entry in self.every) if self.options.whole_folders else None
        return self.out.sweep(verdict, names) if self.out else RemovedFiles()

    def finish_report(self, verdict: Verdict) -> str:
        """Write the HTML report of what is done; what was removed of earlier ones, as text. Raises OutputError."""
        if self.html is None:
            return ""
        try:
            self.html.write()
            return self.html.sweep(verdict.not_judged).words(self.html.data)
        finally:
            self.html.close()

    def _judge(self) -> JudgeScene:
        page_of = partial(page_record, one_file=self.html.one_file) if self.html else None
        options: dict[str, Any] = {
            "timeout": self.options.timeout,
            "store": self.options.store,
            "page_of": page_of,
        }
        if self.candidate is not None:
            judge = candidate_judge(self.candidate, **options)
            return recorded(judge, self.out) if self.out else judge
        if self.options.timeout > DEFAULT_TIMEOUT:
            scene_runner.ISOLATED.seconds = CALL_TIMEOUTS * self.options.timeout
        judge = partial(scene_runner.judge_entry, **options)
        if self.out is None:
            return judge
        if self.html is None:
            return ResumableResults(self.out, judge, resume=self.options.resume).judge
        return ResumableResults(self.out, judge, resume=self.options.resume, has_page=self.html.holds).judge


def candidate_judge(candidate: Subject, **options: Any) -> JudgeScene:
    """Judges a scene with a candidate in place of our caster; options as of `judge_here`."""

    def judge(entry: Entry, folder: Path | None) -> SceneVerdict:
        found = scene_runner.judge_entry(entry, folder, subject=candidate, **options)
        return replace(found, candidate=candidate.name)

    return judge


def run_identity(every: Sequence[Entry], shard: Shard | None) -> dict[str, Any]:
    """Fields of a Verdict that name the sources and versions that judged. every: the scenes of all shards."""
    if shard is None:
        return {"code": code_hash(), "judged_with": judged_with()}
    # The scenes are a part of the hash, so that shards of other scenes of the same names are not merged.
    code = hashlib.sha256(code_hash().encode())
    for entry in every:
        code.update(f"\0{entry.name}\0{scene_identity(entry)}".encode())
    names = tuple(entry.name for entry in every)
    return {"code": code.hexdigest(), "judged_with": judged_with(), "shard": str(shard), "selected": names}


def scene_identity(entry: Entry) -> str:
    """The hash of a scene and its meshes, which a fork loads; "" where it cannot be loaded."""
    try:
        with SCENE_HASHES.kept():
            return SCENE_HASHES(entry)
    except (SceneError, MemoryError, WorkerEnded):
        return ""


def scene_hash(entry: Entry) -> str:
    """SHA-256 of a scene and its meshes. Raises SceneError."""
    return entry.load().scene.sha256()


SCENE_HASHES = Isolated(scene_hash)
