"""The cache folder of compiled kernels, whose name changes with every source file of the package."""

import atexit
import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
MAX_CACHE_FOLDERS = 4  # one for each of a few checkouts that are worked on in turn
COMPILERS = ("numba", "llvmlite")
WITHOUT_KERNELS = (
    "classroom",
    "cli",
    "image",
)  # folders that no kernel, and no argument of one, comes from


def compiler_version() -> str:
    """Version text of the installed compiler, without loading it; "" where there is none."""
    specs = [find_spec(name) for name in COMPILERS]
    folders = [Path(spec.origin).parent for spec in specs if spec is not None and spec.origin]
    if len(folders) < len(COMPILERS):
        return ""
    return "".join((folder / "_version.py").read_text() for folder in folders)


COMPILED = os.environ.get("CASTER_JIT", "1") != "0" and compiler_version() != ""


def source_hash(version: str) -> str:
    """A name for this source and this compiler.

    Numba does not see an edit in a file that a cached kernel calls into, and a stale kernel is a wrong
    answer: the cache folder changes its name with every source file that could have to do with one instead.
    """
    digest = hashlib.sha256(version.encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.relative_to(PACKAGE).parts[0] in WITHOUT_KERNELS:
            continue
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# Why kernels compiled by this process are not kept: "FOLDER: what is wrong with it".
refusals: list[str] = []


@cache
def cache_folder() -> Path:
    """The folder for this source; below NUMBA_CACHE_DIR if that is set, else below XDG_CACHE_HOME.

    What is loaded from it is run, so nobody else may have written it: a folder that another user owns or may write
    is listed in `refusals`, and a temporary one takes its place.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "caster"
    parents = [Path(chosen)] if chosen else [home, home / "kernels"]
    folder = parents[-1] / source_hash(compiler_version())
    try:
        for each in (*parents, folder):
            each.mkdir(mode=0o700, parents=True, exist_ok=True)
            if why := distrust(each.stat()):
                refusals.append(f"{each}: {why}")
                return _temporary_folder()
        os.utime(folder)
    except OSError:  # a home that cannot be written: compile anew in every process
        return _temporary_folder()
    if not chosen:
        _drop_old_caches(folder.parent)
    return folder


def distrust(found: os.stat_result) -> str:
    """Why a file or folder may hold what another user wrote; "" if only this one can have written it."""
    if not hasattr(os, "geteuid"):  # Windows: each profile's folders are its user's own
        return ""
    if found.st_uid != os.geteuid():
        return "it belongs to another user"
    return "other users may write it" if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""


def _temporary_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="caster-kernels-"))  # which only this user may enter
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _drop_old_caches(parent: Path) -> None:
    with contextlib.suppress(OSError):  # another process drops the same ones
        folders = sorted(parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in folders[MAX_CACHE_FOLDERS:]:
            shutil.rmtree(old, ignore_errors=True)


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file that other processes see whole or not at all; a full disk is no error, only no cache."""
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent)
        try:
            with open(handle, "wb") as file:
                file.write(data)
            os.replace(name, path)
        except OSError:
            os.unlink(name)
            raise


def read_trusted(path: Path) -> bytes:
    """The content of a file that nobody else can have written. Raises OSError for any other."""
    with path.open("rb") as file:
        if why := distrust(os.fstat(file.fileno())):
            raise PermissionError(f"{path}: {why}")
        return file.read()
