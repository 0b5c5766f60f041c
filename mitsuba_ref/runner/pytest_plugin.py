"""pytest --mitsuba-ref scenes/: each check of each scene is a test; and a fixture that judges a caster in any test.

Without the option and the fixture, nothing is collected or loaded. Entry point `mitsuba-ref` of the group pytest11. The
first test of a scene has it judged by mitsuba_ref/runner/many_scenes.py, and all tests of that scene show parts of this
verdict.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pytest

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneCheck, SceneVerdict
    from mitsuba_ref.report.validation import Validation
    from mitsuba_ref.subjects.subject import Subject

OPTION = "--mitsuba-ref"
REPORT = "mitsuba-ref-report"

VERDICT = "verdict"  # the scene as a whole: it loads, Mitsuba answers, and there is evidence
SUFFIXES = (".toml", ".json")
SCENE_MARKERS = ("[camera]", "[[shape]]", '"camera"', '"shape"')  # a file without any of them is no scene

# --mitsuba-ref-NAME and the ini option mitsuba_ref_NAME: help, the option's arguments, the type of the ini option.
OPTIONS: dict[str, tuple[str, dict[str, Any], Literal["args", "string"]]] = {
    "size": ("film in pixels, W H, instead of the scenes' own", {"nargs": 2, "metavar": ("W", "H")}, "args"),
    "candidate": (
        "another ray caster, judged in place of ours: package.module:function, or a command",
        {"metavar": "CANDIDATE"},
        "string",
    ),
    "candidate-serve": (
        "the same as a program that is started once and answers over stdin and stdout",
        {"metavar": "COMMAND"},
        "string",
    ),
    "candidate-precision": (
        "its arithmetic, float32 or float64; default: the type of what it returns",
        {"metavar": "PRECISION"},
        "string",
    ),
    "html": ("write a report for the browser on all judged scenes into this folder", {"metavar": "DIR"}, "string"),
}
CANDIDATE_OPTIONS = tuple(name for name in OPTIONS if name.startswith("candidate"))


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mitsuba-ref", "scenes judged against Mitsuba")
    group.addoption(
        OPTION,
        action="store_true",
        default=False,
        dest="mitsuba_ref",
        help="collect scene files, .toml and .json: a test for each check of each scene",
    )
    for name, (what, option, kind) in OPTIONS.items():
        group.addoption(f"--mitsuba-ref-{name}", default=None, help=f"{what}; also an ini option", **option)
        parser.addini(f"mitsuba_ref_{name.replace('-', '_')}", what, type=kind)
    folders = "folders beyond a scene's own whose meshes it may use"
    parser.addini("mitsuba_ref_mesh_dirs", folders, type="paths", default=[])


def pytest_configure(config: pytest.Config) -> None:
    if folder := given(config, "html"):
        config.pluginmanager.register(Report(config, config.invocation_params.dir / folder), REPORT)
    if config.getoption("mitsuba_ref"):
        if getattr(config.option, "dist", "no") in ("load", "worksteal"):
            config.option.dist = "loadfile"  # xdist keeps the tests of a scene in the process that judges it
        config.pluginmanager.register(ScenePlugin(config), "mitsuba-ref-scenes")


@pytest.fixture
def judge_caster(request: pytest.FixtureRequest) -> Callable[..., Validation]:
    """judge_caster(trace, scene, ...): fails the test, with the cause, if Mitsuba and exact arithmetic find it wrong.

    The arguments are those of mitsuba_ref.validate, such as builtin="triangles" or size=(64, 64); returns its verdict.
    """

    def judge(trace: Any, scene: Any = None, **options: Any) -> Validation:
        import mitsuba_ref
        from mitsuba_ref.report.verdict_text import short_text

        verdict = mitsuba_ref.validate(scene, candidate=trace, **options)
        if isinstance(report := request.config.pluginmanager.get_plugin(REPORT), Report):
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
            raise pytest.UsageError(f"mitsuba_ref_html: {error}") from None

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
    """Hooks of pytest, and the verdicts: each scene is judged once, whichever xdist worker runs its tests."""

    def __init__(self, config: pytest.Config) -> None:
        config.addinivalue_line("markers", "mitsuba_ref: a check of a scene, by --mitsuba-ref")
        self.config = config
        self.start = config.invocation_params.dir
        self.size = film_size(given(config, "size"))
        self.words = {name: given(config, name) or "" for name in CANDIDATE_OPTIONS}
        if self.words["candidate"] and self.words["candidate-serve"]:
            raise pytest.UsageError("mitsuba_ref_candidate: not together with mitsuba_ref_candidate_serve")
        self.candidate = self.words["candidate"] or self.words["candidate-serve"]
        if self.words["candidate-precision"] and not self.candidate:
            raise pytest.UsageError("mitsuba_ref_candidate_precision: expected mitsuba_ref_candidate beside it")
        self.mesh_dirs = tuple(map(str, config.getini("mitsuba_ref_mesh_dirs")))
        self.named = {Path(self.start, arg.split("::")[0]).resolve() for arg in config.args}
        self.verdicts: dict[Path, SceneVerdict | str] = {}
        self.files: list[Path] = []

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        if file_path.suffix.lower() not in SUFFIXES:
            return None
        if file_path.resolve() in self.named or is_scene(file_path):
            self.files.append(file_path)
            collector: SceneFile = SceneFile.from_parent(parent, path=file_path)
            collector.plugin = self
            return collector
        return None

    def pytest_report_header(self) -> str:
        film = f"films of {self.size[0]} x {self.size[1]}" if self.size else "the scenes' own films"
        about = f", candidate {self.candidate}" if self.candidate else ""
        return f"mitsuba-ref: {film}{about}"

    def verdict_of(self, path: Path) -> SceneVerdict | str:
        """The verdict, or what is wrong with the scene file."""
        if path not in self.verdicts:
            self.verdicts[path] = self._judge(path)
        return self.verdicts[path]

    def _judge(self, path: Path) -> SceneVerdict | str:
        from caster.cli.shared_arguments import display_names
        from caster.description.errors import SceneError
        from mitsuba_ref.report.html_report import page_record
        from mitsuba_ref.runner import many_scenes

        named = str(path.relative_to(self.start)) if path.is_relative_to(self.start) else str(path)
        given_options = *(("mesh-dir", folder) for folder in self.mesh_dirs), *self.words.items()
        words = tuple(word for name, value in given_options if value for word in (f"--{name}", value))
        entry = many_scenes.SceneEntry(path.stem, named, self.size, self.mesh_dirs, words)
        errors: list[Exception] = []
        report = self.config.pluginmanager.get_plugin(REPORT)
        try:
            options = many_scenes.JudgeOptions(subject=self.subject, page_of=page_record if report else None)
        except SceneError as error:
            return str(error)
        (verdict,) = many_scenes.run([entry], options, workers=1, on_error=errors.append)
        if isinstance(report, Report):
            report.add(verdict, dict(zip(self.files, display_names(list(map(str, self.files))), strict=True))[path])
        return str(errors[0]) if errors and isinstance(errors[0], SceneError | MemoryError) else verdict

    @cached_property
    def subject(self) -> Subject | None:
        """The candidate, if there is one. Raises SceneError for one that cannot be used."""
        from mitsuba_ref.subjects.requests import parse_candidate

        if not self.candidate:
            return None
        served = bool(self.words["candidate-serve"])
        return parse_candidate(self.candidate, self.words["candidate-precision"] or None, served=served)

    def check_names(self) -> tuple[str, ...]:
        """Names of the checks of pixels, then of the scene."""
        from mitsuba_ref.judge.checks import CANDIDATE, OURS, checks_of
        from mitsuba_ref.judge.classification import pixel_checks

        whose = CANDIDATE if self.candidate else OURS
        return (*pixel_checks(ours=whose == OURS), *(check.name for check in checks_of(whose) if check.scope != "run"))

    def run_names(self, path: Path) -> tuple[str, ...]:
        """Names of the checks that are made once a run, with its first scene."""
        from mitsuba_ref.judge.checks import CANDIDATE, checks_of

        made = self.candidate and path in self.files[:1]
        return tuple(check.name for check in checks_of(CANDIDATE, ["run"])) if made else ()

    @cached_property
    def run_checks(self) -> dict[str, SceneCheck]:
        """The checks that are made once a run."""
        from mitsuba_ref.judge.checks import run_checks

        return {check.name: check for check in run_checks(self.subject)}


def given(config: pytest.Config, name: str) -> Any:
    """The value of one of OPTIONS, from the command line or else from the ini file."""
    underscored = f"mitsuba_ref_{name.replace('-', '_')}"
    return config.getoption(underscored) or config.getini(underscored)


def film_size(words: list[str]) -> tuple[int, int] | None:
    """Width and height; None without words. Raises pytest.UsageError."""
    if not words:
        return None
    try:
        width, height = map(int, words)
    except ValueError:
        raise pytest.UsageError(f"mitsuba_ref_size: expected two whole numbers, W H, got {' '.join(words)}") from None
    return width, height


def is_scene(path: Path) -> bool:
    """Whether a file looks like a scene: pyproject.toml and package.json may lie in the same folder."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any(mark in text for mark in SCENE_MARKERS)


