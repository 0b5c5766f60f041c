"""Reading and writing OpenEXR files of named channels and provenance. The only module that imports OpenEXR."""

from __future__ import annotations

import contextlib
import errno
import io
import mmap
import os
import struct
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import opened_input
from caster.image.exr_validation import (
    Part,
    UnreadableExr,
    Window,
    check_all_read,
    check_parts,
    checked_window,
    common_shape,
    header_attributes,
    merged_channel_names,
    merged_provenance,
    to_storable,
    window_of,
)
from caster.system.atomic_files import OutputError, atomic_write

__all__ = ["NO_ID", "Exr", "OutputError", "Part", "UnreadableExr", "Window", "read_exr", "write_exr"]

NO_ID = 0xFFFFFFFF
"""`id.shape` and `id.prim` of a pixel that hits nothing."""

MAGIC = 20000630  # first four bytes of an EXR file, little endian
DEEP, MULTI_PART = 0x800, 0x1000  # flags in the next four bytes
CHUNK_ROWS = 16  # of ZIP compression


class Exr(NamedTuple):
    """An EXR image."""

    channels: dict[str, NDArray[Any]]  # by name: (h, w), float32, float16 or uint32, as stored
    provenance: dict[str, str]  # string attributes, by names that begin with caster/
    data_window: Window  # x0, y0, x1, y1, pixels of the film that the channels hold; x1 and y1 are outside
    display_window: Window  # the whole film, in the same way
    parts: tuple[Part, ...] = ()  # the parts of a multi-part file with their channels


