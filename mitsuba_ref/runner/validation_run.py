"""One run of `mitsuba-ref validate`: the scenes of a shard, what is waived, and the files it leaves."""

import hashlib
import json
import tomllib
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError

from caster.description.errors import SceneError
from caster.description.input_files import MAX_TEXT_BYTES, read_input
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, SceneVerdict, Verdict
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.report.html_report import HtmlReport, page_record
from mitsuba_ref.report.out_folder import OutFolder
from mitsuba_ref.report.verdict_text import failing_checks
from mitsuba_ref.runner import many_scenes
from mitsuba_ref.runner.many_scenes import Entry
from mitsuba_ref.runner.shards import Shard, judged_with, scenes_of_shard
from mitsuba_ref.runner.verdict_files import code_hash
from mitsuba_ref.runner.workers import WorkerEnded, Workers
from mitsuba_ref.subjects.subject import Subject


@dataclass(frozen=True)
class RunOptions:
    """Options of a run beside its scenes."""

    workers: int | None = None  # scenes at a time; None: one a core
    maxfail: int | None = None  # scenes that fail, after which the run ends
    out: Path | None = None  # folder of verdict.json, images and reproducers
    html: str | None = None  # folder or file of the HTML report
    shard: Shard | None = None
    timeout: float = DEFAULT_TIMEOUT  # seconds that Mitsuba may take for one scene
    store: bool = True  # take what earlier runs stored of the very same inputs
    expected: "ExpectedFailures | None" = None  # known failures, by which the run does not fail
    skip_unsupported: bool = False  # nor by scenes that the candidate declines
    min_scenes: int = 0  # that have to be judged for the run to pass
    whole_folders: bool = False  # every scene of the folders was selected: files of other scenes are obsolete


class ValidationRun:
    """Judges scenes one after the other; `verdict` and `finish` are about the scenes done so far."""

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
        if self.out:
            self.out.begin()
        workers = self.options.workers or many_scenes.default_workers()
        options = many_scenes.JudgeOptions(
            self.options.out,
            self.options.timeout,
            self.options.store,
            self.candidate,
            page_record if self.html else None,
            None if self.candidate else many_scenes.threads_per_worker(workers, len(self.entries)),
        )
        running = many_scenes.run(
            self.entries, options, workers, self.options.maxfail, self._recorded, self.errors.append
        )
        with closing(running), closing(many_scenes.progress_bar(self.entries)) as bar:
            for verdict in running:
                self.done.append(verdict)
                if self.html:
                    self.html.add(verdict)
                with bar.aside():
                    yield verdict
                many_scenes.count_scene(bar, self.entries, len(self.done))

    def _recorded(self, found: SceneVerdict) -> SceneVerdict:
        """The verdict, its page written, with the reason why the run does not fail by it, if there is one."""
        verdict = self.html.keep(found) if self.html else found
        if verdict.unsupported and self.options.skip_unsupported:
            return replace(verdict, waived=UNSUPPORTED)
        expected = self.options.expected
        return replace(verdict, waived=EXPECTED) if expected and expected.covers(verdict) else verdict

    def verdict(self) -> Verdict:
        """Of all scenes that are done."""
        names = tuple(entry.name for entry in self.entries)
        return Verdict(
            tuple(self.done),
            scene_count=len(names),
            names=names,
            requested_candidate=self.candidate_name,
            min_scenes=self.options.min_scenes,
            fixed=self.options.expected.fixed(self.done) if self.options.expected else (),
            **self._identity,
        )

    @cached_property
    def _identity(self) -> dict[str, Any]:
        return run_identity(self.every, self.options.shard)

    def finish(self) -> Iterator[str]:
        """Write verdict.json and the report of what is done; what was removed of earlier runs, in words.

        Raises OutputError.
        """
        verdict = self.verdict()
        try:
            if self.out:
                selected = tuple(entry.name for entry in self.every) if self.options.whole_folders else None
                yield self.out.finish(verdict, selected)
        finally:
            if self.html:
                self.html.write()
                yield self.html.sweep(verdict.not_judged)


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
        checks = failing_checks(found)
        return not found.ok and any(checks <= set(each.checks) and found.failing <= each.pixels for each in listed)

    def fixed(self, done: Sequence[SceneVerdict]) -> tuple[str, ...]:
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
        checks = ", ".join(json.dumps(name) for name in sorted(failing_checks(found)))
        parts.append(
            f"\n[[failure]]\nscene = {json.dumps(found.name)}\nchecks = [{checks}]\npixels = {found.failing}\n"
        )
    return "".join(parts)


def run_identity(every: Sequence[Entry], shard: Shard | None) -> dict[str, Any]:
    """Fields of a Verdict that name the sources and versions that judged. every: the scenes of all shards."""
    if shard is None:
        return {"code": code_hash(), "judged_with": judged_with()}
    # The scenes are a part of the hash, so that shards of other scenes of the same names are not merged.
    code = hashlib.sha256(code_hash().encode())
    with Workers() as pool:
        for entry in every:
            code.update(f"\0{entry.name}\0{scene_identity(pool, entry)}".encode())
    names = tuple(entry.name for entry in every)
    return {"code": code.hexdigest(), "judged_with": judged_with(), "shard": str(shard), "selected": names}


def scene_identity(pool: Workers, entry: Entry) -> str:
    """The hash of a scene and its meshes, which a worker loads; "" where it cannot be loaded."""
    try:
        return pool.call(scene_hash, entry)
    except (SceneError, MemoryError, WorkerEnded):
        return ""


def scene_hash(entry: Entry) -> str:
    """SHA-256 of a scene and its meshes. Raises SceneError."""
    return entry.load().scene.sha256()
