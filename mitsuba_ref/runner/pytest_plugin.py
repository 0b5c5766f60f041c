"""pytest --mitsuba-ref scenes/: each scene is a test; and a fixture that judges a caster in any test.

Without the option and the fixture, nothing is collected or loaded. Entry point `mitsuba-ref` of the group pytest11.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneVerdict
    from mitsuba_ref.report.validation import Validation

OPTION = "--mitsuba-ref"
REPORT = "mitsuba-ref-report"

VERDICT = "verdict"  # the name of a scene's test
# A file without any of them is no scene: pyproject.toml and package.json may lie in the same folder.
SCENE_MARKERS = ("[camera]", "[[shape]]", '"camera"', '"shape"')


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mitsuba-ref", "scenes judged against Mitsuba")
    group.addoption(
        OPTION,
        action="store_true",
        default=False,
        dest="mitsuba_ref",
        help="collect scene files, .toml and .json: each is a test",
    )
    film = "film in pixels, W H, instead of the scenes' own"
    group.addoption(f"{OPTION}-size", nargs=2, type=int, metavar=("W", "H"), help=film)
    candidate = "another ray caster, judged in place of ours: package.module:function, or a command"
    group.addoption(f"{OPTION}-candidate", metavar="CANDIDATE", help=candidate)
    page = "write a report for the browser on all judged scenes into this folder"
    group.addoption(f"{OPTION}-html", metavar="DIR", help=page)


def pytest_configure(config: pytest.Config) -> None:
    if folder := config.getoption(f"{OPTION}-html"):
        config.pluginmanager.register(Report(config, config.invocation_params.dir / folder), REPORT)
    if config.getoption("mitsuba_ref"):
        config.pluginmanager.register(ScenePlugin(config))


@pytest.fixture
def judge_caster(request: pytest.FixtureRequest) -> Callable[..., Validation]:
    """judge_caster(trace, scene, ...): fails the test, with the cause, if Mitsuba and exact arithmetic find it wrong.

    The arguments are those of mitsuba_ref.validate, such as builtin="triangles" or size=(64, 64); returns its verdict.
    """

    def judge(trace: Any, scene: Any = None, **options: Any) -> Validation:
        return judged(request.config, request.node.name, scene, candidate=trace, **options)

    return judge


def judged(config: pytest.Config, test: str, scene: Any, **options: Any) -> Validation:
    """The verdict of mitsuba_ref.validate, in the report if there is one; fails the test if it is not ok."""
    import mitsuba_ref
    from caster.system.terminal import printable
    from mitsuba_ref.report.verdict_text import short_text

    verdict = mitsuba_ref.validate(scene, **options)
    if report := config.pluginmanager.get_plugin(REPORT):
        for found in verdict.scenes:
            report.add(found, f"{test} {found.name}")
    if not verdict.ok:
        pytest.fail(printable(short_text(verdict)), pytrace=False)
    return verdict


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
    """Collects scenes."""

    def __init__(self, config: pytest.Config) -> None:
        self.named = {Path(config.invocation_params.dir, arg.split("::")[0]).resolve() for arg in config.args}

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        if file_path.suffix.lower() not in (".toml", ".json") or not os.access(file_path, os.R_OK):
            return None
        text = file_path.read_text(encoding="utf-8", errors="replace")
        if file_path.resolve() in self.named or any(mark in text for mark in SCENE_MARKERS):
            return SceneFile.from_parent(parent, path=file_path)
        return None


class SceneFile(pytest.File):
    """The file of a scene."""

    def collect(self) -> Iterator[SceneTest]:
        yield SceneTest.from_parent(self, name=VERDICT)


class SceneTest(pytest.Item):
    """The test of one scene."""

    def runtest(self) -> None:
        from caster.description.errors import SceneError
        from caster.system.terminal import printable

        size, candidate = (self.config.getoption(f"{OPTION}-{name}") for name in ("size", "candidate"))
        path = os.path.relpath(self.path, self.config.invocation_params.dir)
        try:
            judged(self.config, path, path, candidate=candidate, size=size and tuple(size))
        except SceneError as error:
            pytest.fail(printable(str(error)), pytrace=False)
