"""A whole run: scene after scene, then sweep after sweep."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

from mitsuba_ref.bench.contestants import field_of
from mitsuba_ref.bench.entries.copying import CHANNELS
from mitsuba_ref.bench.entries.ours import BYTES
from mitsuba_ref.bench.machine import machine
from mitsuba_ref.bench.measuring import Progress, Settings, Start, start_process, time_scene
from mitsuba_ref.bench.result import Run, SceneResult
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.bench.sweeps import Family, sweep


def begun(scenes: Sequence[BenchScene], settings: Settings) -> Run:
    """A run that has timed nothing yet."""
    told = {name: value for name, value in asdict(settings).items() if name != "patience"}
    return Run(told, machine(), tuple(scene.name for scene in scenes), bytes_of_pixel=CHANNELS * BYTES)


class Running:
    """What is done is in `run`, whatever ends the work."""

    def __init__(
        self, scenes: Sequence[BenchScene], settings: Settings, start: Start = start_process
    ) -> None:
        self.scenes, self.settings, self.start = scenes, settings, start
        self.run = begun(scenes, settings)

    def time_scenes(self, say: Progress, told: Callable[[SceneResult], None]) -> None:
        """told: called with each scene's result as soon as it is there."""
        for scene in self.scenes:
            asked = field_of(scene.asks, peers=self.settings.peers)
            words = f"{len(self.run.scenes) + 1}/{len(self.scenes)} {scene.name}"
            result = time_scene(scene, asked, self.settings, prefixed(say, words), self.start)
            self.run = replace(self.run, scenes=(*self.run.scenes, result))
            told(result)

    def sweep(self, families: Sequence[Family], say: Progress) -> None:
        for family in families:
            found = sweep(family, self.settings, say, self.start)
            self.run = replace(self.run, sweeps=(*self.run.sweeps, found))


def prefixed(say: Progress, where: str) -> Progress:
    return lambda words: say(f"{where}: {words}")
