"""Contestants take turns: one cast each, round after round, each in a process of its own that stays."""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mitsuba_ref.bench.contestants import Contestant
from mitsuba_ref.bench.error import Score, Truth
from mitsuba_ref.bench.preparing import Prepared, prepare
from mitsuba_ref.bench.process import Gone, Process
from mitsuba_ref.bench.result import Row, SceneResult
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.bench.work import SHADING

Progress = Callable[[str], None]

LEAST = 0.05  # seconds of a turn: shorter casts are repeated, and their median is the turn's time
LONGEST = 0.5  # seconds that a slow contestant's cast may take; its picture is made smaller until it fits
WARM_UPS = 3  # casts before the first that counts, of which the first ones may compile
PATIENCE = 300.0  # seconds that any single question may take, compilers included


@dataclass(frozen=True)
class Settings:
    size: int = 1024
    alternations: int = 7
    threads: int = 1
    seed: int = 0
    peers: bool = False
    patience: float = PATIENCE


class Asked(Protocol):
    """A contestant's process."""

    def ask(self, patience: float, **question: Any) -> Mapping[str, Any]:
        """Raises Gone."""

    def close(self) -> None: ...


Start = Callable[[Contestant, str, str, int], Asked]  # contestant, folder, what is asked, threads


def start_process(contestant: Contestant, folder: str, asks: str, threads: int) -> Asked:
    return Process(contestant.work(folder, asks, threads), contestant.settings())


class Lane:
    """One contestant on its way through a scene. After `why` is set it does nothing more."""

    def __init__(self, contestant: Contestant, settings: Settings) -> None:
        self.contestant, self.settings = contestant, settings
        self.process: Asked | None = None
        self.size, self.rays = settings.size, 0
        self.build: float | None = None
        self.memory: int | None = None
        self.seconds: list[float] = []
        self.score: Score | None = None
        self.why = ""

    def go(self, step: Callable[[Asked], None]) -> None:
        """Do something with the process, if it lives; if it dies over it, that is its result."""
        if self.why or self.process is None:
            return
        try:
            step(self.process)
        except Gone as end:
            self.why = str(end)

    def begin(self, start: Start, ready: Prepared, folder: str, asks: str) -> None:
        most = self.contestant.most
        self.why = self.contestant.missing()
        if not self.why and most and ready.primitives > most:
            self.why = f"not asked about more than {most:,} primitives"
        if not self.why:
            self.process = start(self.contestant, folder, asks, self.settings.threads)
            self.go(self._warm_up)

    def _warm_up(self, process: Asked) -> None:
        """Compile everything, find a size that a slow one can do, and then build once more, for the time of it."""
        ask = self._ask
        if self.contestant.first:
            ask(process, do="build", size=self.contestant.first)
            ask(process, do="cast", least=0.0)
            found = ask(process, do="cast", least=0.0)
            self.size = fitting(self.contestant.first, float(found["seconds"]), self.settings.size)
        else:
            ask(process, do="build", size=self.size)
            ask(process, do="cast", least=0.0)
        self.build = float(ask(process, do="build", size=self.size)["seconds"])
        for _ in range(WARM_UPS):
            ask(process, do="cast", least=0.0)

    def take_turn(self, process: Asked) -> None:
        found = self._ask(process, do="cast", least=LEAST)
        self.rays = int(found["rays"])
        self.seconds.append(float(found["seconds"]))

    def remember(self, process: Asked) -> None:
        """Its memory, before it is asked about other rays."""
        self.memory = int(self._ask(process, do="memory")["bytes"])

    def be_judged(self, truth: Truth, rays: Path, process: Asked) -> None:
        out = rays.with_name(f"{self.contestant.key}.npy")
        self._ask(process, do="answer", rays=str(rays), out=str(out))
        t = np.load(out)
        if np.isnan(t).all():  # not a caster
            return
        self.score = truth.score(t, ours=self.contestant.side == "ours")

    def _ask(self, process: Asked, **question: Any) -> Mapping[str, Any]:
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


def fitting(first: int, seconds: float, most: int) -> int:
    """The largest power of two times `first`, at most `most`, whose cast should take no more than LONGEST seconds."""
    size = min(first, most)
    while 2 * size <= most and seconds * (2 * size / first) ** 2 <= LONGEST:
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
        ready = prepare(scene, Path(name), settings.size)
        lanes = [Lane(contestant, settings) for contestant in contestants]
        try:
            for lane in lanes:
                say(f"warming up: {lane.contestant.title}")
                lane.begin(start, ready, name, scene.asks)
            alternate(lanes, settings.alternations, say)
            for lane in lanes:
                lane.go(lane.remember)
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
            lane.go(lane.take_turn)


def judge(
    lanes: Sequence[Lane], ready: Prepared, asks: str, settings: Settings, folder: Path, say: Progress
) -> None:
    say("exact answers")
    truth = Truth(ready, asks, settings.seed)
    rays = folder / "judged.npz"
    np.savez(rays, o=truth.o, d=truth.d)
    for lane in lanes:
        say(f"judging: {lane.contestant.title}")
        lane.go(partial(lane.be_judged, truth, rays))
