"""The files that a command reads, recorded so that none of them is overwritten by the same command."""

import contextlib
import os
from collections.abc import Iterator

__all__ = ["is_input", "record_input", "recorded_inputs"]

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
