"""A benchmark run: the machine, scene after scene, and sweeps over triangles, pixels and threads."""

import os
import platform
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

from caster import __version__
from caster.scene.model import Scene
from mitsuba_ref.bench import scenes
from mitsuba_ref.bench.contestants import (
    ALL_TASKS,
    BY_KEY,
    Contestant,
    candidate_contestant,
    contestants_for,
    processors,
)
from mitsuba_ref.bench.entries import AOVS, BYTES_PER_CHANNEL, CHANNELS
from mitsuba_ref.bench.measuring import Progress, Settings, Start, start_process, time_scene
from mitsuba_ref.bench.result import Run, SceneResult, Series, Sweep
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT
from mitsuba_ref.report.results import libllvm, versions

PACKAGES = ("numpy", "numba", "mitsuba", "drjit", "open3d", "trimesh", "embreex")
GIT_SECONDS = 10.0  # for the name of a commit


def machine_properties() -> dict[str, str]:
    """Properties of the machine and of the software that times depend on."""
    found = {
        "processor": processor(),
        "processors used": f"{processors()} of {os.cpu_count() or 1}",
        "memory": memory(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "Python": platform.python_version(),
        "load before": load(),
        "caster": __version__,
        "revision": revision(),
    }
    return found | versions(*PACKAGES) | {"libLLVM": libllvm()}


def processor() -> str:
    return _first_value("/proc/cpuinfo", "model name") or platform.processor() or platform.machine()


def memory() -> str:
    words = _first_value("/proc/meminfo", "MemTotal").split()
    return f"{int(words[0]) / 2**20:.1f} GiB" if words else "unknown"


def load() -> str:
    """Load of the last minute, in processors."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


def revision() -> str:
    """The commit of these sources, where they are in a repository."""
    command = ["git", "-C", str(PACKAGE_PARENT), "describe", "--always", "--dirty", "--abbrev=10"]
    described = subprocess_runner.run(command, GIT_SECONDS) if shutil.which("git") else None
    return described.output.strip() if described and described.code == 0 else "unknown"


def _first_value(file: str, name: str) -> str:
    """The value of the first "name: value" of a file of the system; "" where there is none."""
    return next(_values(file, name), "")


def _values(file: str, name: str) -> Iterator[str]:
    try:
        lines = Path(file).read_text(errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        key, _, value = line.partition(":")
        if key.strip() == name:
            yield value.strip()


TRIANGLE_COUNTS = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
FILM_SIDES = (64, 128, 256, 512, 1024, 2048, 4096)  # a side
SWEPT_ROWS, SWEPT_PEERS = ("ours", "raw-robust", "aov-robust"), ("open3d",)


@dataclass(frozen=True)
class ScalingFamily:
    """One sweep: a scene and settings for each value of the quantity."""

    name: str
    quantity: str
    points: Callable[[Settings], Iterator[tuple[float, BenchScene, Settings]]]


def over_triangles(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    for count in TRIANGLE_COUNTS:
        scene = BenchScene(f"hills-{count}", "hills", partial(hills, count))
        yield float(count), scene, settings


def hills(triangles: int, folder: Path) -> Scene:
    return scenes.scene_from_front(scenes.heightfield_mesh(folder, triangles))


def over_pixels(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    for side in FILM_SIDES:
        yield float(side * side), BenchScene("ring", "ring", scenes.ring), replace(settings, size=side)


def over_threads(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    """Powers of two, and at last all that there are."""
    counts = {2**k for k in range(settings.threads.bit_length()) if 2**k < settings.threads}
    for count in sorted(counts | {settings.threads}):
        yield float(count), BenchScene("ring", "ring", scenes.ring), replace(settings, threads=count)


FAMILIES = (
    ScalingFamily("triangles", "triangles of hills", over_triangles),
    ScalingFamily("pixels", "pixels of an image of 70,224 triangles", over_pixels),
    ScalingFamily("threads", "threads, for an image of 70,224 triangles", over_threads),
)


def run_sweep(
    family: ScalingFamily, settings: Settings, on_progress: Progress = lambda words: None, start: Start = start_process
) -> Sweep:
    """Every setting, by the few contestants that matter most."""
    contestants = [BY_KEY[key] for key in SWEPT_ROWS + (SWEPT_PEERS if settings.peers else ())]
    found: list[tuple[float, SceneResult]] = []
    for x, scene, here in family.points(settings):
        report = prefixed(on_progress, f"{family.name} {x:g}")
        found.append((x, time_scene(scene, contestants, here, report, start, judged=False)))
    return Sweep(family.name, family.quantity, tuple(series(each, found) for each in contestants))


def series(contestant: Contestant, found: Sequence[tuple[float, SceneResult]]) -> Series:
    """One contestant's medians, where it ran."""
    rows = [(x, result.row(contestant.key)) for x, result in found]
    ran = [(x, row) for x, row in rows if row is not None and row.ran]
    why = "; ".join(dict.fromkeys(row.why for _, row in rows if row is not None and row.why))
    return Series(
        contestant.key,
        contestant.title,
        x=tuple(x for x, _ in ran),
        seconds=tuple(median(row.seconds) for _, row in ran),
        build=tuple(row.build or 0.0 for _, row in ran),
        why=why,
    )


def empty_run(scenes: Sequence[BenchScene], settings: Settings) -> Run:
    """A run that has timed nothing yet."""
    recorded = {name: value for name, value in asdict(settings).items() if name != "timeout"}
    return Run(
        recorded,
        machine_properties(),
        tuple(scene.name for scene in scenes),
        bytes_of_pixel=CHANNELS * BYTES_PER_CHANNEL,
    )


class BenchmarkRun:
    """Times scenes and sweeps; `run` holds the results so far."""

    def __init__(self, scenes: Sequence[BenchScene], settings: Settings, start: Start = start_process) -> None:
        self.scenes, self.settings, self.start = scenes, settings, start
        self.run = empty_run(scenes, settings)

    def time_scenes(self, on_progress: Progress, on_result: Callable[[SceneResult], None]) -> None:
        """on_result: called with each scene's result as soon as it is there."""
        for scene in self.scenes:
            given = self.settings
            contestants = contestants_for(scene.workload, peers=given.peers, aovs=scene.aovs)
            casts = scene.workload in ALL_TASKS and scene.aovs == AOVS
            if given.candidate and casts:
                served, precision = given.candidate_served, given.candidate_precision
                contestants.append(candidate_contestant(given.candidate, precision, served=served))
            words = f"{len(self.run.scenes) + 1}/{len(self.scenes)} {scene.name}"
            report = prefixed(on_progress, words)
            result = time_scene(scene, contestants, given, report, self.start, judged=scene.aovs == AOVS)
            self.run = replace(self.run, scenes=(*self.run.scenes, result))
            on_result(result)

    def sweep(self, families: Sequence[ScalingFamily], on_progress: Progress) -> None:
        for family in families:
            found = run_sweep(family, self.settings, on_progress, self.start)
            self.run = replace(self.run, sweeps=(*self.run.sweeps, found))


def prefixed(on_progress: Progress, where: str) -> Progress:
    return lambda words: on_progress(f"{where}: {words}")
