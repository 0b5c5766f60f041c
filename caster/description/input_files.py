"""The files that a command reads: regular files of a limited size, recorded so that the command overwrites none."""

import contextlib
import os
import stat
from collections.abc import Iterator
from typing import IO

from caster.description.errors import FileMissing, SceneError

__all__ = ["MAX_TEXT_BYTES", "is_input", "opened_input", "read_input", "read_own", "record_input", "recorded_inputs"]

MAX_TEXT_BYTES = 2**28  # of a scene file: a million spheres are half of it
MAX_MESH_BYTES = 2**32  # of a mesh file: 80 million triangles in binary PLY

_FileId = tuple[int, int]  # device, inode: the same for hard links, symbolic links and other spellings of a path

# Each with the path that it was read by. None: outside of a command, where a file may be read and written again.
_recorded: dict[_FileId, str] | None = None


@contextlib.contextmanager
def recorded_inputs() -> Iterator[None]:
    """Record inputs while the body runs."""
    global _recorded
    before, _recorded = _recorded, {}
    try:
        yield
    finally:
        _recorded = before


def record_input(path: str | os.PathLike[str]) -> None:
    """Record a file that is read; a missing one is ignored."""
    found = file_id(path)
    if _recorded is not None and found is not None:
        _recorded[found] = os.path.abspath(path)


def is_input(path: str | os.PathLike[str]) -> bool:
    """Whether this is a recorded file, by whatever name; not a later file with the inode of one that was removed."""
    found = file_id(path)
    if _recorded is None or found is None or found not in _recorded:
        return False
    return file_id(_recorded[found]) == found


def file_id(path: str | os.PathLike[str]) -> _FileId | None:
    """Device and inode of a file; None if there is none."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def read_input(path: str | os.PathLike[str], what: str, max_bytes: int) -> bytes:
    """Content of a regular file, recorded as an input; what and errors as of `opened_input`.

    Raises SceneError for a file of more than max_bytes.
    """
    with opened_input(path, what) as (file, size):
        if size > max_bytes:
            raise SceneError(
                f"{os.fspath(path)}: this {what} is too large: expected at most {max_bytes:,} bytes, got {size:,}"
            )
        record_input(path)
        return file.read()


def read_own(path: str | os.PathLike[str], what: str) -> str:
    """Text that this project wrote and may write again, such as a manifest: not recorded as an input.

    Raises FileMissing, SceneError for a text of more than MAX_TEXT_BYTES, or one that is not in UTF-8.
    """
    with opened_input(path, what) as (file, size):
        if size > MAX_TEXT_BYTES:
            raise SceneError(f"{os.fspath(path)}: this {what} is too large: {size:,} bytes")
        try:
            return file.read().decode("utf-8")
        except UnicodeDecodeError as error:
            raise SceneError(f"{os.fspath(path)}: this {what} is not a text in UTF-8") from error


@contextlib.contextmanager
def opened_input(path: str | os.PathLike[str], what: str) -> Iterator[tuple[IO[bytes], int]]:
    """An open regular file and its size. what: "scene file", in messages.

    Raises FileMissing for a missing or unreadable file, also while the body reads it, and for anything but a file,
    such as a FIFO, which would block, or a device, which has no end.
    """
    name = os.fspath(path)
    if "\0" in str(name):
        raise FileMissing(f"{name!r}: cannot read this {what}: a NUL character in its name")
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(name, flags), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise FileMissing(f"{name}: cannot read this {what}: expected a file, got {_kind(status.st_mode)}")
            yield file, status.st_size
    except OSError as error:
        raise FileMissing(f"{name}: cannot read this {what}: {error.strerror or error}") from error


def _kind(mode: int) -> str:
    kinds = {"a folder": stat.S_ISDIR, "a FIFO": stat.S_ISFIFO, "a socket": stat.S_ISSOCK}
    return next((name for name, test in kinds.items() if test(mode)), "a device")
