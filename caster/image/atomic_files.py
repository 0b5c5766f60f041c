"""Atomic file writes: a file is written completely or not at all."""

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from caster.description.errors import SceneError

__all__ = ["OutputError", "atomic_write", "check_folder", "check_writable", "write_bytes", "write_text"]

WRITE_ERRNOS = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES)


class OutputError(SceneError):
    """A file that cannot be written; no partial file is left behind."""

    exit_code = 4


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if no file can be created at this path; to be called before long work."""
    with _os_errors_as_output_errors(target := _resolved_target(path)):
        _create_temporary(target).unlink()


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


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file beside `path`, renamed to it if the body succeeds and removed if it fails.

    Any exception of the body becomes an OutputError; an existing file of that name is then unchanged.
    """
    with _os_errors_as_output_errors(target := _resolved_target(path)):
        temporary = _create_temporary(target)  # an invalid folder fails before any work
        try:
            yield temporary
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)


def _resolved_target(path: str | os.PathLike[str]) -> Path:
    target = Path(os.path.realpath(path))  # resolves links, so that a link stays a link
    if target.exists() and not target.is_file():
        raise OutputError(f"{target}: expected a file to write, this is a folder or a device")
    return target


def _create_temporary(target: Path) -> Path:
    """Create an empty temporary file beside the target, with permissions by the umask."""
    temporary = target.parent / f".{secrets.token_hex(8)}.part"
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return temporary


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
