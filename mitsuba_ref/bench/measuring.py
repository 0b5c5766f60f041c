"""The other end of worker.py: a contestant that may fail, die or hang, which is then its result."""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mitsuba_ref.bench.contestants import Contestant
from mitsuba_ref.bench.result import Row, SceneResult, Score
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.bench.scoring import ExactAnswers, write_scene
from mitsuba_ref.bench.work import SHADING, Work
from mitsuba_ref.bench.worker import STATUS_READY
from mitsuba_ref.experiment.exact_hits import PreparedScene
from mitsuba_ref.reference.subprocess_runner import (
    ProcessEnd,
    ProcessEnded,
    ResidentProcess,
    exit_name,
    import_path,
)

LAST_WORDS = 300  # characters kept of what a contestant said before it died
WORKER = (sys.executable, "-P", "-m", "mitsuba_ref.bench.worker")


class ContestantEnded(Exception):  # noqa: N818 - an end, perhaps nobody's mistake
    """A contestant that does not go on; str() says why, in a line."""


class ContestantProcess:
    """One contestant. Close it, or it stays."""

    def __init__(
        self, work: Work, environment: Mapping[str, str] | None = None, command: Sequence[str] = WORKER
    ) -> None:
        settings = {**(environment or {}), "PYTHONPATH": import_path()}
        self.process = ResidentProcess(command, [work.to_json()], settings)

    def ask(self, patience: float, **question: Any) -> dict[str, Any]:
        """The reply to {"do": ...}, within so many seconds. Raises ContestantEnded; the process is then gone, too."""
        try:
            line = self.process.request(json.dumps(question), patience)
        except ProcessEnded as ended:
            raise ContestantEnded(_end_text(ended.end, patience)) from None
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


def _end_text(end: ProcessEnd, patience: float) -> str:
    """A signal or an exit code, and the last line of its output."""
    if end.code is None:
        return f"no answer within {patience:g} s"
    return ": ".join(["died", exit_name(end.code), *end.output.splitlines()[-1:]])[:LAST_WORDS]


# Contestants take turns: one cast each, round after round, each in a process of its own that stays.


Progress = Callable[[str], None]

MIN_TURN_S = 0.05  # seconds of a turn: shorter casts are repeated, and their median is the turn's time
MAX_CAST_S = 0.5  # seconds that a slow contestant's cast may take; its picture is made smaller until it fits
WARM_UP_CASTS = 3  # casts before the first that counts, of which the first ones may compile
REQUEST_TIMEOUT_S = 300.0  # seconds that any single question may take, compilers included


@dataclass(frozen=True)
class Settings:
    size: int = 1024
    alternations: int = 7
    threads: int = 1
    seed: int = 0
    peers: bool = False
    patience: float = REQUEST_TIMEOUT_S


class Requester(Protocol):
    """A contestant's process."""

    def ask(self, patience: float, **question: Any) -> Mapping[str, Any]:
        """Raises Gone."""

    def close(self) -> None: ...


Start = Callable[[Contestant, str, str, int], Requester]  # contestant, folder, what is asked, threads


def start_process(contestant: Contestant, folder: str, asks: str, threads: int) -> Requester:
    return ContestantProcess(contestant.work(folder, asks, threads), contestant.settings())


class Lane:
    """One contestant on its way through a scene. After `why` is set it does nothing more."""

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
        """Do something with the process, if it lives; if it dies over it, that is its result."""
        if self.why or self.process is None:
            return
        try:
            step(self.process)
        except ContestantEnded as end:
            self.why = str(end)

    def begin(self, start: Start, ready: PreparedScene, folder: str, asks: str) -> None:
        most = self.contestant.most
        self.why = self.contestant.missing()
        if not self.why and most and ready.primitives > most:
            self.why = f"not asked about more than {most:,} primitives"
        if not self.why:
            self.process = start(self.contestant, folder, asks, self.settings.threads)
            self.go(self._warm_up)

    def _warm_up(self, process: Requester) -> None:
        """Compile everything, find a size that a slow one can do, and then build once more, for the time of it."""
        ask = self._ask
        if self.contestant.first:
            ask(process, do="build", size=self.contestant.first)
            ask(process, do="cast", least=0.0)
            found = ask(process, do="cast", least=0.0)
            self.size = fitting_size(self.contestant.first, float(found["seconds"]), self.settings.size)
        else:
            ask(process, do="build", size=self.size)
            ask(process, do="cast", least=0.0)
        self.build = float(ask(process, do="build", size=self.size)["seconds"])
        for _ in range(WARM_UP_CASTS):
            ask(process, do="cast", least=0.0)

    def time_cast(self, process: Requester) -> None:
        found = self._ask(process, do="cast", least=MIN_TURN_S)
        self.rays = int(found["rays"])
        self.seconds.append(float(found["seconds"]))

    def record_memory(self, process: Requester) -> None:
        """Its memory, before it is asked about other rays."""
        self.memory = int(self._ask(process, do="memory")["bytes"])

    def measure_error(self, truth: ExactAnswers, rays: Path, process: Requester) -> None:
        out = rays.with_name(f"{self.contestant.key}.npy")
        self._ask(process, do="answer", rays=str(rays), out=str(out))
        t = np.load(out)
        if np.isnan(t).all():  # not a caster
            return
        self.score = truth.score(t, ours=self.contestant.side == "ours")

    def _ask(self, process: Requester, **question: Any) -> Mapping[str, Any]:
        return process.ask(self.settings.patience, **question)

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
    """The largest power of two times `first`, at most `most`, whose cast should take no more than LONGEST seconds."""
    size = min(first, most)
    while 2 * size <= most and seconds * (2 * size / first) ** 2 <= MAX_CAST_S:
        size *= 2
    return size


def time_scene(
    scene: BenchScene,
    contestants: Sequence[Contestant],
    settings: Settings,
    say: Progress = lambda words: None,
    start: Start = start_process,
    *,
    judged: bool = True,
) -> SceneResult:
    """All of them, taking turns; rows in their order. judged: whether anybody is asked how wrong they are."""
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-bench-") as name:
        say("making the scene")
        ready = write_scene(scene, Path(name), settings.size)
        lanes = [Lane(contestant, settings) for contestant in contestants]
        try:
            for lane in lanes:
                say(f"warming up: {lane.contestant.title}")
                lane.begin(start, ready, name, scene.asks)
            alternate(lanes, settings.alternations, say)
            for lane in lanes:
                lane.go(lane.record_memory)
            if judged and scene.asks != SHADING:
                judge(lanes, ready, scene.asks, settings, Path(name), say)
        finally:
            for lane in lanes:
                lane.close()
    rows = tuple(lane.row for lane in lanes)
    return SceneResult(
        scene.name, scene.title, scene.asks, ready.primitives, rows, time.perf_counter() - begun
    )


def alternate(lanes: Sequence[Lane], alternations: int, say: Progress) -> None:
    """One turn each, again and again; every round begins with another one, so that nobody always follows the same."""
    for turn in range(alternations):
        say(f"alternation {turn + 1}/{alternations}")
        first = turn % len(lanes)
        for lane in [*lanes[first:], *lanes[:first]]:
            lane.go(lane.time_cast)


def judge(
    lanes: Sequence[Lane], ready: PreparedScene, asks: str, settings: Settings, folder: Path, say: Progress
) -> None:
    say("exact answers")
    truth = ExactAnswers(ready, asks, settings.seed)
    rays = folder / "judged.npz"
    np.savez(rays, o=truth.o, d=truth.d)
    for lane in lanes:
        say(f"judging: {lane.contestant.title}")
        lane.go(partial(lane.measure_error, truth, rays))
