"""pytest --mitsuba-ref scenes/: each scene is a test; and a fixture that judges a caster in any test.

Without the option and the fixture, nothing is collected or loaded. Entry point `mitsuba-ref` of the group pytest11.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneVerdict
    from mitsuba_ref.report.validation import Validation
    from mitsuba_ref.subjects.subject import Subject

OPTION = "--mitsuba-ref"
REPORT, SCENES = "mitsuba-ref-report", "mitsuba-ref-scenes"  # names of plug-ins

VERDICT = "verdict"  # the name of a scene's test
SUFFIXES = (".toml", ".json")
SCENE_MARKERS = ("[camera]", "[[shape]]", '"camera"', '"shape"')  # a file without any of them is no scene

CANDIDATE_OPTIONS = {
    "candidate": "another ray caster, judged in place of ours: package.module:function, or a command",
    "candidate-serve": "the same as a program that is started once and answers over stdin and stdout",
    "candidate-precision": "its arithmetic, float32 or float64; default: the type of what it returns",
}


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mitsuba-ref", "scenes judged against Mitsuba")
    group.addoption(
        OPTION,
        action="store_true",
        default=False,
        dest="mitsuba_ref",
        help="collect scene files, .toml and .json: each is a test",
    )
    folders = "folder beyond a scene's own whose meshes it may use; may be given several times"
    group.addoption(f"{OPTION}-mesh-dir", action="append", default=[], metavar="DIR", help=folders)
    film = "film in pixels, W H, instead of the scenes' own"
    group.addoption(f"{OPTION}-size", nargs=2, type=int, metavar=("W", "H"), help=film)
    for name, what in CANDIDATE_OPTIONS.items():
        group.addoption(f"{OPTION}-{name}", default="", metavar=name.rpartition("-")[2].upper(), help=what)
    page = "write a report for the browser on all judged scenes into this folder"
    group.addoption(f"{OPTION}-html", metavar="DIR", help=page)


def pytest_configure(config: pytest.Config) -> None:
    if folder := config.getoption(f"{OPTION}-html"):
        config.pluginmanager.register(Report(config, config.invocation_params.dir / folder), REPORT)
    if config.getoption("mitsuba_ref"):
        config.pluginmanager.register(ScenePlugin(config), SCENES)


@pytest.fixture
def judge_caster(request: pytest.FixtureRequest) -> Callable[..., Validation]:
    """judge_caster(trace, scene, ...): fails the test, with the cause, if Mitsuba and exact arithmetic find it wrong.

    The arguments are those of mitsuba_ref.validate, such as builtin="triangles" or size=(64, 64); returns its verdict.
    """

    def judge(trace: Any, scene: Any = None, **options: Any) -> Validation:
        import mitsuba_ref
        from mitsuba_ref.report.verdict_text import short_text

        verdict = mitsuba_ref.validate(scene, candidate=trace, **options)
        if report := request.config.pluginmanager.get_plugin(REPORT):
            for found in verdict.scenes:
                report.add(found, f"{request.node.name} {found.name}")
        if not verdict.ok:
            pytest.fail(short_text(verdict), pytrace=False)
        return verdict

    return judge


class Report:
    """The HTML report of a session. A process of xdist hands its scenes to the one that started it."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        """Raises pytest.UsageError where nothing can be written, or where another page is there."""
        from caster.system.atomic_files import OutputError
        from mitsuba_ref.report.html_report import HtmlReport

        self.to_starter: dict[str, Any] | None = getattr(config, "workeroutput", None)
        try:
            self.written = HtmlReport(folder, 0)
        except OutputError as error:
            raise pytest.UsageError(f"{OPTION}-html: {error}") from None

    def add(self, verdict: SceneVerdict, name: str) -> None:
        """Add a scene with its evidence. name: distinct in the session."""
        self.written.verdicts.append(self.written.keep(replace(verdict, name=name)))

    def pytest_sessionfinish(self) -> None:
        if self.to_starter is not None:
            self.to_starter[REPORT] = pickle.dumps((self.written.verdicts, self.written.thumbnails))
        else:
            self.written.requested = len(self.written.verdicts)
            self.written.write()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take the scenes of a process of xdist that has ended."""
        if state := getattr(node, "workeroutput", {}).get(REPORT):
            verdicts, thumbnails = pickle.loads(state)
            self.written.verdicts += verdicts
            self.written.thumbnails.update(thumbnails)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        terminalreporter.write_line(f"mitsuba-ref report: {self.written.index.as_uri()}")


