"""The store of results between runs, each under a hash of all that it depends on.

It holds Mitsuba's responses (mitsuba_process.py), verdicts of scenes (runner/verdict_files.py) and which variants work
(variants.py). Files are checked when they are read; a damaged one counts as missing.
"""

import hashlib
import importlib.metadata
import os
import platform
import random
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from caster.system import processor
from caster.system.atomic_files import distrust, read_sealed, write_sealed
from mitsuba_ref.reference.interpreter import installation, interpreter

STORE_VARIABLE = "MITSUBA_REF_STORE"  # a folder, or OFF
LIMIT_VARIABLE = "MITSUBA_REF_STORE_MB"  # how large it may become, in 10^6 bytes
OFF = "off"
DEFAULT_LIMIT_MB = 1000  # 130 responses of 256 x 256 rays
SUFFIX = ".kept"
# How often, on average, all files are listed while as many bytes as the limit are stored, so that the store exceeds it
# by some 64th. With a listing each, storing 1,000 files of 9 kB took 37 ms a file, more than to judge a small scene.
LISTINGS = 64
LIBRARIES = ("mitsuba", "drjit", "numpy", "numba", "llvmlite", "OpenEXR", "pydantic")  # that results depend on


@dataclass(frozen=True)
class StoreFolder:
    """Results as sealed files in one folder of this user. The least recently used ones make room for others."""

    folder: Path
    limit: int  # bytes of all files

    def get(self, key: str) -> bytes | None:
        """The bytes stored under a key; None where there are none, or none to be trusted. Never raises."""
        path = self.folder / f"{key}{SUFFIX}"
        try:
            content = None if self.refusal() else read_sealed(path)
            os.utime(path)  # used
            return content
        except (OSError, ValueError):  # missing, another user's, or damaged
            with suppress(OSError):
                path.unlink()
            return None

    def put(self, key: str, content: bytes) -> None:
        """Store bytes under a key; they may be dropped at any time. Never raises."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError:
            return
        if not self.refusal() and len(content) < self.limit:
            if random.random() * self.limit < len(content) * LISTINGS:
                self._make_room(len(content))
            write_sealed(self.folder / f"{key}{SUFFIX}", content)

    def refusal(self) -> str:
        """Why the folder is not used, such as that other users may write it; "" if it is."""
        with suppress(FileNotFoundError):
            return distrust(self.folder.stat())
        return ""

    def use(self) -> tuple[int, int]:
        """How many files it has, and their bytes."""
        files = list(self._files())
        return len(files), sum(size for _, size, _ in files)

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        """(time of the last use, bytes, path) of each file, in any order."""
        with suppress(OSError):
            for path in self.folder.glob(f"*{SUFFIX}"):
                with suppress(OSError):  # another process removes it
                    found = path.stat()
                    yield found.st_mtime_ns, found.st_size, path

    def _make_room(self, needed: int) -> None:
        files = sorted(self._files())
        excess = sum(size for _, size, _ in files) + needed - self.limit
        for _, size, path in files:
            if excess <= 0:
                return
            with suppress(OSError):
                path.unlink()
                excess -= size


def user_store() -> StoreFolder:
    """The store in this user's cache folder."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    megabytes = os.environ.get(LIMIT_VARIABLE, "")
    limit = int(megabytes) if megabytes.isdecimal() else DEFAULT_LIMIT_MB
    return StoreFolder(Path(home) / "caster" / "store", limit * 10**6)


def local_store() -> StoreFolder | None:
    """The store of this machine, or the folder that STORE_VARIABLE names; None where that is OFF."""
    chosen = os.environ.get(STORE_VARIABLE)
    if chosen == OFF:
        return None
    store = user_store()
    return StoreFolder(Path(chosen), store.limit) if chosen else store


def key_of(parts: Iterable[str | bytes]) -> str:
    """A hash of all parts, in their order."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else part.encode(errors="surrogateescape")
        digest.update(b"%d\n" % len(data) + data)
    return digest.hexdigest()


# Prefixes of environment variables that Dr.Jit, Embree and the loader of libraries read: a preloaded library can limit
# the instruction set.
REFERENCE_SETTINGS = ("DRJIT_", "EMBREE_", "LD_")


def environment_settings(*prefixes: str) -> str:
    """The environment variables with these prefixes, for a key."""
    return repr(sorted(item for item in os.environ.items() if item[0].startswith(prefixes)))


def machine() -> dict[str, str]:
    """System, processor and versions of the libraries that results depend on; Mitsuba's of the chosen interpreter.

    Raises SceneError for an interpreter that cannot be used.
    """
    if interpreter() == sys.executable:
        return this_machine()
    chosen = installation()
    return {**this_machine(), **chosen.versions, BUILD: chosen.build}


BUILD = "build"  # of Mitsuba, where another interpreter runs it
PROCESSOR = "processor"


@cache
def this_machine() -> dict[str, str]:
    """The same for this interpreter."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        PROCESSOR: processor.description(),
        "python": platform.python_version(),
        **{name: installed_version(name) for name in LIBRARIES},
    }


def installed_version(name: str) -> str:
    """The version of a distribution; "none" where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"
