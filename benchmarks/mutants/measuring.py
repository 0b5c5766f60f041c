"""A pytest plugin: which functions of the packages each test executes, and Mitsuba's answers kept between processes.

    MUTANTS_MEMORY=FOLDER [MUTANTS_OUT=FILE] python -m pytest -p mutants.measuring

Mitsuba's answers are kept in FOLDER by the bytes of the request, whichever way requests are sent. With FILE, a line of
JSON is appended to it for each test that passes in time.
"""

import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

PACKAGES = ("caster", "mitsuba_ref")
SLOWEST_TEST_S = 4.0  # CPU seconds, calls recorded, after which a test is given up: it is not used
MEMORY_BYTES = 10**9  # of stored answers of Mitsuba


def pytest_configure(config: pytest.Config) -> None:
    if Path("tests/reference").is_dir():
        remember_mitsuba(Path(os.environ["MUTANTS_MEMORY"]))
    if out := os.environ.get("MUTANTS_OUT"):
        config.pluginmanager.register(Measured(Path(out)))


def remember_mitsuba(memory: Path) -> None:
    """Store Mitsuba's answers in a folder."""
    from mitsuba_ref.reference import mitsuba_process
    from mitsuba_ref.reference.messages import TraceRequest, TraceResponse, message_of
    from mitsuba_ref.reference.store import StoreFolder

    store, resident = StoreFolder(memory, MEMORY_BYTES), mitsuba_process.ask_resident

    def ask(request: Any, timeout: float) -> Any:
        if not isinstance(request, TraceRequest):
            return resident(request, timeout)
        key = mitsuba_process.request_key(request)
        if (content := store.get(key)) is not None:
            return message_of(content)
        answer = resident(request, timeout)
        if isinstance(answer, TraceResponse):
            store.put(key, answer.to_bytes())
        return answer

    mitsuba_process.ask_resident = ask


class Measured:
    """Writes the CPU seconds of each test and the functions it calls, as "module function"."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.called: set[CodeType] = set()
        self.shared: set[CodeType] = set()  # by fixtures that may serve later tests as well
        self.passed = False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.called, self.passed = set(), False
        start = cpu_seconds()
        signal.signal(signal.SIGPROF, lambda *_: pytest.fail("slower than what is used"))
        signal.setitimer(signal.ITIMER_PROF, SLOWEST_TEST_S)
        sys.settrace(self._call)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            functions = sorted(filter(None, map(function_name, self.called | self.shared)))
            if self.passed and functions:
                row = {"test": item.nodeid, "seconds": cpu_seconds() - start, "functions": functions}
                with self.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "setup":
            self.shared |= self.called
        if report.when == "call":
            self.passed = report.passed

    def _call(self, frame: FrameType, event: str, arg: Any) -> None:
        self.called.add(frame.f_code)


def cpu_seconds() -> float:
    """Of this process and its children."""
    return sum(os.times()[:4])


def function_name(code: CodeType) -> str:
    """The module's path and the name in it; "" for code of no package."""
    path = os.path.relpath(code.co_filename)
    name = code.co_qualname.replace(".<locals>", "")
    return f"{path} {name}" if path.split(os.sep)[0] in PACKAGES else ""