class CheckFailed(Exception):  # noqa: N818 - pytest shows its text alone
    """A check of a scene failed; str() is what the terminal shows."""


class SceneFile(pytest.File):
    """One scene."""

    plugin: ScenePlugin  # that collected it

    def collect(self) -> Iterator[CheckItem]:
        for name in (VERDICT, *self.plugin.check_names(), *self.plugin.run_names(self.path)):
            yield CheckItem.from_parent(self, name=name, plugin=self.plugin)


class CheckItem(pytest.Item):
    """One check of a scene."""

    def __init__(self, plugin: ScenePlugin, **about: Any) -> None:
        super().__init__(**about)
        self.plugin = plugin
        self.add_marker("mitsuba_ref")

    def runtest(self) -> None:
        plugin = self.plugin
        found = plugin.verdict_of(self.path)
        if self.name in plugin.run_names(self.path) and not (isinstance(found, str) or found.problem):
            check = plugin.run_checks.get(self.name)
            if check is None:
                pytest.skip(f"not judged: {plugin.candidate} is given no limits")
            if not check.ok:
                raise CheckFailed(f"FAIL  {check.name}: {check.what}")
        elif plugin.candidate and is_not_judged(found, self.name):
            pytest.skip(f"not judged: {plugin.candidate} does not give it, or it is no check of this scene")
        elif text := check_problem(found, self.name):
            from caster.system.terminal import printable

            raise CheckFailed(printable(text))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The failure's text, its first line in the summary; a traceback only for unexpected exceptions."""
        if not isinstance(excinfo.value, CheckFailed):
            return super().repr_failure(excinfo, style)
        shown: Any = excinfo.getrepr(style="value")
        if shown.reprcrash is not None:
            # the line of pytest's summary, which is not cut where CI is set
            shown.reprcrash.message = str(excinfo.value).partition("\n")[0]
        return shown

    def reportinfo(self) -> tuple[Path, None, str]:
        return self.path, None, f"{self.path.stem}: {self.name}"


