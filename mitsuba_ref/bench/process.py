"""The other end of worker.py: a contestant that may fail, die or hang, which is then its result."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any

from mitsuba_ref.bench.work import Work
from mitsuba_ref.bench.worker import READY
from mitsuba_ref.child import ANSI, HOME

LAST_WORDS = 300  # characters kept of what a contestant said before it died
ENDED = 5.0  # seconds for a process that closed its pipe to be gone
WORKER = (sys.executable, "-P", "-m", "mitsuba_ref.bench.worker")


class Gone(Exception):  # noqa: N818 - an end, perhaps nobody's mistake
    """A contestant that does not go on; str() says why, in a line."""


class Process:
    """One contestant. Close it, or it stays."""

    def __init__(
        self, work: Work, environment: Mapping[str, str] | None = None, command: Sequence[str] = WORKER
    ) -> None:
        self.words_file = tempfile.TemporaryFile(mode="w+b")  # noqa: SIM115 - it lives as long as the process
        self.replies, writing = os.pipe()
        self.process = subprocess.Popen(
            [*command, str(writing), work.to_json()],
            stdin=subprocess.PIPE,
            stdout=self.words_file,
            stderr=subprocess.STDOUT,
            pass_fds=(writing,),
            env={**os.environ, **(environment or {}), "PYTHONPATH": str(HOME)},
            cwd=tempfile.gettempdir(),
            start_new_session=True,  # Ctrl-C is for this process, which then stops that one
        )
        os.close(writing)

    def ask(self, patience: float, **question: Any) -> dict[str, Any]:
        """What comes of {"do": ...}, within so many seconds. Raises Gone; the process is then gone, too."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write((json.dumps(question) + "\n").encode())
            self.process.stdin.flush()
        except BrokenPipeError:
            raise Gone(self._end()) from None
        ready, _, _ = select.select([self.replies], [], [], patience)
        if not ready:
            self.close()
            raise Gone(f"no answer within {patience:g} s")
        line = os.read(self.replies, 65536).decode()
        if not line:
            raise Gone(self._end())
        try:
            reply: dict[str, Any] = json.loads(line)
        except ValueError:
            self.close()
            raise Gone(f"answered in no way that was expected: {line[:LAST_WORDS]!r}") from None
        if reply["status"] != READY:
            self.close()
            raise Gone(reply["why"])
        return reply

    def _end(self) -> str:
        """How it ended: a signal or an exit code, and its last line."""
        try:
            code = self.process.wait(ENDED)
        except subprocess.TimeoutExpired:
            code = -signal.SIGKILL
        self.words_file.seek(0)
        words = ANSI.sub("", self.words_file.read().decode("utf-8", "replace")).strip().splitlines()
        self.close()
        end = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return ": ".join(["died", end, *(words[-1:] or [])])[:LAST_WORDS]

    def close(self) -> None:
        """Kill it and close all that led to it; again does nothing."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        if self.replies < 0:
            return
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # a question that it never read
            self.process.stdin.close()
        os.close(self.replies)
        self.replies = -1
        self.words_file.close()
