"""One run of `mitsuba-ref validate`: scenes of a shard, judged or resumed, what is waived, the files it leaves."""

import hashlib
import json
import tomllib
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError

from caster.description.errors import SceneError
from caster.description.input_files import MAX_TEXT_BYTES, read_input
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, SceneVerdict, Verdict
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.report.html_report import HtmlReport, page_record
from mitsuba_ref.report.output_manifest import OutFolder, RemovedFiles
from mitsuba_ref.report.verdict_text import checks_of
from mitsuba_ref.runner import many_scenes
from mitsuba_ref.runner.isolation import CALL_TIMEOUTS, Isolated, WorkerEnded
from mitsuba_ref.runner.many_scenes import Entry, JudgeScene
from mitsuba_ref.runner.resume import ResumableResults, code_hash, recorded
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
    thorough: bool = False  # make every check of our caster (judge/__init__.py)
    expected: "ExpectedFailures | None" = None  # known failures, by which the run does not fail
    skip_unsupported: bool = False  # nor by scenes that the candidate declines
    min_scenes: int = 0  # that have to be judged for the run to pass
    whole_folders: bool = False  # every scene of the folders was selected: files of other scenes are obsolete


class ValidationRun:
    """Judges scenes one after the other; `verdict` and `finish` hold for those that are done so far."""

    def __init__(self, entries: Sequence[Entry], options: RunOptions, candidate: Subject | None = None) -> None:
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
        record = self.html.keep if self.html else None
        running = many_scenes.run(
            self.entries, self._workers, self.options.maxfail, self.options.out, judge, record, self.errors.append
        )
        with closing(running), closing(many_scenes.progress_bar(self.entries)) as bar:
            for verdict in running:
                self.done.append(verdict)
                if self.html:
                    self.html.add(verdict)
                with bar.aside():
                    yield verdict
                many_scenes.count_scene(bar, self.entries, len(self.done))

    @property
    def _workers(self) -> int:
        return self.options.workers or many_scenes.default_workers()

    def verdict(self) -> Verdict:
        """Of all scenes that are done."""
        names = tuple(entry.name for entry in self.entries)
        identity = self._identity
        return Verdict(
            tuple(self.done),
            scene_count=len(names),
            names=names,
            requested_candidate=self.candidate_name,
            min_scenes=self.options.min_scenes,
            mended=self.options.expected.mended(self.done) if self.options.expected else (),
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
        judge = self._judge_unwaived()
        if self.options.expected is None and not self.options.skip_unsupported:
            return judge
        return lambda entry, folder: self._waived(judge(entry, folder))

    def _waived(self, found: SceneVerdict) -> SceneVerdict:
        """The verdict of a scene, with the reason why the run does not fail by it, if there is one."""
        if found.unsupported and self.options.skip_unsupported:
            return replace(found, waived=UNSUPPORTED)
        expected = self.options.expected
        return replace(found, waived=EXPECTED) if expected and expected.covers(found) else found

    def _judge_unwaived(self) -> JudgeScene:
        page_of = partial(page_record, one_file=self.html.one_file) if self.html else None
        options: dict[str, Any] = {"timeout": self.options.timeout, "store": self.options.store, "page_of": page_of}
        if self.candidate is not None:
            judge = candidate_judge(self.candidate, **options)
            return recorded(judge, self.out) if self.out else judge
        if self.options.timeout > DEFAULT_TIMEOUT:
            many_scenes.ISOLATED.seconds = CALL_TIMEOUTS * self.options.timeout
        threads = many_scenes.threads_per_worker(self._workers, len(self.entries))
        thorough = self.options.thorough
        judge = partial(many_scenes.judge_entry, threads=threads, thorough=thorough, **options)
        if self.out is None:
            return judge
        about: dict[str, Any] = {"resume": self.options.resume, "thorough": thorough}
        if self.html is not None:
            about["has_page"] = self.html.holds
        return ResumableResults(self.out, judge, **about).judge


# ---- known failures ----

EXPECTED_HEAD = """\
# Known failures: `mitsuba-ref validate --expected FILE` passes with these and no others.
# A scene may fail these checks, at so many pixels at most. Add a line `why = "..."` where the cause is known.
"""


class ExpectedFailure(BaseModel):
    """A scene that is known to fail."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    scene: str
    checks: list[str]  # names of the checks that may fail
    pixels: NonNegativeInt  # at most so many may
    why: str = ""


class ExpectedFailures(BaseModel):
    """The contents of the file of --expected."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    failure: list[ExpectedFailure] = []

    def covers(self, found: SceneVerdict) -> bool:
        """Whether a scene fails in a known way, and in no other."""
        listed = [each for each in self.failure if each.scene == found.name]
        checks = checks_of(found)
        return not found.ok and any(checks <= set(each.checks) and found.failing <= each.pixels for each in listed)

    def mended(self, done: Sequence[SceneVerdict]) -> tuple[str, ...]:
        """Names of scenes that are listed, and pass."""
        named = {each.scene for each in self.failure}
        return tuple(found.name for found in done if found.ok and found.name in named)


def read_expected(path: str) -> ExpectedFailures:
    """The known failures of a file. Raises FileMissing, SceneError with every error in it."""
    data = read_input(path, "file of known failures", MAX_TEXT_BYTES)
    try:
        return ExpectedFailures.model_validate(tomllib.loads(data.decode("utf-8")))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SceneError(f"{path}: expected TOML, as --write-expected writes it: {error}") from error
    except ValidationError as error:
        problems = [
            f"{path}: {'.'.join(map(str, each['loc']))}: {each['msg'][:1].lower()}{each['msg'][1:]}"
            for each in error.errors()
        ]
        raise SceneError("\n".join(problems)) from error


def expected_toml(done: Sequence[SceneVerdict]) -> str:
    """The failures of a run as text for --expected; scenes that the candidate declines are none."""
    parts = [EXPECTED_HEAD]
    for found in (each for each in done if not each.ok and not each.unsupported):
        checks = ", ".join(json.dumps(name) for name in sorted(checks_of(found)))
        parts.append(
            f"\n[[failure]]\nscene = {json.dumps(found.name)}\nchecks = [{checks}]\npixels = {found.failing}\n"
        )
    return "".join(parts)


def candidate_judge(candidate: Subject, **options: Any) -> JudgeScene:
    """Judges a scene with a candidate in place of our caster; options as of `judge_here`."""

    def judge(entry: Entry, folder: Path | None) -> SceneVerdict:
        found = many_scenes.judge_entry(entry, folder, subject=candidate, **options)
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
