"""Tests run in a fork of this process, in a copy of the tree: to measure what they execute, or to try a mutant.

The process loads the libraries once; the packages under test and the tests are loaded by each fork from its tree, so
that constants of a module and what others import from it are the mutant's as well. Edits of the caster run without the
compiler: plain Python runs the same source, and an edit costs no compilation. Edits of the judge run beside the caster
as it is compiled. Mitsuba's answers are kept by the bytes of the request.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import pytest

PACKAGES = ("caster", "mitsuba_ref")
LIBRARIES = ("numpy.ma", "numpy.random", "numpy.typing", "pydantic.main", "pydantic.json_schema", "hypothesis", "PIL")
OPTIONS = (
    "-q",
    "-q",
    "--no-header",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:xdist",
    "-W",
    "ignore::pytest.PytestAssertRewriteWarning",
)
MEMORY_BYTES = 10**9  # of stored answers of Mitsuba
MEMORY_LIMIT = 6 << 30  # bytes of address space; an edit may make a loop that allocates for ever
# A function's lines are recorded until so many calls in a row, or steps of one call, have shown no new line.
QUIET_CALLS, QUIET_STEPS = 40, 400


class Ended(NamedTuple):
    """How a fork ended."""

    code: int  # pytest's; negative: the signal
    seconds: float  # CPU of the fork and its children
    report: dict[str, str]  # of the first failure: test, what


def in_fork(tree: Path, files: Sequence[str], plugin: Any, cpu: float, report: Path) -> Ended:
    """pytest on these files in a fork; killed after `cpu` seconds of CPU or four times as many of the clock."""
    report.unlink(missing_ok=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = os.fork()
    if child == 0:
        code = 99
        try:
            code = _in_child(tree, files, plugin, cpu)
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what the tests left behind
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    try:
        first = json.loads(report.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        first = {}
    return Ended(code, seconds, first)


def _in_child(tree: Path, files: Sequence[str], plugin: Any, cpu: float) -> int:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu) + 1, int(cpu) + 2))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    signal.setitimer(signal.ITIMER_REAL, 4.0 * cpu + 10.0)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)
    os.chdir(tree)
    os.environ["PYTHONPATH"] = str(tree)
    sys.path.insert(0, str(tree))
    return int(pytest.main([*OPTIONS, *plugin.options, "--rootdir", str(tree), *files], plugins=[plugin, Determined()]))


def load_libraries() -> None:
    for name in LIBRARIES:
        importlib.import_module(name)
    loaded = [name for name in sys.modules if name.partition(".")[0] in PACKAGES]
    assert not loaded, f"a fork would not take these from its tree: {loaded}"


class Determined:
    """The same examples of Hypothesis in each run, and no limit of time for one."""

    def pytest_configure(self, config: pytest.Config) -> None:
        from hypothesis import HealthCheck, settings

        settings.register_profile(
            "mutants", derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
        )
        settings.load_profile("mutants")
        if Path("tests/reference").is_dir():
            remember_mitsuba(Path(os.environ["MUTANTS_MEMORY"]))


def remember_mitsuba(memory: Path) -> None:
    """Store Mitsuba's answers in a folder, whichever way requests are sent."""
    from mitsuba_ref.reference import mitsuba_process
    from mitsuba_ref.reference.messages import TraceResponse
    from mitsuba_ref.reference.store import StoreFolder

    store, resident = StoreFolder(memory, MEMORY_BYTES), mitsuba_process.ask_resident

    def ask(request: Any, timeout: float) -> Any:
        key = mitsuba_process.request_key(request)
        if (content := store.get(key)) is not None:
            return TraceResponse.from_bytes(content, len(request.o))
        answer = resident(request, timeout)
        if isinstance(answer, TraceResponse):
            store.put(key, answer.to_bytes())
        return answer

    mitsuba_process.ask_resident = ask  # this process keeps answers


class Chosen:
    """Runs only these tests, in this order, up to the first failure, which is written to a file."""

    options = ("-x",)

    def __init__(self, tests: Sequence[str], report: Path) -> None:
        self.order, self.report = {test: i for i, test in enumerate(tests)}, report

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((i for i in items if i.nodeid in self.order), key=lambda item: self.order[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._write(report.nodeid, str(report.longreprtext))

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._write(f"import of {report.nodeid}", str(report.longreprtext))

    def _write(self, test: str, text: str) -> None:
        last = [line for line in text.splitlines() if line.startswith("E ")]
        what = (last or text.splitlines() or [""])[0].lstrip("E ").strip()
        if not self.report.exists():
            self.report.write_text(json.dumps({"test": test, "what": what[:200]}), encoding="utf-8")


def _give_up(number: int, frame: FrameType | None) -> None:
    pytest.fail("slower than what is used")


class Measured:
    """Writes a line of JSON for each test that passes: its CPU seconds and the lines of the packages it executes."""

    options = ()

    def __init__(self, tree: Path, out: Path, slowest: float) -> None:
        self.out, self.slowest = out, slowest  # CPU seconds, after which a test is given up
        self.prefixes = tuple(f"{tree}/{package}/" for package in PACKAGES)
        self.skip = len(str(tree)) + 1
        self.lines: set[tuple[str, int]] = set()
        self.quiet: dict[CodeType, int] = {}  # calls of a function since its last new line
        self.shared: set[tuple[str, int]] = set()  # by fixtures that may serve later tests as well
        self.passed = False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.lines, self.quiet, self.passed = set(), {}, False
        start = time.process_time() + sum(os.times()[2:4])
        signal.signal(signal.SIGPROF, _give_up)
        signal.setitimer(signal.ITIMER_PROF, self.slowest)
        sys.settrace(self._call)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            seconds = time.process_time() + sum(os.times()[2:4]) - start
            if self.passed:
                files: dict[str, list[int]] = {}
                for name, line in sorted(self.lines | self.shared):
                    files.setdefault(name[self.skip :], []).append(line)
                with self.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"test": item.nodeid, "seconds": seconds, "lines": files}) + "\n")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "setup":
            self.shared |= self.lines
        if report.when == "call":
            self.passed = report.passed

    def _call(self, frame: FrameType, event: str, arg: Any) -> Any:
        code = frame.f_code
        quiet = self.quiet.get(code, 0)
        if quiet > QUIET_CALLS:
            return None
        name = code.co_filename
        if not name.startswith(self.prefixes):
            self.quiet[code] = QUIET_CALLS + 1
            return None
        self.quiet[code] = quiet + 1
        lines, steps = self.lines, 0

        def line(frame: FrameType, event: str, arg: Any) -> Any:
            nonlocal steps
            place, steps = (name, frame.f_lineno), steps + 1
            if place not in lines:
                lines.add(place)
                self.quiet[code] = steps = 0
            elif steps > QUIET_STEPS:
                frame.f_trace_lines = False
            return line

        return line(frame, event, arg)