def write_exr(
    path: str | os.PathLike[str],
    channels: Mapping[str, NDArray[Any]],
    provenance: Mapping[str, str] = {},
    *,
    data_window: Window | None = None,
    display_window: Window | None = None,
    threads: int = 1,
) -> None:
    """Write a single-part scanline EXR, float32; the same input gives the same bytes.

    channels: name -> (h, w), any strides; uint32 stays UINT, floats of any width and bools become float32.
    provenance: string attributes `caster/<key>`; a key without `caster/` gets it.
    data_window: where the arrays lie on the film, default (0, 0, w, h).
    display_window: the whole film, default the data window.
    threads: how many compress beside this one; none remain afterwards.
    Raises SceneError for arrays that an EXR cannot hold (another shape, a finite value beyond float32), OutputError if
    the file cannot be written; an older file of that name then stays untouched.
    """
    import OpenEXR  # deferred, so that `--help` does not load it

    height, width = common_shape(channels)
    window = checked_window("data_window", (0, 0, width, height) if data_window is None else data_window)
    film = checked_window("display_window", window if display_window is None else display_window)
    if (window[2] - window[0], window[3] - window[1]) != (width, height):
        raise SceneError(f"data_window {window} does not fit channels of {width} x {height} pixels")
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "lineOrder": OpenEXR.INCREASING_Y,
        "dataWindow": _inclusive(window),
        "displayWindow": _inclusive(film),
        **header_attributes(provenance),
    }
    # The library stores a strided array in its memory order and puts its own objects into the dict that it gets, so it
    # gets contiguous copies in a dict of its own.
    copies = {name: to_storable(name, channels[name], window) for name in sorted(channels)}
    with atomic_write(path) as part:
        with compressing_threads(threads):
            OpenEXR.File(header, copies).write(str(part))
        _check_complete(part, -(-height // CHUNK_ROWS))


@contextlib.contextmanager
def compressing_threads(count: int) -> Iterator[None]:
    """Let OpenEXR use threads while the body writes. None remain, since a fork of this process would wait for them."""
    import OpenEXR

    if count < 2:
        yield
        return
    OpenEXR.set_global_thread_count(count)
    try:
        yield
    finally:
        OpenEXR.set_global_thread_count(0)


def _check_complete(path: Path, chunk_count: int) -> None:
    """Raise OSError for a truncated file: OpenEXR does not check that its last buffer was written."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            at = 8  # the first attribute: name, type, size, value
            while data[at]:
                name = data.find(b"\0", at)
                kind = data.find(b"\0", name + 1)
                at = kind + 5 + struct.unpack_from("<I", data, kind + 1)[0]
            chunks = struct.unpack_from(f"<{chunk_count}Q", data, at + 1)
            (size,) = struct.unpack_from("<4xi", data, max(chunks))
            whole = min(chunks) > at and max(chunks) + 8 + size == len(data)
    except (ValueError, IndexError, struct.error):
        whole = False
    if not whole:
        raise OSError(errno.ENOSPC, "the file was not written to its end, as on a full disk")


def read_exr(path: str | os.PathLike[str]) -> Exr:
    """Read all channels of a file, of all its parts, in the types in which they are stored.

    A channel without a layer (`Z`) gets the name of its part (`depth.Z`), unless the part is called `rgba`, `rgb`,
    `beauty`, `combined` or `main`. Of several resolutions, the finest is read.
    Raises FileMissing if there is no such file, UnreadableExr if it is not a complete, flat EXR image, or if its parts
    are not layers of one image, such as parts of different sizes or of several views.
    """
    path = Path(path)
    read = _decode_multi_part(path) if _is_multi_part(path) else [_decode(path)[0]]
    names = {part.name(): part.channels for part in read}
    called = merged_channel_names(path, names) if len(read) > 1 else {}
    header = read[0].header
    window = window_of(header["dataWindow"])
    channels: dict[str, np.ndarray] = {}
    parts: list[Part] = []
    for part in read:
        mine = {called.get((part.name(), name), name): channel for name, channel in part.channels.items()}
        channels |= {name: _pixels(path, name, channel, window) for name, channel in mine.items()}
        parts.append(Part(part.name(), tuple(sorted(mine))))
    return Exr(
        dict(sorted(channels.items())),
        merged_provenance(path, [part.header for part in read]),
        window,
        window_of(header["displayWindow"]),
        tuple(parts) if len(parts) > 1 else (),
    )


def _inclusive(window: Window) -> tuple[tuple[int, int], tuple[int, int]]:
    x0, y0, x1, y1 = window
    return (x0, y0), (x1 - 1, y1 - 1)


def _is_multi_part(path: Path) -> bool:
    """Whether a file is a multi-part EXR. Raises FileMissing, and UnreadableExr for anything but a flat EXR image."""
    if not os.path.lexists(path):
        raise FileMissing(f"{path}: no such file")
    try:
        with opened_input(path, "EXR image") as file:
            start = file.read(8)
    except FileMissing as e:
        raise UnreadableExr(str(e)) from e
    if not start:
        raise UnreadableExr(f"{path}: expected an EXR image, the file is empty (0 bytes)")
    magic, flags = struct.unpack("<II", start.ljust(8, b"\0"))
    if magic != MAGIC:
        text = start[:4].decode("latin-1").strip()
        raise UnreadableExr(f"{path}: expected an EXR image, got a file that starts with '{text}'")
    if flags & DEEP and not flags & MULTI_PART:
        raise UnreadableExr(f"{path}: a deep EXR has many samples per pixel; write a flat one")
    return bool(flags & MULTI_PART)


def _decode_multi_part(path: Path) -> list[Any]:
    """Decode all parts of a multi-part file, after checking that they are layers of one image."""
    headers = [part.header for part in _decode(path, header_only=True)]
    check_parts(path, headers)
    read = _decode(path)
    check_all_read(path, headers, [part.name() for part in read])
    return read


def _decode(path: Path, *, header_only: bool = False) -> list[Any]:
    """Decode the parts of a file. Raises UnreadableExr if none is left, as the library drops damaged ones."""
    import OpenEXR

    size = path.stat().st_size
    damaged = UnreadableExr(f"{path}: a damaged or truncated EXR ({size} bytes); write it again")
    try:
        with _library_output_suppressed():
            file = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except Exception as e:
        raise damaged from e
    if not file.parts:  # a part that fails to decode is dropped by the library
        raise damaged
    return list(file.parts)


def _pixels(path: Path, name: str, channel: Any, window: Window) -> np.ndarray:
    x0, y0, x1, y1 = window
    shape = np.shape(channel.pixels)
    if shape != (y1 - y0, x1 - x0):
        raise UnreadableExr(f"{path}: channel '{name}' has {shape} values for window {window}: subsampled")
    return np.array(channel.pixels)  # copied: the library's array lives only as long as its part


_redirection_lock = threading.Lock()


@contextlib.contextmanager
def _library_output_suppressed() -> Iterator[None]:
    """Suppress messages that the library prints to sys.stdout and to file descriptor 2."""
    with _redirection_lock, contextlib.redirect_stdout(io.StringIO()), open(os.devnull, "wb") as nowhere:
        try:
            terminal = os.dup(2)
        except OSError:  # no standard error at all
            yield
            return
        try:
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
