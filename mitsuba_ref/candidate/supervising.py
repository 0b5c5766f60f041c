"""A candidate that is a Python function may end the process it runs in, or never answer: another one looks after it."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from caster.exits import DIFFERENCES, INTERRUPTED

MARK = "MITSUBA_REF_SUPERVISED"  # in the environment of the one that is looked after
PATIENCE = (
    20.0  # seconds for the scenes that are being judged to end, and to be written down, after an interruption
)
# sys.exit is heard by `main`; os._exit and C's exit() end the process before its code is told. What it exits with does
# not count: what the candidate left for the end of the process may change that.
SOURCE = (
    "import os, sys; sys.path[:] = {path!r}; from mitsuba_ref.__main__ import main; code = main(sys.argv[1:]); "
    "os.write({fd}, b'%d' % code); sys.exit(code)"
)


def wanted(words: Sequence[str]) -> bool:
    """Whether this command line may run somebody's function in the process of the judge."""
    if os.name != "posix" or MARK in os.environ:
        return False
    return list(words[:1]) == ["validate"] and any(word.startswith("--cand") for word in words)  # or in short


def run(words: Sequence[str]) -> int:
    """The exit code of the command line, run in a child; one that ends without a word has failed."""
    began = time.time()
    receive, send = os.pipe()
    child = subprocess.Popen(
        [sys.executable, "-c", SOURCE.format(path=sys.path, fd=send), *words],
        env=os.environ | {MARK: "1"},
        pass_fds=(send,),
        process_group=0,  # so that an interruption from the terminal comes by way of this process
    )
    os.close(send)
    try:
        code = _code_of(child)
    finally:
        os.set_blocking(receive, False)  # what the candidate began may still hold the other end
        with os.fdopen(receive, "rb") as pipe:
            told = pipe.read()
    if told or code == INTERRUPTED:
        return int(told or code)
    for path in outputs(words):  # of an earlier run: they would pass for this one's
        if path.is_file() and path.stat().st_mtime < began:
            path.unlink()
    print(f"the candidate ended the process, exit {code}: nothing is judged", file=sys.stderr)
    return DIFFERENCES


def _code_of(child: subprocess.Popen[bytes]) -> int:
    """Wait for it. An interruption is handed on; one that does not end after it is killed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return child.wait()
    except KeyboardInterrupt:
        child.send_signal(signal.SIGINT)
    try:
        return child.wait(PATIENCE)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        print("interrupted: the candidate did not end, and was killed", file=sys.stderr)
        return INTERRUPTED


def outputs(words: Sequence[str]) -> Iterator[Path]:
    """The verdicts that this command line asks for."""
    parser = argparse.ArgumentParser(add_help=False)
    for option in ("--json", "--junit", "--out"):
        parser.add_argument(option)
    asked, _ = parser.parse_known_args(list(words))
    yield from (Path(path) for path in (asked.json, asked.junit) if path)
    if asked.out:
        yield Path(asked.out) / "verdict.json"
