"""A benchmark run: the machine, and scene after scene."""

import os
import platform
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from caster import __version__
from mitsuba_ref.bench.contestants import Contestant, contestants_for, processors
from mitsuba_ref.bench.entries import AOVS
from mitsuba_ref.bench.measuring import Progress, Settings, Start, start_process, time_scene
from mitsuba_ref.bench.result import Run, SceneResult
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT
from mitsuba_ref.report.results import libllvm, versions

PACKAGES = ("numpy", "numba", "mitsuba", "drjit", "open3d", "trimesh", "embreex")
GIT_SECONDS = 10.0  # for the name of a commit


def machine_properties() -> dict[str, str]:
    """Properties of the machine and of the software that times depend on."""
    found = {
        "processor": first_match("/proc/cpuinfo", r"model name\s*: (.*)") or platform.machine(),
        "processors used": f"{processors()} of {os.cpu_count() or 1}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "Python": platform.python_version(),
        "load before": f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown",
        "caster": __version__,
        "revision": revision(),
    }
    return found | versions(*PACKAGES) | {"libLLVM": libllvm()}


def first_match(file: str, pattern: str) -> str:
    path = Path(file)
    found = re.search(pattern, path.read_text(errors="replace")) if path.exists() else None
    return found[1] if found else ""


def revision() -> str:
    """The commit of these sources, where they are in a repository."""
    command = ["git", "-C", str(PACKAGE_PARENT), "describe", "--always", "--dirty", "--abbrev=10"]
    described = subprocess_runner.run(command, GIT_SECONDS) if shutil.which("git") else None
    return described.output.strip() if described and described.code == 0 else "unknown"


class BenchmarkRun:
    """Times scenes; `run` holds the results so far."""

    def __init__(
        self,
        scenes: Sequence[BenchScene],
        settings: Settings,
        candidate: Contestant | None = None,
        start: Start = start_process,
    ) -> None:
        self.scenes, self.settings, self.candidate, self.start = scenes, settings, candidate, start
        recorded = asdict(settings) | {"candidate": candidate.title if candidate else ""}
        self.run = Run(recorded, machine_properties(), tuple(scene.name for scene in scenes))

    def time_scenes(self, on_progress: Progress, on_result: Callable[[SceneResult], None]) -> None:
        """on_result: called with each scene's result as soon as it is there."""
        for i, scene in enumerate(self.scenes):
            contestants = contestants_for(scene.workload, peers=self.settings.peers, aovs=scene.aovs)
            if self.candidate and scene.aovs == AOVS:
                contestants.append(self.candidate)
            where = f"{i + 1}/{len(self.scenes)} {scene.name}"
            report = partial(lambda where, words: on_progress(f"{where}: {words}"), where)
            result = time_scene(scene, contestants, self.settings, report, self.start, judged=scene.aovs == AOVS)
            self.run = replace(self.run, scenes=(*self.run.scenes, result))
            on_result(result)
