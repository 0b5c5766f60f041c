"""Atomic file writes, and temporary folders: what a process leaves behind is removed by the next one.

Temporary files and folders are locked by the process that uses them. Those without a lock belong to no live process.
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from caster.description.errors import SceneError
from caster.description.input_files import is_input
from caster.jit.kernel_cache import distrust, read_sealed, write_sealed

__all__ = [
    "OutputError",
    "ScratchFolder",
    "append_text",
    "atomic_write",
    "check_folder",
    "check_output",
    "check_writable",
    "distrust",
    "read_sealed",
    "write_bytes",
    "write_sealed",
    "write_text",
]

WRITE_ERRNOS = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES)


class OutputError(SceneError):
    """A file that cannot be written; no partial file is left behind."""

    exit_code = 4


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if no file can be created at this path; to be called before long work."""
    with _os_errors_as_output_errors(target := _resolved_target(path)), _temporary_file(target):
        pass


def check_folder(path: str | os.PathLike[str]) -> Path:
    """Create a folder if it does not exist. Raises OutputError."""
    folder = Path(path)
    with _os_errors_as_output_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file atomically. Raises OutputError."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a binary file atomically. Raises OutputError."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def append_text(path: str | os.PathLike[str], text: str) -> None:
    """Append to a UTF-8 text file, or create it. Raises OutputError, also for a FIFO or a device."""
    target = _resolved_target(path)
    with _os_errors_as_output_errors(target), target.open("a", encoding="utf-8") as file:
        file.write(text)


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file beside `path`, renamed to it if the body succeeds and removed if it fails.

    Any exception of the body becomes an OutputError; an existing file of that name is then unchanged.
    """
    target = _resolved_target(path)
    with _os_errors_as_output_errors(target), _temporary_file(target) as temporary:
        yield temporary
        os.replace(temporary, target)


def check_output(path: str | os.PathLike[str]) -> None:
    """Raise OutputError for a file that this command has read."""
    if is_input(path):
        raise OutputError(f"{path}: not written: this file is an input of the same command; name another one")


def _resolved_target(path: str | os.PathLike[str]) -> Path:
    target = Path(os.path.realpath(path))  # resolves links, so that a link stays a link
    if target.exists() and not target.is_file():
        raise OutputError(f"{target}: expected a file to write, this is a folder or a device")
    check_output(target)
    return target


@contextlib.contextmanager
def _temporary_file(target: Path) -> Iterator[Path]:
    """An empty, locked file beside the target, with permissions by the umask; removed at the end."""
    _remove_abandoned(target.parent, PART)
    while True:
        temporary = target.parent / f".{secrets.token_hex(8)}.part"
        file = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        if _lock(file, temporary):
            break
        os.close(file)
    _temporaries.add(temporary)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        _temporaries.discard(temporary)
        os.close(file)


class ScratchFolder(tempfile.TemporaryDirectory[str]):
    """A locked temporary folder of this process. prefix: of its name, and of the abandoned ones that are removed."""

    def __init__(self, prefix: str = "mitsuba-ref-") -> None:
        _remove_abandoned(Path(tempfile.gettempdir()), re.compile(re.escape(prefix) + r"scratch-\w+"))
        while not self._made(f"{prefix}scratch-"):
            pass
        _temporaries.add(Path(self.name))

    def _made(self, prefix: str) -> bool:
        """Create and lock the folder; False if another process took it for abandoned in between."""
        super().__init__(prefix=prefix, ignore_cleanup_errors=True)
        self._file = -1
        with contextlib.suppress(FileNotFoundError):
            self._file = os.open(self.name, os.O_RDONLY)
            if _lock(self._file, Path(self.name)):
                return True
        self.cleanup()
        return False

    def cleanup(self) -> None:
        """Remove the folder; a second call does nothing."""
        super().cleanup()
        _temporaries.discard(Path(self.name))
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


PART = re.compile(r"\.[0-9a-f]{16}\.part")
_temporaries: set[Path] = set()  # of this process
_searched: set[tuple[Path, str]] = set()  # folders that were searched for abandoned files, once a process


def remove_temporaries() -> None:
    """Remove temporary files and folders of this process, before it is ended without its `finally` clauses."""
    for path in list(_temporaries):
        _remove(path)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Lock a folder while the body runs; False where another process has locked it."""
    file = os.open(folder, os.O_RDONLY)
    try:
        yield _try_lock(file)
    finally:
        os.close(file)


def _try_lock(file: int) -> bool:
    """Lock an open file or folder; False if another process has. File systems without locks: True."""
    if os.name != "posix":
        return True
    import fcntl  # POSIX alone

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _lock(file: int, path: Path) -> bool:
    """Lock a file that was just created; False if another process took it for abandoned in between."""
    if not _try_lock(file):
        return False
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def _remove_abandoned(folder: Path, names: re.Pattern[str]) -> None:
    """Remove this user's files and folders of such names that no process has locked."""
    if os.name != "posix" or (folder, names.pattern) in _searched:
        return
    _searched.add((folder, names.pattern))
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            if names.fullmatch(entry.name) and Path(entry.path) not in _temporaries:
                with contextlib.suppress(OSError):
                    _remove_if_abandoned(entry.path)


def _remove_if_abandoned(path: str) -> None:
    import fcntl  # POSIX alone

    file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        if os.fstat(file).st_uid == os.getuid():
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(Path(path))
    finally:
        os.close(file)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def _os_errors_as_output_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except Exception as e:  # the EXR library raises various types
        raise OutputError(f"{target}: cannot write: {_reason(e, target)}") from e


def _reason(e: Exception, target: Path) -> str:
    if isinstance(e, OSError) and e.strerror:
        return f"{e.strerror} (folder {target.parent})"
    known = [os.strerror(code) for code in WRITE_ERRNOS if os.strerror(code) in str(e)]
    free = shutil.disk_usage(target.parent).free // 2**20
    return f"{known[0] if known else 'the EXR library failed while writing'} ({free} MiB free in {target.parent})"
