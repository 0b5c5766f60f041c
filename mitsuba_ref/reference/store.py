"""The store: what is kept between runs under a hash of all that it depends on, so that it is not worked out again.

It holds Mitsuba's responses (mitsuba_process.py), verdicts of scenes (runner/verdict_files.py) and which variants work
(variants.py). Contents are checked when they are read; a damaged one is as if it were not there.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import platform
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple, Protocol

from caster.system import processor
from caster.system.atomic_files import distrust, read_sealed, write_sealed

STORE_VARIABLE = "MITSUBA_REF_STORE"  # a folder, or OFF
LIMIT_VARIABLE = "MITSUBA_REF_STORE_MB"  # how large it may become, in 10^6 bytes
OFF = "off"
DEFAULT_LIMIT_MB = 1000  # 130 responses of 256 x 256 rays
SUFFIX = ".kept"
LIBRARIES = ("mitsuba", "drjit", "numpy", "numba", "llvmlite", "OpenEXR", "pydantic")  # that results depend on


class Store(Protocol):
    """Where contents are kept. Neither method raises; a store of several machines needs no more than these two."""

    def get(self, key: str) -> bytes | None:
        """What was kept under a key, to the bit; None where there is nothing, or nothing to be trusted."""

    def put(self, key: str, content: bytes) -> None:
        """Keep content under a key; it may be dropped at any time."""


class StoreUse(NamedTuple):
    """What a folder holds."""

    files: int
    size: int  # bytes


class StoreFolder:
    """Contents as sealed files of one folder, of this user alone. The least recently used ones make room for others."""

    def __init__(self, folder: Path, limit: int) -> None:
        """limit: bytes of all files."""
        self.folder, self.limit = folder, limit

    def get(self, key: str) -> bytes | None:
        path = self.folder / f"{key}{SUFFIX}"
        try:
            content = None if self.refusal() else read_sealed(path)
            os.utime(path)  # used
        except FileNotFoundError:
            return None
        except (OSError, ValueError):  # another user's, or damaged
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return content

    def put(self, key: str, content: bytes) -> None:
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError:
            return
        if not self.refusal() and len(content) < self.limit:
            self._make_room(len(content))
            write_sealed(self.folder / f"{key}{SUFFIX}", content)

    def refusal(self) -> str:
        """Why nothing in it is used, "" where it may be: what another user may have written is no result."""
        with contextlib.suppress(FileNotFoundError):
            return distrust(self.folder.stat())
        return ""

    def use(self) -> StoreUse:
        files = list(self._files())
        return StoreUse(len(files), sum(size for _, size, _ in files))

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        """(time of the last use, bytes, path) of each, in any order."""
        with contextlib.suppress(OSError):
            for path in self.folder.glob(f"*{SUFFIX}"):
                with contextlib.suppress(OSError):  # another process removes it
                    found = path.stat()
                    yield found.st_mtime_ns, found.st_size, path

    def _make_room(self, needed: int) -> None:
        files = sorted(self._files())
        excess = sum(size for _, size, _ in files) + needed - self.limit
        for _, size, path in files:
            if excess <= 0:
                return
            with contextlib.suppress(OSError):
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


# Beginnings of names of environment variables that Dr.Jit, Embree and the loader of libraries read: a preloaded library
# can limit the instruction set.
REFERENCE_SETTINGS = ("DRJIT_", "EMBREE_", "LD_")


def environment_settings(*beginnings: str) -> str:
    """The environment variables whose names begin so, for a key."""
    return repr(sorted(item for item in os.environ.items() if item[0].startswith(beginnings)))


@cache
def machine() -> dict[str, str]:
    """System, processor and versions of the libraries that results depend on."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": processor.description(),
        "python": platform.python_version(),
        **{name: installed_version(name) for name in LIBRARIES},
    }


def installed_version(name: str) -> str:
    """The version of a distribution; "none" where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"
