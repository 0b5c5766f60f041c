"""Timing: ray casters in processes of their own take turns, round after round."""

import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from caster.rendering.threads import core_count
from caster.system.atomic_files import ScratchFolder
from caster.system.terminal import report_stage
from mitsuba_ref.bench.casters import TimedCaster
from mitsuba_ref.bench.drivers import AOVS, Work
from mitsuba_ref.bench.result import Row, SceneResult
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.bench.scoring import sampled_rows, score, write_scene
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.adjudication import ExactHits
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.subprocess_runner import ProcessEnded, ResidentProcess, exit_name, import_path

LAST_WORDS = 300  # characters kept of a dead caster's output
WORKER = (sys.executable, "-P", "-m", "mitsuba_ref.bench.worker")

MIN_TURN_S = 0.05  # seconds of a turn: shorter casts are repeated, and their median is the turn's time
MAX_CAST_S = 0.2  # seconds of a slow caster's cast; its film is made smaller until it fits
WARM_UP_CASTS = 3  # casts before the first that counts, of which the first ones may compile
REQUEST_TIMEOUT_S = 300.0  # seconds of any single request, compilation included


class CasterEnded(Exception):  # noqa: N818 - an end, not always an error
    """A caster's process has ended; str() is the reason, in one line."""


@dataclass(frozen=True)
class Settings:
    size: int
    alternations: int


def start_process(caster: TimedCaster, folder: str, scene: BenchScene) -> ResidentProcess:
    """Start the process of a caster (worker.py), which may fail, crash or hang.

    folder: as `write_scene` writes it.
    """
    work = Work(folder, scene.workload, caster.driver, scene.aovs, caster.options)
    environment = {**variants.environment_for(caster.variant), "PYTHONPATH": import_path()}
    with os.fdopen(os.dup(2), "w") as notices:  # for what it compiles: all else that it says is captured
        fd = notices.fileno()
        return ResidentProcess([*WORKER, json.dumps(asdict(work)), str(fd)], environment, pass_fds=(fd,))


@dataclass
class CasterRun:
    """One caster in one scene. After `row.why` is set it does nothing more."""

    caster: TimedCaster
    size: int  # pixels a side
    process: ResidentProcess | None = None
    seconds: list[float] = field(default_factory=list)
    row: dict[str, Any] = field(default_factory=dict)

    def go(self, step: Callable[..., None], *given: Any) -> None:
        """Run a step if the process is alive; the reason is recorded if the process ends."""
        if self.process is None or self.row.get("why"):
            return
        try:
            step(self, *given)
        except CasterEnded as end:
            self.row["why"] = str(end)

    def request(self, **request: Any) -> Mapping[str, Any]:
        """The reply to {"do": ...}. Raises CasterEnded; the process is then gone, too."""
        assert self.process is not None
        try:
            reply: dict[str, Any] = json.loads(self.process.ask(json.dumps(request).encode(), REQUEST_TIMEOUT_S))
        except ProcessEnded as ended:
            end = ended.end
            words = ["died", exit_name(end.code or 0), *end.output.splitlines()[-1:]]
            why = f"no answer within {REQUEST_TIMEOUT_S:g} s" if end.code is None else ": ".join(words)[:LAST_WORDS]
            raise CasterEnded(why) from None
        if "why" in reply:
            self.process.close()
            raise CasterEnded(reply["why"])
        return reply

    def compile(self) -> None:
        """Build and cast for the first time; choose a film size for a slow caster."""
        first = self.caster.first
        self.request(do="build", size=first or self.size)
        self.request(do="cast", least=0.0)
        if first:
            found = self.request(do="cast", least=0.0)
            self.size = fitting_size(first, found["seconds"], self.size)

    def warm_up(self) -> None:
        """Build again to time it, and cast a few times."""
        self.row["build"] = self.request(do="build", size=self.size)["seconds"]
        for _ in range(WARM_UP_CASTS):
            self.request(do="cast", least=0.0)

    def time_cast(self) -> None:
        found = self.request(do="cast", least=MIN_TURN_S)
        self.row["rays"] = found["rays"]
        self.seconds.append(found["seconds"])

    def measure_errors(self, exact: ExactHits, rows: Array) -> None:
        found = self.request(do="answer", rows=rows.tolist())
        t, is_reference = np.array(found["t"]), bool(self.caster.variant)
        self.row["score"] = score(exact, t, found["precision"], reference=is_reference)

    def result(self) -> Row:
        it = self.caster
        return Row(it.key, it.title, size=self.size, seconds=tuple(self.seconds), **self.row)


def fitting_size(first: int, seconds: float, most: int) -> int:
    """`first` times the largest power of two that should be cast within MAX_CAST_S, up to `most`."""
    doublings = int(max(0.0, math.log2(MAX_CAST_S / seconds) // 2.0))
    return min(first * 2**doublings, most)


def time_scene(scene: BenchScene, casters: Sequence[TimedCaster], settings: Settings) -> SceneResult:
    """Time all casters on a scene, in turns, and measure their errors, unless other AOVs are asked for."""
    begun = time.perf_counter()
    with ScratchFolder() as folder:
        report_stage("making the scene")
        ready = write_scene(scene, Path(folder), settings.size)
        runs = [CasterRun(each, settings.size, row={"why": each.missing()}) for each in casters]
        try:
            report_stage("starting the casters")
            for run in runs:  # in this thread: where it ends, Linux ends what it started
                if not run.row["why"]:
                    run.process = start_process(run.caster, folder, scene)
            with ThreadPoolExecutor(core_count()) as pool:
                list(pool.map(lambda run: run.go(CasterRun.compile), runs))
            report_stage("warming up")
            for run in runs:
                run.go(CasterRun.warm_up)
            for turn in range(settings.alternations):
                report_stage(f"alternation {turn + 1}/{settings.alternations}")
                first = turn % len(runs)  # so that none always follows the same
                for run in [*runs[first:], *runs[:first]]:
                    run.go(CasterRun.time_cast)
            if scene.aovs == AOVS:
                report_stage("exact answers")
                rows = sampled_rows(len(ready.o))
                exact = ExactHits(ready.model, ready.o[rows], ready.d[rows])
                for run in runs:
                    run.go(CasterRun.measure_errors, exact, rows)
        finally:
            for run in runs:
                if run.process is not None:
                    run.process.close()
    found = tuple(run.result() for run in runs)
    elapsed = time.perf_counter() - begun
    primitives = int(ready.model.packed.first[-1])
    return SceneResult(scene.name, scene.title, scene.workload, primitives, found, elapsed, scene.aovs)
