"""Timing: contestants in processes of their own cast in turns, round after round."""

import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.bench.contestants import Contestant
from mitsuba_ref.bench.entries import FILM, PROCESS, SHADING, VALIDATION, Work
from mitsuba_ref.bench.result import Row, SceneResult, Score
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.bench.scoring import ExactAnswers, write_scene
from mitsuba_ref.bench.worker import STATUS_READY
from mitsuba_ref.judge.adjudication import PreparedScene
from mitsuba_ref.reference.subprocess_runner import ProcessEnd, ProcessEnded, ResidentProcess, exit_name, import_path

LAST_WORDS = 300  # characters kept of a dead contestant's output
WORKER = (sys.executable, "-P", "-m", "mitsuba_ref.bench.worker")


class ContestantEnded(Exception):  # noqa: N818 - an end, not always an error
    """The end of a contestant's process; str() is the reason, in a line."""


class ContestantProcess:
    """A contestant's process (worker.py), which may fail, crash or hang. Close it, or it stays."""

    def __init__(
        self, work: Work, environment: Mapping[str, str] | None = None, command: Sequence[str] = WORKER
    ) -> None:
        settings = {**(environment or {}), "PYTHONPATH": import_path()}
        with os.fdopen(os.dup(2), "w") as notices:  # for what it compiles: all else that it says is captured
            fd = notices.fileno()
            self.process = ResidentProcess([*command, work.to_json(), str(fd)], settings, pass_fds=(fd,))

    def request(self, timeout: float, **request: Any) -> dict[str, Any]:
        """The reply to {"do": ...}, within so many seconds. Raises ContestantEnded; the process is then gone, too."""
        try:
            line = self.process.ask(json.dumps(request).encode(), timeout)
        except ProcessEnded as ended:
            raise ContestantEnded(_end_text(ended.end, timeout)) from None
        try:
            reply: dict[str, Any] = json.loads(line)
        except ValueError:
            self.close()
            raise ContestantEnded(f"unexpected reply: {line[:LAST_WORDS]!r}") from None
        if reply["status"] != STATUS_READY:
            self.close()
            raise ContestantEnded(reply["why"])
        return reply

    def close(self) -> None:
        """End it; a second call does nothing."""
        self.process.close()


def _end_text(end: ProcessEnd, timeout: float) -> str:
    """A signal or an exit code, and the last line of its output."""
    if end.code is None:
        return f"no answer within {timeout:g} s"
    return ": ".join(["died", exit_name(end.code), *end.output.splitlines()[-1:]])[:LAST_WORDS]


Progress = Callable[[str], None]

MIN_TURN_S = 0.05  # seconds of a turn: shorter casts are repeated, and their median is the turn's time
MAX_CAST_S = 0.2  # seconds of a slow contestant's cast; its film is made smaller until it fits
WARM_UP_CASTS = 3  # casts before the first that counts, of which the first ones may compile
REQUEST_TIMEOUT_S = 300.0  # seconds of any single request, compilation included


@dataclass(frozen=True)
class Settings:
    size: int = 1024
    alternations: int = 7
    threads: int = 1
    seed: int = 0
    peers: bool = False
    timeout: float = REQUEST_TIMEOUT_S
    candidate: str = ""  # a ray caster from elsewhere that takes rays, as of `parse_candidate`; "": none
    candidate_precision: str | None = None
    candidate_served: bool = False


class Requester(Protocol):
    """A contestant's process."""

    def request(self, timeout: float, **request: Any) -> Mapping[str, Any]:
        """Raises ContestantEnded."""

    def close(self) -> None: ...


Start = Callable[[Contestant, str, str, int], Requester]  # contestant, folder, task, threads


def start_process(contestant: Contestant, folder: str, workload: str, threads: int) -> Requester:
    return ContestantProcess(contestant.work(folder, workload, threads), contestant.settings())


