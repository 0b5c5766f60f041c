"""A benchmark run: properties of the machine, and the results of its scenes."""

import os
import platform
import re
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from caster import __version__
from mitsuba_ref.bench.casters import TimedCaster, casters_for, processors
from mitsuba_ref.bench.drivers import AOVS
from mitsuba_ref.bench.measuring import Progress, Settings, time_scene
from mitsuba_ref.bench.result import SceneResult
from mitsuba_ref.bench.scenes import BenchScene
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT
from mitsuba_ref.report.results import libllvm, versions

PACKAGES = ("numpy", "numba", "mitsuba", "drjit")
GIT_SECONDS = 10.0  # for the name of a commit
CPU_INFO = Path("/proc/cpuinfo")  # of Linux


def machine_properties() -> dict[str, str]:
    """Properties of the machine and of the software that times depend on."""
    named = re.search(r"model name\s*: (.*)", CPU_INFO.read_text(errors="replace")) if CPU_INFO.exists() else None
    found = {
        "processor": named[1] if named else platform.machine(),
        "processors used": f"{processors()} of {os.cpu_count() or 1}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "Python": platform.python_version(),
        "load before": f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown",
        "caster": __version__,
        "revision": revision(),
    }
    return found | versions(*PACKAGES) | {"libLLVM": libllvm()}


def revision() -> str:
    """The commit of these sources, where they are in a repository."""
    command = ["git", "-C", str(PACKAGE_PARENT), "describe", "--always", "--dirty", "--abbrev=10"]
    described = subprocess_runner.run(command, GIT_SECONDS) if shutil.which("git") else None
    return described.output.strip() if described and described.code == 0 else "unknown"


def timed_scenes(
    scenes: Sequence[BenchScene], settings: Settings, candidate: TimedCaster | None, on_progress: Progress
) -> Iterator[SceneResult]:
    """Time scene after scene."""
    for i, scene in enumerate(scenes):
        casters = casters_for(scene.workload, scene.aovs)
        if candidate and scene.aovs == AOVS:
            casters.append(candidate)
        report = partial(lambda where, words: on_progress(f"{where}: {words}"), f"{i + 1}/{len(scenes)} {scene.name}")
        yield time_scene(scene, casters, settings, report, judged=scene.aovs == AOVS)
