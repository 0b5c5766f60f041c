"""A copy of both packages with some lines edited, and commands that run in it."""

import compileall
import functools
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from programs import ROOT, python

PACKAGES = ("caster", "mitsuba_ref")
DEADLINE = 300.0  # seconds; no command needs more than 20, on a machine that does nothing else
SERVER = (sys.executable, "-P", str(Path(__file__).with_name("forked_runs.py")))


@functools.cache
def write_bytecode(tree: Path) -> None:
    """Compile every module of a tree, so that processes that load a copy need not."""
    for package in PACKAGES:
        compileall.compile_dir(tree / package, quiet=2)


def copy_tree(folder: Path, source: Path = ROOT) -> Path:
    """caster/ and mitsuba_ref/ side by side in `folder`, with bytecode."""
    write_bytecode(source)
    for package in PACKAGES:
        shutil.copytree(source / package, folder / package)
    return folder


def edit(tree: Path, file: str, old: str, new: str) -> None:
    """Replace a text that occurs exactly once; anything else is an error of the edit."""
    path = tree / file
    source = path.read_text(encoding="utf-8")
    assert source.count(old) == 1, f"{file}: expected once, found {source.count(old)} times: {old!r}"
    path.write_text(source.replace(old, new), encoding="utf-8")
    Path(importlib.util.cache_from_source(path)).unlink(missing_ok=True)


def run(tree: Path, *argv: str, module: str = "mitsuba_ref") -> subprocess.CompletedProcess[str]:
    """A command of the copy, without the compiler: a kernel that changed would have to be compiled anew.

    With it where no kernel did: in this tree, and where the environment sets CASTER_JIT.
    """
    return _run(str(tree), *argv, module=module, compiled=tree == ROOT)


def run_with(plugins: Path, *argv: str, module: str = "mitsuba_ref") -> subprocess.CompletedProcess[str]:
    """A command of this tree, with the distributions that are installed in the folder `plugins`."""
    return _run(os.pathsep.join([str(plugins), str(ROOT)]), *argv, module=module)


def _run(path: str, *argv: str, module: str, compiled: bool = False) -> subprocess.CompletedProcess[str]:
    jit = os.environ.get("CASTER_JIT", "1" if compiled else "0")
    return python("-P", "-m", module, *argv, PYTHONPATH=path, CASTER_JIT=jit)


def ended_well(found: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    """The same, which has exit code 0 and no remarks."""
    assert (found.returncode, said_beside_progress(found)) == (0, []), found.stdout
    return found


# How far a run of some seconds, or a compiler, had come; and of a machine with an old libLLVM, that it does not work.
NO_REMARKS = ("validating: ", "compiling ", "llvm_ad_rgb does not work here")


def said_beside_progress(found: subprocess.CompletedProcess[str]) -> list[str]:
    """Lines of stderr that are remarks, without the first, which says what is loaded or that there is no compiler."""
    return [line for line in found.stderr.splitlines()[1:] if not line.startswith(NO_REMARKS)]


# Most of the time of `validate` in plain Python: each is made where it is the check that a fault offends.
LONG_CHECKS = ("knife_edges", "render")


class Forks:
    """`run`, for many commands: in forks of one process; see forked_runs.py."""

    def __init__(self, folder: Path, memory: Path | None = None, home: Path | None = None) -> None:
        """folder: of this object alone, for what commands say. memory: for Mitsuba's answers, may be shared.

        home: a tree that nobody edits; commands of it are run in forks of a process that has loaded it.
        """
        self.folder, self.memory, self.home = folder, memory, home
        self.servers: dict[Path | None, subprocess.Popen[str]] = {}

    def server(self, tree: Path) -> "subprocess.Popen[str]":
        """The process that forks for this tree."""
        home = tree if tree == self.home else None
        if home not in self.servers:
            environment = {**os.environ, "CASTER_JIT": "1" if home else "0"}
            environment.pop("PYTHONPATH", None)
            self.servers[home] = subprocess.Popen(
                [*SERVER, *([str(home)] if home else [])],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
        return self.servers[home]

    def run(
        self,
        tree: Path,
        *argv: str,
        module: str = "mitsuba_ref",
        without: Sequence[str] = (),
        environment: Mapping[str, str] = {},
        folder: Path = ROOT,
        limit: float | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """The same as the function `run`, sooner. without: checks that `validate` shall pass over.

        environment: more variables. folder: where it is run. limit: CPU seconds, after which the exit code is negative.
        """
        out, err = self.folder / "out", self.folder / "err"
        order = {"tree": tree, "module": module, "argv": argv, "out": out, "err": err, "folder": folder}
        order |= {"memory": self.memory, "without": without, "environment": environment, "limit": limit}
        code = self.obeyed(self.server(tree), json.dumps(order, default=str))
        return subprocess.CompletedProcess(argv, code, *(file.read_text(encoding="utf-8") for file in (out, err)))

    def obeyed(self, server: "subprocess.Popen[str]", order: str) -> int:
        """The exit code. Whoever takes longer than DEADLINE is killed, and the process with it: an error here.

        The next order starts another process, so that one late command fails one test.
        """
        assert server.stdin and server.stdout
        late = threading.Timer(DEADLINE, os.killpg, (server.pid, signal.SIGKILL))
        late.start()
        try:
            server.stdin.write(order + "\n")
            server.stdin.flush()
            answer = server.stdout.readline()
        finally:
            late.cancel()
        if not answer:
            self.servers = {home: each for home, each in self.servers.items() if each is not server}
            with server:
                server.kill()
            raise AssertionError(f"no answer within {DEADLINE:g} s, or no process any more: {order}")
        return int(answer)

    def close(self) -> None:
        """No more orders: the processes end."""
        for server in self.servers.values():
            with server:
                pass
