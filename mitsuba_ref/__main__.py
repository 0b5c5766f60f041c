"""The program `mitsuba-ref`, whose commands are listed in mitsuba_ref/cli, and its supervisor.

A candidate that is a Python function may end the process that it runs in, or never answer, so another process
supervises it.
"""

import gc
import os
import signal
import sys
from collections.abc import Sequence

from caster.cli import application
from caster.system.process import DIFFERENCES, INTERRUPTED, MEANINGS, NOTHING_SELECTED, USAGE
from mitsuba_ref.cli import COMMANDS

ABOUT = "A judge of ray casters: compares them with Mitsuba 3, ray by ray, within derived bounds."
CODES = MEANINGS | {USAGE: "wrong usage, invalid scene or no Mitsuba", NOTHING_SELECTED: "nothing selected or judged"}


# As in `caster`. NumPy starts OpenBLAS's threads when it is loaded; waiting for each other takes them longer than the
# judge's products of 3 x 3 matrices.
COLLECTION_THRESHOLDS = (50_000, 20, 20)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code. argv: default the words of this process, which a fork may run."""
    if argv is None:  # this process runs nothing else
        if sys.stdout is None:  # closed, so that another file would get its descriptor
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            sys.stdout = os.fdopen(1, "w", closefd=False)
        gc.set_threshold(*COLLECTION_THRESHOLDS)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        if needs_supervision(sys.argv[1:]):
            return run_supervised(sys.argv[1:])
    return application.main("mitsuba-ref", ABOUT, COMMANDS, CODES, argv)


# ---- the supervisor ----

INTERRUPT_GRACE_SECONDS = 4.8  # for the scenes that are being judged to end and to be written


def needs_supervision(words: Sequence[str]) -> bool:
    """Whether this command line may run a candidate function in the judge's process."""
    if os.name != "posix":
        return False
    has_candidate = any(word.partition("=")[0] == "--candidate" for word in words)
    return has_candidate and list(words[:1]) in (["validate"], ["probe"])


def run_supervised(words: Sequence[str]) -> int:
    """Run the command line in a fork of this process, which has not loaded the candidate; the exit code.

    Ctrl-C, SIGTERM and SIGHUP interrupt the fork.
    """
    from caster.system.cluster import CallEnded
    from mitsuba_ref.runner.workers import Worker

    application.announce("mitsuba-ref", COMMANDS, words[0])
    for each in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(each) is not signal.SIG_IGN:
            signal.signal(each, signal.default_int_handler)
    fork, interrupted = Worker(daemon=False), False
    try:
        try:
            return fork.call(None, run_apart, (words,))
        except KeyboardInterrupt:
            interrupted = True
            fork.process.terminate()
        return fork.reply(INTERRUPT_GRACE_SECONDS)
    except (CallEnded, KeyboardInterrupt) as ended:
        if not interrupted and fork.process.exitcode != INTERRUPTED:
            many = words[0] == "validate" and not any(word.startswith("--engine") for word in words)
            hint = "\nwith --engine dask -j 1 it ends one scene, and the others are judged" if many else ""
            print(f"the candidate ended the process, and nothing is judged: {ended}{hint}", file=sys.stderr)
            return DIFFERENCES
        if fork.process.exitcode != INTERRUPTED:
            print("interrupted: the candidate did not end, and was killed", file=sys.stderr)
        return INTERRUPTED
    finally:
        fork.close()


def run_apart(words: Sequence[str]) -> int:
    """Run a command line in a fork.

    Results go to standard output; everything else that is printed there, also from C, goes to standard error.
    """
    out = sys.stdout
    with os.fdopen(os.dup(1), "w", 1 if out.isatty() else -1, encoding=out.encoding, errors=out.errors) as results:
        os.dup2(2, 1)
        sys.stdout = results
        return application.main("mitsuba-ref", ABOUT, COMMANDS, CODES, words)


if __name__ == "__main__":
    sys.exit(main())
