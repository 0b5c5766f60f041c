"""Reading input files: regular files of a limited size only."""

import contextlib
import os
import stat
from collections.abc import Iterator
from io import BufferedReader
from typing import TypeAlias

from caster.description.errors import FileMissing, SceneError

__all__ = ["FileName", "opened_input", "read_input", "read_text"]

FileName: TypeAlias = str | os.PathLike[str]

SCENE_SUFFIXES = (".toml", ".json")
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
MAX_TEXT_BYTES = 2**28  # of a scene file: a million spheres are half of it
MAX_MESH_BYTES = 2**32  # 80 million triangles in binary PLY


def read_input(path: FileName, what: str, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Content of a regular file. `what` and errors as for `opened_input`; SceneError beyond max_bytes."""
    with opened_input(path, what) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise SceneError(
                f"{os.fspath(path)}: this {what} is too large: expected at most {max_bytes:,} bytes, got {size:,}"
            )
        return file.read()


def read_text(path: FileName, what: str = "scene file") -> str:
    """Text of a UTF-8 file. Raises FileMissing, SceneError."""
    try:
        return read_input(path, what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{os.fspath(path)}: this {what} is not UTF-8 text: byte {error.start + 1} is invalid"
        ) from None


@contextlib.contextmanager
def opened_input(path: FileName, what: str) -> Iterator[BufferedReader]:
    """An open regular file. what: what it should be, for messages, such as "scene file".

    Raises FileMissing for a missing or unreadable file, also while the body reads it, and for anything that is not a
    regular file, such as a FIFO, which would block, or a device, which has no end.
    """
    name = os.fspath(path)
    if "\0" in str(name):
        raise FileMissing(f"{name!r}: cannot read this {what}: a NUL character in its name")
    try:
        with os.fdopen(os.open(name, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                got = "a folder" if stat.S_ISDIR(mode) else "a FIFO, a socket or a device"
                raise FileMissing(f"{name}: cannot read this {what}: expected a file, got {got}")
            yield file
    except OSError as error:
        raise FileMissing(f"{name}: cannot read this {what}: {error.strerror or error}") from error