def check_problem(found: SceneVerdict | str, check: str) -> str:
    """Why a check of a scene fails, as `validate` prints it; "" if it passes.

    found: the verdict, or why there is none.
    """
    if isinstance(found, str):
        return found if check == VERDICT else no_verdict(found)
    if found.problem and check != VERDICT:
        return no_verdict(f"FAIL  {found.name}  {found.problem}")
    from mitsuba_ref.report.verdict_text import check_failure, failure_text, pixel_failure

    if check == VERDICT:
        return "" if found.ok else failure_text(found)
    if not found.has_evidence and not found.failing:
        return no_verdict(failure_text(found))
    if found.failing_by.get(check):
        return pixel_failure(found, check)
    return "\n".join(check_failure(found, each) for each in found.checks if each.name == check and not each.ok)


def is_not_judged(found: SceneVerdict | str, check: str) -> bool:
    """Whether the verdict of a candidate leaves a check out; never if there is no verdict."""
    if isinstance(found, str) or found.problem or check == VERDICT:
        return False
    return check not in found.ratios and all(each.name != check for each in found.checks)


def no_verdict(why: str) -> str:
    """A check without a verdict fails; otherwise a run of `-k depth` would pass."""
    return f"{why.splitlines()[0]}\nThere is no verdict, so nothing was checked; the test {VERDICT} has the reason."
