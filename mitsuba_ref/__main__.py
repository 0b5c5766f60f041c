"""The command `mitsuba-ref`, whose commands are listed in mitsuba_ref/cli, and its supervisor.

A candidate that is a Python function may end the process it runs in, or never answer: another process supervises it.
"""

from __future__ import annotations

import argparse
import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from caster.cli import application
from caster.system.process import DIFFERENCES, INTERRUPTED, MEANINGS, PIPE_CLOSED
from mitsuba_ref.cli import COMMANDS

ABOUT = "A judge of ray casters: compares them with Mitsuba 3, ray by ray, within derived bounds."
CODES = tuple(code for code in MEANINGS if code != PIPE_CLOSED)


# As of `caster`; NumPy starts OpenBLAS's threads as it is loaded, and they wait for each other longer than the judge's
# products of 3 x 3 numbers take.
COLLECTION_THRESHOLDS = (50_000, 20, 20)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code. argv: default those of this process, which may need a supervisor."""
    if argv is None and needs_supervision(sys.argv[1:]):
        return run_supervised(sys.argv[1:])
    if argv is None:  # and so this process runs nothing else
        gc.set_threshold(*COLLECTION_THRESHOLDS)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return application.main("mitsuba-ref", ABOUT, COMMANDS, CODES, argv)


# ---- the supervisor ----

SUPERVISED_VARIABLE = "MITSUBA_REF_SUPERVISED"  # in the environment of the one that is looked after
INTERRUPT_GRACE_SECONDS = 4.8  # for the scenes that are being judged to end, and to be written down
CHILD_SOURCE = (
    "import sys; sys.path[:] = {path!r}; from mitsuba_ref.__main__ import run_reporting_exit_code, main; "
    "run_reporting_exit_code({fd}, main)"
)


def needs_supervision(words: Sequence[str]) -> bool:
    """Whether this command line may run a candidate function in the process of the judge."""
    if os.name != "posix" or SUPERVISED_VARIABLE in os.environ:
        return False
    has_candidate = any(word.partition("=")[0] in ("--candidate", "--candidate-rays") for word in words)
    return has_candidate and list(words[:1]) in (["validate"], ["probe"])


def run_supervised(words: Sequence[str]) -> int:
    """The exit code that the command line reports, run in a child; one that ends without a report has failed."""
    began = time.time()
    application.announce("mitsuba-ref", COMMANDS, words[0])
    reading, writing = os.pipe()
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD_SOURCE.format(path=sys.path, fd=writing), *words],
        env={**os.environ, SUPERVISED_VARIABLE: "1"},
        pass_fds=(writing,),
        process_group=0,  # so that an interruption from the terminal comes by way of this process
    )
    os.close(writing)
    code = _wait(child)
    os.set_blocking(reading, False)  # what the child started may still hold the other end
    with os.fdopen(reading, "rb") as pipe:
        report = pipe.read() or b""
    if code is None:
        print("interrupted: the candidate did not end, and was killed", file=sys.stderr)
        return int(report or INTERRUPTED)
    if report or code == INTERRUPTED:
        return int(report or code)
    for path in output_paths(words):  # of an earlier run: they would pass for this one's
        if path.is_file() and path.stat().st_mtime < began:
            path.unlink()
    how = f"exit {code}" if code >= 0 else f"by {signal.Signals(-code).name}"
    print(f"the candidate ended the process, {how}: nothing is judged", file=sys.stderr)
    return DIFFERENCES


def _wait(child: subprocess.Popen[bytes]) -> int | None:
    """The exit code of the child, None if it was killed. Ctrl-C, SIGTERM and SIGHUP are passed on as SIGINT."""
    for each in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(each) is not signal.SIG_IGN:
            signal.signal(each, signal.default_int_handler)
    try:
        return child.wait()
    except KeyboardInterrupt:
        child.send_signal(signal.SIGINT)
    try:
        return child.wait(INTERRUPT_GRACE_SECONDS)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        return None


def run_reporting_exit_code(fd: int, main: Callable[[Sequence[str]], int]) -> NoReturn:
    """The command line of this process, in the child; its exit code goes through fd before the process ends.

    sys.exit reaches `main`; os._exit and C's exit() end the process before its code is reported. The code that the
    process ends with does not count: what the candidate left for the end of the process may change it. Results go to
    standard output; what others print there, also from C, goes to standard error.
    """
    out = sys.stdout
    results = os.fdopen(os.dup(1), "w", 1 if out.isatty() else -1, encoding=out.encoding, errors=out.errors)
    os.dup2(2, 1)
    sys.stdout = results
    code = main(sys.argv[1:])
    os.write(fd, b"%d" % code)
    sys.stdout = sys.__stdout__
    results.close()
    sys.exit(code)


def output_paths(words: Sequence[str]) -> Iterator[Path]:
    """The verdict files that this command line names; a pixel's goes to standard output."""
    if list(words[:1]) != ["validate"]:
        return
    parser = argparse.ArgumentParser(add_help=False)
    for option in ("--json", "--junit", "--out"):
        parser.add_argument(option)
    options, _ = parser.parse_known_args(list(words))
    yield from (Path(path) for path in (options.json, options.junit) if path)
    if options.out:
        yield Path(options.out) / "verdict.json"


if __name__ == "__main__":
    sys.exit(main())
