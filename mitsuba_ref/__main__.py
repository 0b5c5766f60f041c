"""The program `mitsuba-ref`, whose commands are listed in mitsuba_ref/cli, and its supervisor.

A candidate that is a Python function may end the process that it runs in, or never answer, so another process
supervises it.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from caster.cli import application
from caster.system.process import DIFFERENCES, INTERRUPTED, MEANINGS, PIPE_CLOSED
from mitsuba_ref.cli import COMMANDS

ABOUT = "A judge of ray casters: compares them with Mitsuba 3, ray by ray, within derived bounds."
CODES = tuple(code for code in MEANINGS if code != PIPE_CLOSED)


# As in `caster`. NumPy starts OpenBLAS's threads when it is loaded; waiting for each other takes them longer than the
# judge's products of 3 x 3 matrices.
COLLECTION_THRESHOLDS = (50_000, 20, 20)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code. argv: default the words of this process, which may be supervised."""
    if argv is None and needs_supervision(sys.argv[1:]):
        return run_supervised(sys.argv[1:])
    if argv is None:  # this process runs nothing else
        gc.set_threshold(*COLLECTION_THRESHOLDS)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return application.main("mitsuba-ref", ABOUT, COMMANDS, CODES, argv)


# ---- the supervisor ----

SUPERVISED_VARIABLE = "MITSUBA_REF_SUPERVISED"  # in the environment of the supervised process
INTERRUPT_GRACE_SECONDS = 4.8  # for the scenes that are being judged to end and to be written
CHILD_SOURCE = (
    "import sys; sys.path[:] = {path!r}; from mitsuba_ref.__main__ import run_reporting_exit_code, main; "
    "run_reporting_exit_code({fd}, main)"
)


def needs_supervision(words: Sequence[str]) -> bool:
    """Whether this command line may run a candidate function in the judge's process."""
    if os.name != "posix" or SUPERVISED_VARIABLE in os.environ:
        return False
    has_candidate = any(word.partition("=")[0] in ("--candidate", "--candidate-rays") for word in words)
    return has_candidate and list(words[:1]) in (["validate"], ["probe"])


def run_supervised(words: Sequence[str]) -> int:
    """Run the command line in a child process and return the exit code that it reports; without a report it failed."""
    application.announce("mitsuba-ref", COMMANDS, words[0])
    reading, writing = os.pipe()
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD_SOURCE.format(path=sys.path, fd=writing), *words],
        env={**os.environ, SUPERVISED_VARIABLE: "1"},
        pass_fds=(writing,),
        process_group=0,  # so that an interruption from the terminal comes through this process
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
    how = f"exit {code}" if code >= 0 else f"by {signal.Signals(-code).name}"
    print(f"the candidate ended the process, {how}: nothing is judged", file=sys.stderr)
    return DIFFERENCES


def _wait(child: subprocess.Popen[bytes]) -> int | None:
    """Wait for the child's exit code, None if it was killed. Ctrl-C, SIGTERM and SIGHUP are passed on as SIGINT."""
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
    """Run the command line in the child, and write its exit code to fd before the process ends.

    sys.exit reaches `main`; os._exit and C's exit() end the process without a report. The code that the process ends
    with does not count, since exit handlers of the candidate may change it. Results go to standard output; everything
    else that is printed there, also from C, goes to standard error.
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


if __name__ == "__main__":
    sys.exit(main())
