"""What a run was made on, and with."""

import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Iterator
from pathlib import Path

from caster import __version__
from mitsuba_ref.bench.contestants import processors
from mitsuba_ref.child import HOME
from mitsuba_ref.variants import usable

PACKAGES = ("numpy", "numba", "mitsuba", "drjit", "open3d", "trimesh", "embreex")


def machine() -> dict[str, str]:
    """Name and value of everything that the numbers depend on, as far as it can be told."""
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
    found |= {name: version(name) for name in PACKAGES}
    library = usable().libllvm
    return found | {"libLLVM": Path(library).name if library else "none"}


def processor() -> str:
    return _told("/proc/cpuinfo", "model name") or platform.processor() or platform.machine()


def memory() -> str:
    words = _told("/proc/meminfo", "MemTotal").split()
    return f"{int(words[0]) / 2**20:.1f} GiB" if words else "unknown"


def load() -> str:
    """What the machine did in the last minute, in processors."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


def version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def revision() -> str:
    """The commit of these sources, where they are in a repository."""
    command = ["git", "-C", str(HOME), "describe", "--always", "--dirty", "--abbrev=10"]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return told.stdout.strip()


def _told(file: str, name: str) -> str:
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