class ContestantRun:
    """One contestant in one scene. After `why` is set it does nothing more."""

    def __init__(self, contestant: Contestant, settings: Settings) -> None:
        self.contestant, self.settings = contestant, settings
        self.process: Requester | None = None
        self.size, self.rays = settings.size, 0
        self.build: float | None = None
        self.memory: int | None = None
        self.seconds: list[float] = []
        self.score: Score | None = None
        self.why = ""

    def go(self, step: Callable[[Requester], None]) -> None:
        """Run a step with the process if it is alive; an end of the process is its result."""
        if self.why or self.process is None:
            return
        try:
            step(self.process)
        except ContestantEnded as end:
            self.why = str(end)

    def begin(self, start: Start, ready: PreparedScene, folder: str, workload: str) -> None:
        most = self.contestant.most
        self.why = self.contestant.missing()
        if not self.why and most and ready.primitives > most:
            self.why = f"not timed with more than {most:,} primitives"
        if not self.why:
            self.process = start(self.contestant, folder, workload, self.settings.threads)

    def compile(self, process: Requester) -> None:
        """Build and cast for the first time; find a film size for a slow contestant."""
        request = self._request
        if self.contestant.first:
            request(process, do="build", size=self.contestant.first)
            request(process, do="cast", least=0.0)
            found = request(process, do="cast", least=0.0)
            self.size = fitting_size(self.contestant.first, float(found["seconds"]), self.settings.size)
        else:
            request(process, do="build", size=self.size)
            request(process, do="cast", least=0.0)

    def warm_up(self, process: Requester) -> None:
        """Build again to time it, and cast a few times."""
        self.build = float(self._request(process, do="build", size=self.size)["seconds"])
        for _ in range(WARM_UP_CASTS):
            self._request(process, do="cast", least=0.0)

    def time_cast(self, process: Requester) -> None:
        found = self._request(process, do="cast", least=MIN_TURN_S)
        self.rays = int(found["rays"])
        self.seconds.append(float(found["seconds"]))

    def record_memory(self, process: Requester) -> None:
        """Peak memory, before any other rays are cast."""
        self.memory = int(self._request(process, do="memory")["bytes"])

    def measure_error(self, truth: ExactAnswers, rays: Path, process: Requester) -> None:
        out = rays.with_name(f"{self.contestant.key}.npy")
        self._request(process, do="answer", rays=str(rays), out=str(out))
        t = np.load(out)
        if np.isnan(t).all():  # not a caster
            return
        self.score = truth.score(t, ours=self.contestant.side == "ours")

    def _request(self, process: Requester, **request: Any) -> Mapping[str, Any]:
        return process.request(self.settings.timeout, **request)

    def close(self) -> None:
        if self.process is not None:
            self.process.close()

    @property
    def row(self) -> Row:
        it = self.contestant
        return Row(
            it.key,
            it.title,
            it.side,
            self.rays,
            self.size,
            self.build,
            tuple(self.seconds),
            self.memory,
            self.score,
            self.why,
        )


def fitting_size(first: int, seconds: float, most: int) -> int:
    """The largest power of two times `first`, at most `most`, whose cast should take no more than MAX_CAST_S."""
    size = min(first, most)
    while 2 * size <= most and seconds * (2 * size / first) ** 2 <= MAX_CAST_S:
        size *= 2
    return size


def time_scene(
    scene: BenchScene,
    contestants: Sequence[Contestant],
    settings: Settings,
    on_progress: Progress = lambda words: None,
    start: Start = start_process,
    *,
    judged: bool = True,
) -> SceneResult:
    """Rows of all contestants, cast in turns. judged: whether errors are measured as well."""
    begun = time.perf_counter()
    whole = scene.workload in (PROCESS, VALIDATION)  # processes, each of which begins anew
    settings = replace(settings, size=min(settings.size, scene.side or settings.size))
    with ScratchFolder() as name:
        on_progress("making the scene")
        ready = write_scene(scene, Path(name), settings.size)
        runs = [ContestantRun(contestant, settings) for contestant in contestants]
        try:
            on_progress("starting the contestants")
            for run in runs:  # in this thread: where it ends, Linux ends what it started
                run.begin(start, ready, name, scene.workload)
            with ThreadPoolExecutor(1 if whole else settings.threads) as pool:
                list(pool.map(lambda run: run.go(run.compile), runs))
            for run in () if whole else runs:
                on_progress(f"warming up: {run.contestant.title}")
                run.go(run.warm_up)
            alternate(runs, min(settings.alternations, scene.turns or settings.alternations), on_progress)
            for run in runs:
                run.go(run.record_memory)
            if judged and scene.workload != SHADING and not whole:
                judge(runs, ready, scene.workload, settings, Path(name), on_progress)
        finally:
            for run in runs:
                run.close()
    rows = tuple(run.row for run in runs)
    seconds, primitives = time.perf_counter() - begun, 0 if scene.workload == VALIDATION else ready.primitives
    aovs = scene.aovs if scene.workload in (FILM, PROCESS) else ()
    return SceneResult(scene.name, scene.title, scene.workload, primitives, rows, seconds, aovs)


def alternate(runs: Sequence[ContestantRun], alternations: int, on_progress: Progress) -> None:
    """Rounds of one turn each; every round begins with another contestant, so that none always follows the same."""
    for turn in range(alternations):
        on_progress(f"alternation {turn + 1}/{alternations}")
        first = turn % len(runs)
        for run in [*runs[first:], *runs[:first]]:
            run.go(run.time_cast)


def judge(
    runs: Sequence[ContestantRun],
    ready: PreparedScene,
    workload: str,
    settings: Settings,
    folder: Path,
    on_progress: Progress,
) -> None:
    on_progress("exact answers")
    truth = ExactAnswers(ready, workload, settings.seed)
    rays = folder / "judged.npz"
    np.savez(rays, o=truth.o, d=truth.d)
    for run in runs:
        on_progress(f"judging: {run.contestant.title}")
        run.go(partial(run.measure_error, truth, rays))
