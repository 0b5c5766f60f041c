"""Atomic file writes and temporary folders."""

import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from caster.description.errors import SceneError
from caster.description.input_files import FileName
from caster.jit.kernel_cache import distrust, read_sealed, write_sealed

__all__ = [
    "OutputError",
    "ScratchFolder",
    "append_text",
    "atomic_write",
    "check_folder",
    "distrust",
    "read_sealed",
    "write_bytes",
    "write_sealed",
    "write_text",
]


class OutputError(SceneError):
    """A file that cannot be written; no partial file is left behind."""

    exit_code = 4


def check_writable(path: FileName) -> None:
    """Raise OutputError if no file can be created at this path; to be called before long work."""
    with _os_errors_as_output_errors(target := _resolved_target(path)), _temporary_file(target):
        pass


def check_folder(path: FileName) -> Path:
    """Create a folder if it does not exist. Raises OutputError."""
    folder = Path(path)
    with _os_errors_as_output_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_text(path: FileName, text: str) -> None:
    """Write a UTF-8 text file atomically. Raises OutputError."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: FileName, content: bytes) -> None:
    """Write a binary file atomically. Raises OutputError."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def append_text(path: FileName, text: str) -> None:
    """Append to a UTF-8 text file, or create it. Raises OutputError, also for a FIFO or a device."""
    target = _resolved_target(path)
    with _os_errors_as_output_errors(target), target.open("a", encoding="utf-8") as file:
        file.write(text)


@contextmanager
def atomic_write(path: FileName) -> Iterator[Path]:
    """A temporary file beside `path`, renamed to it if the body succeeds and removed if it fails.

    An OSError of the body becomes an OutputError. After any exception an existing file of that name is unchanged.
    """
    target = _resolved_target(path)
    with _os_errors_as_output_errors(target), _temporary_file(target) as temporary:
        yield temporary
        os.replace(temporary, target)


def _resolved_target(path: FileName) -> Path:
    target = Path(os.path.realpath(path))  # so that a link stays a link
    if target.exists() and not target.is_file():
        raise OutputError(f"{target}: expected a file to write, this is a folder or a device")
    return target


@contextmanager
def _temporary_file(target: Path) -> Iterator[Path]:
    """An empty file beside the target, with permissions by the umask; removed at the end."""
    temporary = target.parent / f".{secrets.token_hex(8)}.part"
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    _temporaries.add(temporary)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        _temporaries.discard(temporary)


class ScratchFolder(tempfile.TemporaryDirectory[str]):
    """A temporary folder of this process."""

    def __init__(self) -> None:
        super().__init__(prefix="mitsuba-ref-", ignore_cleanup_errors=True)
        _temporaries.add(Path(self.name))

    def cleanup(self) -> None:
        """Remove the folder; a second call does nothing."""
        super().cleanup()
        _temporaries.discard(Path(self.name))


_temporaries: set[Path] = set()  # of this process


def remove_temporaries() -> None:
    """Remove temporary files and folders of this process before it ends without running `finally` clauses."""
    for path in list(_temporaries):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def _os_errors_as_output_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as e:
        where = f"folder {target.parent}"
        if e.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            where = f"{shutil.disk_usage(target.parent).free // 2**20} MiB free in {target.parent}"
        raise OutputError(f"{target}: cannot write: {e.strerror or e} ({where})") from e