class ScenePlugin:
    """Hooks of pytest that collect scenes, and their verdicts."""

    def __init__(self, config: pytest.Config) -> None:
        config.addinivalue_line("markers", "mitsuba_ref: a scene, by --mitsuba-ref")
        self.config = config
        self.start = config.invocation_params.dir
        size = config.getoption(f"{OPTION}-size")
        self.size = size and (size[0], size[1])
        self.words: dict[str, str] = {name: config.getoption(f"{OPTION}-{name}") for name in CANDIDATE_OPTIONS}
        if self.words["candidate"] and self.words["candidate-serve"]:
            raise pytest.UsageError(f"{OPTION}-candidate: not together with {OPTION}-candidate-serve")
        self.candidate = self.words["candidate"] or self.words["candidate-serve"]
        if self.words["candidate-precision"] and not self.candidate:
            raise pytest.UsageError(f"{OPTION}-candidate-precision: expected {OPTION}-candidate beside it")
        self.mesh_dirs = tuple(config.getoption(f"{OPTION}-mesh-dir"))
        self.named = {Path(self.start, arg.split("::")[0]).resolve() for arg in config.args}

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        if file_path.suffix.lower() in SUFFIXES and (file_path.resolve() in self.named or is_scene(file_path)):
            collector: SceneFile = SceneFile.from_parent(parent, path=file_path)
            return collector
        return None

    def pytest_report_header(self) -> str:
        film = f"films of {self.size[0]} x {self.size[1]}" if self.size else "the scenes' own films"
        about = f", candidate {self.candidate}" if self.candidate else ""
        return f"mitsuba-ref: {film}{about}"

    def problem_of(self, path: Path) -> str:
        """What is wrong with a scene or with the candidate, as `validate` prints it; "" if nothing is."""
        from caster.description.errors import SceneError
        from mitsuba_ref.report.html_report import page_record
        from mitsuba_ref.report.verdict_text import failure_text
        from mitsuba_ref.runner import many_scenes

        named = str(path.relative_to(self.start)) if path.is_relative_to(self.start) else str(path)
        options = *(("mesh-dir", folder) for folder in self.mesh_dirs), *self.words.items()
        words = tuple(word for name, value in options if value for word in (f"--{name}", value))
        entry = many_scenes.SceneEntry(path.stem, named, self.size, self.mesh_dirs, words)
        report = self.config.pluginmanager.get_plugin(REPORT)
        try:
            failing = self.failing_run_checks
            judge = many_scenes.JudgeOptions(subject=self.subject, page_of=page_record if report else None)
        except SceneError as error:
            return str(error)
        with many_scenes.engine_for([entry], judge, workers=1) as engine:
            (verdict,) = many_scenes.run([entry], judge, engine)
        if report:
            report.add(verdict, named)
        return "\n".join([*([] if verdict.ok else [failure_text(verdict)]), *failing])

    @cached_property
    def subject(self) -> Subject | None:
        """The candidate, if there is one. Raises SceneError for one that cannot be used."""
        from mitsuba_ref.subjects.requests import parse_candidate

        if not self.candidate:
            return None
        served = bool(self.words["candidate-serve"])
        return parse_candidate(self.candidate, self.words["candidate-precision"] or None, served=served)

    @cached_property
    def failing_run_checks(self) -> list[str]:
        """Those of the checks that are made once a run, each as a line."""
        from mitsuba_ref.judge.checks import run_checks

        return [f"FAIL  {check.name}: {check.what}" for check in run_checks(self.subject) if not check.ok]


def is_scene(path: Path) -> bool:
    """Whether a file looks like a scene: pyproject.toml and package.json may lie in the same folder."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any(mark in text for mark in SCENE_MARKERS)


class SceneFile(pytest.File):
    """The file of a scene."""

    def collect(self) -> Iterator[SceneTest]:
        test: SceneTest = SceneTest.from_parent(self, name=VERDICT)
        test.add_marker("mitsuba_ref")
        yield test


class SceneTest(pytest.Item):
    """The test of one scene."""

    def runtest(self) -> None:
        plugin: Any = self.config.pluginmanager.get_plugin(SCENES)
        if problem := plugin.problem_of(self.path):
            from caster.system.terminal import printable

            pytest.fail(printable(problem), pytrace=False)
