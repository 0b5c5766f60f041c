"""Properties of the machine and of the software that run times depend on."""

import os
import platform
import re
import shutil
from pathlib import Path

from caster import __version__
from caster.rendering.threads import core_count
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT
from mitsuba_ref.report.results import libllvm, versions

PACKAGES = ("numpy", "numba", "mitsuba", "drjit")
GIT_SECONDS = 10.0  # for the name of a commit
CPU_INFO = Path("/proc/cpuinfo")  # of Linux


def machine_properties() -> dict[str, str]:
    named = re.search(r"model name\s*: (.*)", CPU_INFO.read_text(errors="replace")) if CPU_INFO.exists() else None
    found = {
        "processor": named[1] if named else platform.machine(),
        "processors used": f"{core_count()} of {os.cpu_count() or 1}",
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
