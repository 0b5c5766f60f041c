"""Folders of compiled kernels, named after the sources: the cache, and what a wheel brings. Files have a digest."""

import atexit
import contextlib
import hashlib
import os
import pickle
import shutil
import stat
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
MAX_CACHE_FOLDERS = 4  # one for each of a few checkouts that are worked on in turn
COMPILERS = ("numba", "llvmlite")
WITHOUT_KERNELS = ("classroom", "cli", "image", "system")  # folders that no kernel, and no argument of one, comes from
INSTALLED = PACKAGE / "jit" / "object_code"  # in wheels that bring object code (.ci/wheel_with_kernels.py)
NOWHERE = Path(os.devnull) / "kernels"  # a folder that cannot exist: nothing is read, nothing written


def compiler_version() -> str:
    """Version text of the installed compiler, without loading it; "" where there is none."""
    specs = [find_spec(name) for name in COMPILERS]
    folders = [Path(spec.origin).parent for spec in specs if spec is not None and spec.origin]
    if len(folders) < len(COMPILERS):
        return ""
    return "".join((folder / "_version.py").read_text() for folder in folders)


COMPILED = os.environ.get("CASTER_JIT", "1") != "0" and compiler_version() != ""


def source_hash(version: str, sources: bytes | None = None) -> str:
    """A name for these sources, by default those of now, and this compiler.

    Numba does not see an edit in a file that a cached kernel calls into, and a stale kernel is a wrong
    answer: the cache folder changes its name with every source file that could have to do with one instead.
    """
    return hashlib.sha256(version.encode() + (sources or source_digest())).hexdigest()[:16]


def source_digest() -> bytes:
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.relative_to(PACKAGE).parts[0] in WITHOUT_KERNELS:
            continue
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.digest()


_digest_at_start = cache(source_digest)  # of the sources that this process runs


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
    folder = parents[-1] / source_hash(compiler_version(), _digest_at_start())
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


@cache
def installed_folder() -> Path | None:
    """What the wheel brought for these very sources, a folder for each level of processors; None: nothing.

    The compiler that made it need not be the installed one: object code calls nothing of it.
    """
    if not INSTALLED.is_dir():
        return None
    folder = INSTALLED / source_hash("", _digest_at_start())
    return folder if folder.is_dir() and not distrust_installed(folder.stat()) else None


def distrust_installed(found: os.stat_result) -> str:
    """Why somebody may have written an installed file who cannot write the program itself; "" if nobody."""
    program = os.stat(__file__)
    if found.st_uid != program.st_uid:
        return "it belongs to another user than the program"
    more = found.st_mode & ~program.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return "more users may write it than the program" if more else ""


def distrust(found: os.stat_result) -> str:
    """Why a file or folder may hold what another user wrote; "" if only this one can have written it."""
    if not hasattr(os, "geteuid"):  # Windows: each profile's folders are its user's own
        return ""
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
                file.flush()
                os.fsync(handle)  # or a name could outlive a power cut without its content
            os.replace(name, path)
        except OSError:
            os.unlink(name)
            raise


def write_sealed(path: Path, data: bytes) -> None:
    """Write a file below the SHA-256 of its name and content; OSErrors are dropped, as in `write_atomically`."""
    write_atomically(path, _seal(path, data) + b"\n" + data)


def read_sealed(path: Path, distrusted: Callable[[os.stat_result], str] = distrust) -> bytes:
    """The content of a file as `write_sealed` wrote it under this name.

    Raises OSError where it cannot be read or another user may have written it, ValueError where any byte differs.
    """
    with path.open("rb") as file:
        if why := distrusted(os.fstat(file.fileno())):
            raise PermissionError(f"{path}: {why}")
        seal, _, data = file.read().partition(b"\n")
    if seal != _seal(path, data):
        raise ValueError(f"{path}: its digest does not fit its content")
    return data


def _seal(path: Path, data: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + data).hexdigest().encode()


class CompileResultCache:
    """Numba's cache interface of one dispatcher over sealed files; what cannot be loaded is compiled again.

    Numba's own files are pickles without a digest: a flipped bit in one is executed. name: of the function; keeps:
    whether results for a signature may be kept; numba: the loaded module. Nothing here raises: without a cache
    everything is compiled.
    """

    cache_path = None  # Numba lists it among a dispatcher's statistics

    def __init__(self, name: str, keeps: Callable[[Any], bool], numba: Any) -> None:
        self._name, self._keeps, self._numba = name, keeps, numba

    def load_overload(self, signature: Any, context: Any) -> Any:
        if not self._keeps(signature):
            return None
        context.refresh()
        key = (signature, context.codegen().magic_tuple())
        path = self._path(key)
        try:
            kept_key, payload = pickle.loads(read_sealed(path))
            if kept_key != key:  # two classes of one name
                return None
            return self._numba.core.compiler.CompileResult._rebuild(context, *payload)
        except FileNotFoundError:
            return None
        except Exception:  # whatever a damaged or foreign file leads to: it is compiled once more
            with contextlib.suppress(OSError):
                path.unlink()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        if not self._keeps(signature) or result.lifted or result.library.has_dynamic_globals:
            return
        key = (signature, result.codegen.magic_tuple())
        write_sealed(self._path(key), self._numba.core.serialize.dumps((key, result._reduce())))

    def _path(self, key: Any) -> Path:
        digest = hashlib.sha256(f"{self._name}\n{key}".encode()).hexdigest()[:32]
        return cache_folder() / f"{self._name.rpartition('.')[2]}-{digest}.numba"
