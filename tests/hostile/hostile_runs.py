"""Hostile cases, each run by the real command in a fork of a warm process, and what must hold of every run.

python -m hostile_runs --seed 0 --count 1000
"""

import argparse
import atexit
import contextlib
import gc
import hashlib
import json
import os
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import weakref
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from hostile_cases import Case, cases, parsers, with_content
from hostile_samples import ROOT, write_samples

import caster.__main__
import mitsuba_ref.__main__
from caster.system.process import INTERNAL, MEANINGS

MAINS = {"caster": caster.__main__.main, "mitsuba-ref": mitsuba_ref.__main__.main}
DOCUMENTED = {"caster": caster.__main__.CODES, "mitsuba-ref": mitsuba_ref.__main__.CODES}
MAX_SECONDS = 10  # of processor time, of all processes of a run; its limit per process kills
MAX_WALL_SECONDS = 60.0  # another user of the machine must not decide
MAX_SAID = 2**22  # bytes that a run may print
MAX_RSS = 10**9  # bytes, of the largest process
STARTED_RSS = 256 << 20  # bytes, of a command with its modules loaded; what the warm process has beyond, no run took
ADDRESS_SPACE = 3 << 30  # bytes beyond those of the warm process, so that a run cannot take the machine
CONTROL = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]")
SHOWN = 300  # characters of a run's messages


@dataclass(frozen=True)
class Run:
    """What became of a case."""

    case: Case
    code: int  # negative: a signal
    seconds: float  # of processor time
    rss: int
    said: str
    wrong: tuple[str, ...]  # what does not hold

    @property
    def is_late(self) -> bool:
        return self.seconds > MAX_SECONDS or self.code == -signal.SIGXCPU

    def text(self) -> str:
        used = f"exit {self.code}, {self.seconds:.1f} s, {self.rss >> 20} MB"
        return f"{self.case.line()}\n    {'; '.join(self.wrong) or 'good'}: {used}: {self.said}"


