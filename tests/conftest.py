"""The run's header, which names optional software that was found, and a marker for each folder of tests."""

import collections
import contextlib
import gc
import importlib.util
import os
import shutil
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from caster.__main__ import COLLECTION_THRESHOLDS
from caster.system import process

TESTS = Path(__file__).parent
KINDS = {
    "unit": "one module at a time",
    "agreement": "two ways to the same bits: cullings, threads, Numba and plain Python",
    "exact": "against exact arithmetic",
    "reference": "asks Mitsuba, and fails without it",
    "isa": "Mitsuba limited to older instruction sets",
    "report": "looks at reports in a browser",
    "hostile": "broken and hostile inputs to every command",
}
# Mitsuba's own abort is planted with it, where a machine has it.
OLD_LLVM = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")
NAMED_IN_HEADER = ("numba", "mitsuba", "variants", "libLLVM")

# Of docs/recipes; the worked examples of docs/candidates need nothing and always run.
PEERS = ("open3d", "embreex")
NO_PEER = "is not installed, its example of docs/recipes is not tested"


NO_CC = "none: Mitsuba is not limited to older instruction sets, no example in C is tested (apt install gcc libc6-dev)"

NO_CHROMIUM = "no Chromium: tests/report is skipped where it opens pages (apt install chromium)"


def pytest_configure(config: pytest.Config) -> None:
    settings.register_profile("same examples", derandomize=True, deadline=None)  # a red run can be repeated
    settings.load_profile("same examples")
    os.environ["MITSUBA_REF_STORE"] = "off"  # answers of other runs are no evidence here
    # Without bytecode each of some hundred processes that tests start would compile every module that it loads.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False  # what pytest makes of the tests themselves, too
    # Ignored, as in a job in the background or under nohup, they would be ignored by the children of tests, too.
    for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)
    for kind, what in KINDS.items():
        config.addinivalue_line("markers", f"{kind}: {what} (everything in tests/{kind})")


def pytest_report_header() -> list[str]:
    """What is missing is named here: no test is skipped for it in silence."""
    from caster.cli.installation import report
    from mitsuba_ref.cli.doctor import judge_findings

    found = {finding.name: finding for finding in [*report(), *judge_findings()]}
    old = OLD_LLVM if OLD_LLVM.exists() else "none: an abort of Mitsuba's own is not tested, a synthetic one is"
    peers = ", ".join(f"{name} {'found' if importlib.util.find_spec(name) else NO_PEER}" for name in PEERS)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), NO_CHROMIUM)
    return [
        *(f"{name}: {found[name].detail}" for name in NAMED_IN_HEADER),
        f"libLLVM that aborts: {old}",
        f"cc: {shutil.which('cc') or NO_CC}",
        f"peers: {peers}",
        f"reports: {chromium}",
    ]


def pytest_collection_finish() -> None:
    """What stays to the end, thousands of tests among it, is searched for circles of objects no more."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECTION_THRESHOLDS)


@pytest.hookimpl(tryfirst=True)  # before -m chooses by the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    keep_some_cases(items)
    for item in items:
        folder = item.path.relative_to(TESTS).parts[0] if item.path.is_relative_to(TESTS) else ""
        if folder in KINDS:
            item.add_marker(folder)


@pytest.fixture
def warm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard error is as it is once kernels are compiled, also in the first run after an edit."""
    monkeypatch.setattr("caster.system.terminal.compilation_reported", contextlib.nullcontext)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def keep_some_cases(items: list[pytest.Item]) -> None:
    """Take the mark `slow` from the cases that `make test` runs."""
    seen: collections.Counter[tuple[Path, str]] = collections.Counter()
    for item in items:
        mark = item.get_closest_marker("slow")
        if mark is None:
            continue
        assert mark.args and isinstance(mark.args[0], str), f"{item.nodeid}: slow without a reason"
        test = (item.path, item.nodeid.partition("[")[0])
        seen[test] += 1
        keep, every = (mark.kwargs.get(name, 0) for name in ("keep", "every"))
        if seen[test] <= keep or (every and seen[test] % every == 1):
            item.own_markers.remove(mark)


@pytest.fixture(autouse=True)
def whole_messages(monkeypatch):
    """Errors in one line, so that tests match them whole; tests/reference/test_command_mistakes.py has them folded."""
    monkeypatch.setattr(process, "folded", str)
