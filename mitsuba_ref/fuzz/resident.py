"""Mitsuba in a child process that stays: starting one takes ten times as long as a small scene.

It may die at any scene; then that scene has a Crash for an answer, and the next one gets a new child.
"""

import contextlib
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT

DONE, REFUSED, DIED, TIMEOUT = "done", "refused", "", "timeout"  # what comes of a scene
LAST_WORDS = 3000  # characters kept of what Mitsuba said
START = 60.0  # seconds allowed for importing Mitsuba, beside the time of the first scene
ENDED = 5.0  # seconds for a child that closed its pipe to be gone


class Resident:
    """Asks one child of one variant after another scene; usable as a context."""

    def __init__(self) -> None:
        self._children: dict[str, Child] = {}

    def __enter__(self) -> "Resident":
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children.values():
            child.stop()
        self._children = {}

    def send(self, job: TraceRequest, timeout: float = 60.0) -> TraceResponse | Crash:
        """The answer, in the terms of mitsuba_ref.reference.session.send_request."""
        child = self._children.get(job.variant)
        if child is None or not child.alive:
            child = self._children[job.variant] = Child(job.variant)
        start = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as name:
            job.write(Path(name))
            reply = child.put(name, timeout)
            seconds = time.monotonic() - start
            if reply == DONE:
                try:
                    return TraceResponse.read(Path(name), len(job.o))
                except ValueError as error:
                    return Crash("garbage", f"{child.words}\n{error}".strip(), "exit code 0", seconds)
            if reply == REFUSED:
                return Crash("error", child.words, "exit code 1", seconds)
        return child.crash(reply, timeout, seconds)


class Child:
    """One process: a folder in on its stdin, a word out on a pipe of its own; what it prints goes to a file."""

    def __init__(self, variant: str) -> None:
        self.words_file = tempfile.TemporaryFile(mode="w+b")  # noqa: SIM115 - it lives as long as the child
        self.replies, writing = os.pipe()
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mitsuba_ref.fuzz.resident", str(writing)],
            stdin=subprocess.PIPE,
            stdout=self.words_file,
            stderr=subprocess.STDOUT,
            pass_fds=(writing,),
            env={**os.environ, **variants.environment_for(variant), "PYTHONPATH": str(PACKAGE_PARENT)},
            cwd=tempfile.gettempdir(),
            start_new_session=True,  # Ctrl-C is for this process, which then stops that one
        )
        os.close(writing)
        self.patience = START

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    @property
    def words(self) -> str:
        self.words_file.seek(0)
        return self.words_file.read().decode("utf-8", "replace")[-LAST_WORDS:].strip()

    def put(self, folder: str, timeout: float) -> str:
        """DONE or REFUSED; DIED; TIMEOUT if it had to be killed."""
        assert self.process.stdin is not None
        self.words_file.truncate(0)
        try:
            self.process.stdin.write(f"{folder}\n".encode())
            self.process.stdin.flush()
        except BrokenPipeError:
            return DIED
        ready, _, _ = select.select([self.replies], [], [], timeout + self.patience)
        if not ready:
            self._kill()
            return TIMEOUT
        self.patience = 0.0
        return os.read(self.replies, 64).decode().strip()

    def crash(self, reply: str, timeout: float, seconds: float) -> Crash:
        """What a child that gave no answer died of."""
        try:
            code = self.process.wait(ENDED)
        except subprocess.TimeoutExpired:
            code = -signal.SIGKILL
        words = self.words
        self.stop()
        if reply == TIMEOUT:
            return Crash("timeout", words, f"killed after {timeout:g} s", seconds)
        kind = "abort" if code == -signal.SIGABRT else "signal" if code < 0 else "error"
        end = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return Crash(kind, words, end, seconds)

    def stop(self) -> None:
        """Kill it and close all that led to it."""
        self._kill()
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # a folder that it never read
            self.process.stdin.close()
        if self.replies >= 0:
            os.close(self.replies)
            self.replies = -1
        self.words_file.close()

    def _kill(self) -> None:
        with contextlib.suppress(
            ProcessLookupError, PermissionError
        ):  # gone; macOS calls that a PermissionError
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def serve(replies: int) -> None:
    """The child's side: answer folder after folder until stdin ends."""
    from mitsuba_ref.reference import mitsuba_process  # here, so that asking needs no Mitsuba in this process

    for line in sys.stdin:
        folder = Path(line.rstrip("\n"))
        try:
            mitsuba_process.trace_request(TraceRequest.read(folder)).write(folder)
            reply = DONE
        except (RuntimeError, ImportError) as refusal:
            print(refusal, file=sys.stderr, flush=True)
            reply = REFUSED
        os.write(replies, f"{reply}\n".encode())


if __name__ == "__main__":
    serve(int(sys.argv[1]))