class Bench:
    """Samples in a folder, a warm process, and cases that are run in copies of the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.samples = folder, folder / "samples"
        self.samples.mkdir(parents=True)
        write_samples(self.samples, self.warm_run)

    def warm_run(self, line: str) -> int:
        """A command line in this process, which loads what forks will need."""
        from hostile_cases import split

        program, words = split(line)
        with contextlib.chdir(self.samples), open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            return MAINS[program](words)

    def start(self, case: Case) -> "Started":
        home = self.folder / str(case.number)
        shutil.copytree(self.samples, home)
        (home / "tmp").mkdir()
        os.mkfifo(home / "in" / "fifo")
        (home / "in" / "loop").symlink_to("loop")
        replace_file(home / case.file, case)
        return Started(case, home)

    def run(self, all_cases: list[Case], jobs: int) -> Iterator[Run]:
        """Runs in the order in which they end."""
        waiting, running = all_cases[::-1], []
        while waiting or running:
            while waiting and len(running) < jobs:
                running.append(self.start(waiting.pop()))
            ends = [each.end for each in running] + [each.pipe for each in running]
            ended = select.select(ends, [], [], MAX_WALL_SECONDS)[0]
            for each in list(running):
                each.read()
                if each.end in ended or time.monotonic() > each.deadline:
                    running.remove(each)
                    yield each.result()


class Started:
    """A process that runs one case; `end` becomes readable when it ends."""

    def __init__(self, case: Case, home: Path) -> None:
        self.case, self.home = case, home
        self.before = digests(home)
        self.deadline = time.monotonic() + MAX_WALL_SECONDS
        sys.stdout.flush()
        self.inherited = max(0, inherited_bytes() - STARTED_RSS)
        self.pipe, writing = os.pipe()  # a file would feel a full disk, too
        os.set_blocking(self.pipe, False)
        self.said = b""
        self.pid = os.fork()
        if self.pid == 0:
            run_case(case, home, writing)
        os.close(writing)
        self.end = os.pidfd_open(self.pid)

    def read(self) -> None:
        """Take what is in the pipe."""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self.pipe, 1 << 16):
                self.said += part[: max(0, MAX_SAID + 1 - len(self.said))]

    def result(self) -> Run:
        late = time.monotonic() > self.deadline
        if late:
            os.kill(self.pid, signal.SIGKILL)
        _, status, used = os.wait4(self.pid, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        os.close(self.end)
        code = os.waitstatus_to_exitcode(status)
        self.read()
        os.close(self.pipe)
        said = self.said
        seconds, rss = used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 - self.inherited
        wrong = tuple(self.wrong(code, said, late, seconds, rss))
        shutil.rmtree(self.home, ignore_errors=True)
        text = said.decode(errors="replace")
        text = text if "Traceback" in text else text[:SHOWN]
        return Run(self.case, code, seconds, rss, text.strip(), wrong)

    def wrong(self, code: int, said: bytes, late: bool, seconds: float, rss: int) -> Iterator[str]:
        """What of the rules does not hold."""
        if late:
            yield "hangs"
        if code not in DOCUMENTED[self.case.program]:
            yield "undocumented exit code"
        if code == INTERNAL or b"Traceback (most recent" in said:
            yield "internal error"
        if code and not said.strip():
            yield "fails without a word"
        if control := CONTROL.search(said):
            yield f"control character {control[0]!r} printed"
        if len(said) > MAX_SAID:
            yield "prints without end"
        if seconds > MAX_SECONDS:
            yield f"takes {seconds:.0f} s"
        if rss > MAX_RSS:
            yield f"takes {rss >> 20} MB"
        if self.case.disk is not None and code == 4 and str(self.home).encode() not in said and b"out/" not in said:
            yield "does not name the file"
        after = digests(self.home)
        named = {os.path.realpath(self.home / name) for name in self.case.outputs}
        touched = [name for name in {*self.before, *after} if self.before.get(name) != after.get(name)]
        foreign = [name for name in touched if name.startswith("in/") and not is_below(self.home / name, named)]
        if foreign:
            yield f"changed or wrote among inputs: {', '.join(foreign)}"
        left = [name for name in after if name.startswith("tmp/") or ".part" in name]
        if left and not late:
            yield f"left behind: {', '.join(left[:3])}"
        for name in sorted(set(after) - set(self.before)):
            if name.startswith("out/") and not is_whole(self.home / name):
                yield f"half-written: {name}"


def is_below(path: Path, named: set[str]) -> bool:
    """Whether a file was named as an output, or is in a folder that was."""
    return any(os.path.realpath(each) in named or os.path.abspath(each) in named for each in (path, *path.parents))


def is_whole(path: Path) -> bool:
    """Whether an output is complete, as far as its kind shows."""
    data = path.read_bytes()
    try:
        if path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".jsonl":
            return data == b"" or data.endswith(b"\n")
        elif path.suffix == ".png":
            return data.endswith(b"IEND\xaeB\x60\x82")
        elif path.suffix in (".toml", ".md", ".xml", ".html"):
            return data.endswith((b"\n", b">"))
    except ValueError:
        return False
    return bool(data) or not path.suffix


def digests(home: Path) -> dict[str, str]:
    """Digest of every file and kind of everything else, by name."""
    found = {}
    for folder, folders, files in os.walk(home):
        for name in (*files, *(each for each in folders if Path(folder, each).is_symlink())):
            path = Path(folder, name)
            if path.parent == home:
                continue
            is_small = path.is_file() and not path.is_symlink() and path.stat().st_size < 2**30
            found[str(path.relative_to(home))] = (
                hashlib.sha256(path.read_bytes()).hexdigest() if is_small else "special"
            )
        if Path(folder).parent == home / "tmp":
            found[str(Path(folder).relative_to(home))] = "folder"
    return found


def replace_file(path: Path, case: Case) -> None:
    """Put in place of the file what the case has."""
    if not case.file or not (case.no_file or case.data is not None):
        return
    path.unlink()
    if case.data is not None:
        path.write_bytes(case.data)
        return
    kind = case.no_file
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind in ("zero", "null", "full"):
        path.symlink_to(f"/dev/{kind}")
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind in ("sparse", "empty", "unreadable"):
        with path.open("wb") as file:
            file.truncate(2**40 if kind == "sparse" else 0)
        path.chmod(0o200 if kind == "unreadable" else 0o600)


def inherited_bytes() -> int:
    """Memory of this process that a fork has from its start, in bytes: what is in RAM and of no file."""
    resident, of_files = map(int, Path("/proc/self/statm").read_text().split()[1:3])
    return (resident - of_files) * resource.getpagesize()


def run_case(case: Case, home: Path, said: int) -> NoReturn:
    """The child's side: limits, what is printed into a pipe, then the command."""
    code = 99
    try:
        os.setsid()
        os.chdir(home)
        for inherited in list(weakref.finalize._registry):  # type: ignore[attr-defined]
            inherited.detach()  # temporary folders of the warm process, which go on being used there
        os.environ["TMPDIR"] = tempfile.tempdir = str(home / "tmp")
        for number, target in ((0, os.open(os.devnull, os.O_RDONLY)), (1, said), (2, said)):
            os.dup2(target, number)
        sys.stdin = open(0, closefd=False)  # noqa: SIM115 - until the process ends
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        space = pages * resource.getpagesize() + ADDRESS_SPACE
        resource.setrlimit(resource.RLIMIT_AS, (space, space))
        resource.setrlimit(resource.RLIMIT_CPU, (2 * MAX_SECONDS, 2 * MAX_SECONDS + 2))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if case.disk is not None:
            # Python 3.11 takes bytecode that a full disk cut off for whole, in every later process.
            sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.disk, case.disk))
        if case.process:
            module = case.program.replace("-", "_")
            words = [word for word in case.words if "\0" not in word]
            environment = os.environ | {"PYTHONPATH": str(ROOT)}
            code = subprocess.run([sys.executable, "-m", module, *words], env=environment).returncode
            code = 128 - code if code < 0 else code
        else:
            code = MAINS[case.program](case.words)
        sys.stdout.flush()
        gc.collect()
        atexit._run_exitfuncs()
    except BaseException:
        with contextlib.suppress(BaseException):
            traceback.print_exc()
            sys.stderr.flush()
    finally:
        os._exit(code)


