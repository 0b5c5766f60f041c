"""The folder of compiled kernels. A file is named by a digest of all that its content depends on, and has a digest."""

import atexit
import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
MAX_KEPT_KERNELS = 2000  # for some ten versions of each kernel, 100 MB
COMPILERS = ("numba", "llvmlite")
INSTALLED = PACKAGE / "jit" / "object_code"  # in wheels that bring object code (.ci/wheel_with_kernels.py)
NOWHERE = Path(os.devnull) / "kernels"  # a folder that cannot exist


def compiler_version() -> str:
    """Version text of the installed compiler, without loading it; "" where there is none."""
    specs = [find_spec(name) for name in COMPILERS]
    folders = [Path(spec.origin).parent for spec in specs if spec is not None and spec.origin]
    if len(folders) < len(COMPILERS):
        return ""
    return "".join((folder / "_version.py").read_text() for folder in folders)


COMPILED = os.environ.get("CASTER_JIT", "1") != "0" and compiler_version() != ""


# Why kernels compiled by this process are not kept: "FOLDER: what is wrong with it".
refusals: list[str] = []


@cache
def cache_folder() -> Path:
    """The folder of compiled kernels, below XDG_CACHE_HOME.

    Its files are executed, so no other user may be able to write them: a folder that another user owns or may write is
    listed in `refusals`, and a temporary one is used instead.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "caster"
    folder = home / "kernels"
    try:
        for each in (home, folder):
            each.mkdir(mode=0o700, parents=True, exist_ok=True)
            if why := distrust(each.stat()):
                refusals.append(f"{each}: {why}")
                return _temporary_folder()
    except OSError:  # a home that cannot be written: compile anew in every process
        return _temporary_folder()
    with contextlib.suppress(OSError):  # another process drops the same ones
        newest_first = sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime)
        for old in newest_first[MAX_KEPT_KERNELS:]:
            old.unlink(missing_ok=True)
    return folder


def distrust(found: os.stat_result) -> str:
    """Why another user may have written a file or folder; "" if only this user can have."""
    if found.st_uid != os.geteuid():
        return "it belongs to another user"
    return "other users may write it" if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""


def _temporary_folder() -> Path:
    try:
        folder = Path(tempfile.mkdtemp(prefix="caster-kernels-"))  # which only this user may enter
    except OSError:  # a full disk, or none
        return NOWHERE
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@contextlib.contextmanager
def claim(path: Path, *, wait: bool) -> Iterator[bool]:
    """Lock a file that this process wants to make, by one beside it with the suffix .lock; yields whether it may.

    If another process is making it: False, or with `wait` True after that is done or has ended. Without a folder or
    locks, every process may.
    """
    lock = path.with_suffix(".lock")
    try:
        import fcntl

        file = lock.open("a")
    except (OSError, ImportError):
        yield True
        return
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        try:
            yield True
        finally:
            lock.unlink(missing_ok=True)


def write_sealed(path: Path, data: bytes) -> None:
    """Write a file after a line with the SHA-256 of its name and content.

    Other processes see it whole or not at all. OSErrors, as of a full disk, are ignored.
    """
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent)
        try:
            with open(handle, "wb") as file:
                file.write(_seal(path, data) + b"\n" + data)
                file.flush()
                os.fsync(handle)  # or a name could outlive a power cut without its content
            os.replace(name, path)
        except OSError:
            os.unlink(name)
            raise


def read_sealed(path: Path) -> bytes:
    """The content of a file that `write_sealed` wrote under this name.

    Raises OSError if it cannot be read, ValueError if any byte differs. The digest does not protect against users who
    may write the folder; see `distrust`.
    """
    seal, _, data = path.read_bytes().partition(b"\n")
    if seal != _seal(path, data):
        raise ValueError(f"{path}: its digest does not fit its content")
    return data


def _seal(path: Path, data: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + data).hexdigest().encode()
