"""The files that a command reads: regular files of a limited size, recorded so that the command overwrites none."""

import contextlib
import os
import stat
from collections.abc import Iterator

from caster.description.errors import FileMissing, SceneError

__all__ = ["MAX_TEXT_BYTES", "is_input", "read_input", "record_input", "recorded_inputs"]

MAX_TEXT_BYTES = 2**28  # of a scene file: a million spheres are half of it
MAX_MESH_BYTES = 2**32  # of a mesh file: 80 million triangles in binary PLY

_FileId = tuple[
    int, int
]  # device, inode: the same for hard links, symbolic links and other spellings of a path

_recorded: set[_FileId] | None = (
    None  # None: outside of a command, where a file may be read and written again
)


@contextlib.contextmanager
def recorded_inputs() -> Iterator[None]:
    """Record inputs while the body runs."""
    global _recorded
    before, _recorded = _recorded, set()
    try:
        yield
    finally:
        _recorded = before


def record_input(path: str | os.PathLike[str]) -> None:
    """Record a file that is read; a missing one is ignored."""
    found = file_id(path)
    if _recorded is not None and found is not None:
        _recorded.add(found)


def is_input(path: str | os.PathLike[str]) -> bool:
    """Whether this is a recorded file, by whatever name."""
    return _recorded is not None and file_id(path) in _recorded


def file_id(path: str | os.PathLike[str]) -> _FileId | None:
    """Device and inode of a file; None if there is none."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def read_input(path: str | os.PathLike[str], what: str, max_bytes: int) -> bytes:
    """Content of a regular file, recorded as an input. what: "scene file", in messages.

    Raises FileMissing for a missing or unreadable file and for anything but a file, such as a FIFO, which would block,
    or a device, which has no end; SceneError for a file of more than max_bytes.
    """
    name = os.fspath(path)
    flags = (
        os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    )
    try:
        with os.fdopen(os.open(name, flags), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise FileMissing(
                    f"{name}: cannot read this {what}: expected a file, got {_kind(status.st_mode)}"
                )
            if status.st_size > max_bytes:
                raise SceneError(
                    f"{name}: this {what} is too large: expected at most {max_bytes:,} bytes, got {status.st_size:,}"
                )
            record_input(name)
            return file.read()
    except OSError as error:
        raise FileMissing(f"{name}: cannot read this {what}: {error.strerror or error}") from error
    except ValueError as error:  # a NUL character in the path
        raise FileMissing(f"{name!r}: cannot read this {what}: {error}") from error


def _kind(mode: int) -> str:
    kinds = {"a folder": stat.S_ISDIR, "a FIFO": stat.S_ISFIFO, "a socket": stat.S_ISSOCK}
    return next((name for name, test in kinds.items() if test(mode)), "a device")