def report(runs: list[Run], seconds: float) -> str:
    """Failures, then counts."""
    failing = [run for run in runs if run.wrong]
    codes = Counter(run.code for run in runs)
    commands = {(run.case.program, run.case.words[0] if run.case.words else "") for run in runs} & set(parsers())
    slowest, largest = max(runs, key=lambda run: run.seconds), max(runs, key=lambda run: run.rss)
    ends = ", ".join(f"{count} x {code} {MEANINGS.get(code, '')}" for code, count in sorted(codes.items()))
    rows = [run.text() for run in sorted(failing, key=lambda run: run.case.number)]
    return "\n".join([
        *rows,
        f"{len(runs)} hostile inputs to {len(commands)} of {len(parsers())} commands, in {seconds:.0f} s",
        f"exit codes: {ends}",
        f"longest: case {slowest.case.number}, {slowest.seconds:.1f} s",
        f"largest: case {largest.case.number}, {largest.rss >> 20} MB",
        f"{len(failing)} of them bad",
    ])  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("-j", dest="jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("-v", dest="verbose", action="store_true")
    args = parser.parse_args()
    began = time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix="hostile-")).resolve()  # not removed by the atexit of forks
    runs = []
    try:
        bench = Bench(folder)
        chosen = [case for case in cases(args.seed, args.count) if args.only is None or case.number in args.only]
        ready = [with_content(case, args.seed, bench.samples) for case in chosen]
        for run in bench.run(ready, args.jobs):
            if run.is_late:  # kernels may have been compiled in this time: they are there now
                (run,) = bench.run([run.case], 1)
            if not run.case.process and any("left behind" in wrong for wrong in run.wrong):
                # a fork may end before what a thread of the warm process holds is removed: a process of its own decides
                (run,) = bench.run([replace(run.case, process=True)], 1)
            runs.append(run)
            if args.verbose:
                print(run.text(), flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(report(runs, time.monotonic() - began))
    return 1 if any(run.wrong for run in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
