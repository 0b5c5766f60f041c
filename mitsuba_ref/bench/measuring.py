"""Measuring: ray casters in processes of their own take turns, round after round; their errors to exact answers."""

import json
import math
import pickle
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
from mitsuba_ref.bench.drivers import AOVS, DEFAULT, RAYS_FILE, ROBUST, SCENE_FILE, CannotRun, Work
from mitsuba_ref.bench.result import REFERENCE_ROW, Row, SceneResult, Score
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, prepare_scene
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.shared_input import export, packed_float32, shared_rays
from mitsuba_ref.reference.subprocess_runner import ProcessEnded, ResidentProcess, run_module
from mitsuba_ref.report.output import largest
from mitsuba_ref.subjects.subject import Answer, scene_as_traced

LAST_WORDS = 300  # characters kept of a dead caster's output

MIN_TURN_S = 0.05  # seconds of a turn: shorter casts are repeated, and their median is the turn's time
MAX_CAST_S = 0.2  # seconds of a slow caster's cast; its film is made smaller until it fits
WARM_UP_CASTS = 3  # casts before the first that counts, of which the first ones may compile
REQUEST_TIMEOUT_S = 300.0  # seconds of any single request, compilation included
EXACT_RAYS = 2000  # rays of a scene whose exact answers are computed


def start_process(caster: TimedCaster, folder: str, scene: BenchScene) -> ResidentProcess:
    """Start the process of a caster (worker.py), which may fail, crash or hang.

    folder: as `write_scene` writes it.
    """
    work = Work(folder, scene.workload, caster.driver, scene.aovs, caster.options)
    environment = variants.environment_for(caster.variant)
    return run_module(sys.executable, "mitsuba_ref.bench.worker", json.dumps(asdict(work)), environment=environment)


def write_scene(scene: BenchScene, folder: Path, size: int) -> PreparedScene:
    """Write the scene in every form that a caster reads. size: pixels a side, or the square root of the number of rays.

    Its rays are its own, or else the camera's, one for each pixel.
    """
    made = scene.make().with_film(width=size, height=size)
    made = scene_as_traced(made, packed_float32(made), folder)
    if scene.rays:
        o, d = scene.rays(made)
    else:
        shared = shared_rays(made)
        real = shared.t_max > 0.0  # a fisheye's image has corners without rays
        o, d = shared.o[real], shared.d[real]
    ready = prepare_scene(made, o, d)
    (folder / SCENE_FILE).write_bytes(pickle.dumps(made))
    for name in (ROBUST, DEFAULT):
        export(made, ready.model, robust=name == ROBUST).write(folder / name)
    np.savez(folder / RAYS_FILE, o=ready.o, d=ready.d)
    return ready


def score(exact: ExactHits, t: Array, precision: str, *, reference: bool = False, ours: bool = False) -> Score:
    """t: (n,) of a caster along all rays, inf on a miss, by the bounds of a candidate, of Mitsuba or of ours."""
    answer = Answer(t, None, precision, {}, exact_visibility=ours)
    ratio, hits = exact.ratios(answer, REFERENCE_SIDE if reference else answer.side), answer.hit & exact.hit
    spacing = np.spacing(np.abs(exact.t).astype(np.float32)).astype(np.float64)
    return Score(
        rays=len(t),
        ulps=largest(exact.errors(t) / spacing),
        bounds=largest(ratio[hits]),
        masks=int(np.sum(answer.hit != exact.hit)),
        beyond=int(np.sum(hits & ~(ratio <= 1.0))),
    )


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
        except CannotRun as end:
            self.row["why"] = str(end)

    def request(self, **request: Any) -> Mapping[str, Any]:
        """The reply to {"do": ...}. Raises CannotRun; the process is then gone, too."""
        assert self.process is not None
        try:
            reply: dict[str, Any] = json.loads(self.process.ask(json.dumps(request).encode(), REQUEST_TIMEOUT_S))
        except ProcessEnded as ended:
            words = ["died", ended.end.exit, *ended.end.output.splitlines()[-1:]]
            raise CannotRun(": ".join(words)[:LAST_WORDS]) from None
        if "why" in reply:
            self.process.close()
            raise CannotRun(reply["why"])
        return reply

    def compile(self) -> None:
        """Build and cast for the first time; choose a film size for a slow caster."""
        first = self.caster.first
        self.request(do="build", size=first or self.size)
        self.request(do="cast", least=0.0)
        if first:
            times_as_fast = MAX_CAST_S / self.request(do="cast", least=0.0)["seconds"]
            doublings = int(max(0.0, math.log2(times_as_fast) // 2.0))  # of the side
            self.size = min(first * 2**doublings, self.size)

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
        is_ours = self.caster.key == REFERENCE_ROW
        self.row["score"] = score(exact, t, found["precision"], reference=is_reference, ours=is_ours)

    def result(self) -> Row:
        it = self.caster
        return Row(it.key, it.title, size=self.size, seconds=tuple(self.seconds), **self.row)


def time_scene(scene: BenchScene, casters: Sequence[TimedCaster], size: int, alternations: int) -> SceneResult:
    """Time all casters on a scene, in turns, and measure their errors, unless other AOVs are asked for."""
    begun = time.perf_counter()
    with ScratchFolder() as folder:
        report_stage("making the scene")
        ready = write_scene(scene, Path(folder), size)
        runs = [CasterRun(each, size, row={"why": each.missing()}) for each in casters]
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
            for turn in range(alternations):
                report_stage(f"alternation {turn + 1}/{alternations}")
                first = turn % len(runs)  # so that none always follows the same
                for run in [*runs[first:], *runs[:first]]:
                    run.go(CasterRun.time_cast)
            if scene.aovs == AOVS:
                report_stage("exact answers")
                count = len(ready.o)
                rows = np.sort(np.random.default_rng(7).choice(count, min(EXACT_RAYS, count), replace=False))
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
