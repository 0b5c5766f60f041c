"""Named channels and provenance <-> OpenEXR. The only module that imports OpenEXR."""

from __future__ import annotations

import contextlib
import io
import os
import struct
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.exr_content import PREFIX, Window, attributes_of, checked_window, common_shape, storable
from caster.whole_files import OutputError, written_aside
from caster.wording import FileMissing, SceneError

__all__ = ["NO_ID", "Exr", "OutputError", "UnreadableExr", "Window", "read_exr", "write_exr"]

NO_ID = 0xFFFFFFFF
"""`id.shape` and `id.prim` of a pixel that hits nothing."""

MAGIC = 20000630  # the first four bytes of every EXR file, little endian
DEEP, MULTI_PART = 0x800, 0x1000  # flags in the next four


class UnreadableExr(FileMissing):
    """A file that is there but is not a whole, single-part EXR image."""


class Exr(NamedTuple):
    """channels: name -> (h, w) float32, float16 or uint32, as stored. provenance: `caster/version` etc."""

    channels: dict[str, np.ndarray]
    provenance: dict[str, str]
    data_window: Window
    display_window: Window


def write_exr(
    path: str | os.PathLike[str],
    channels: Mapping[str, np.ndarray],
    provenance: Mapping[str, str] = {},
    *,
    data_window: Window | None = None,
    display_window: Window | None = None,
) -> None:
    """Write a single-part scanline EXR, ZIP, float32; the same input gives the same bytes.

    channels: name -> (h, w), any strides; uint32 stays UINT, floats of any width and bools become float32.
    provenance: string attributes `caster/<key>`; a key without `caster/` gets it.
    data_window: where the arrays lie on the film, default (0, 0, w, h).
    display_window: the whole film, default the data window.
    Raises SceneError for what an EXR cannot hold (another shape, a finite value that float32 cannot),
    OutputError if the file cannot be written; an older file of that name is then still there, untouched.
    """
    import OpenEXR  # here, so that `--help` need not load it

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
        **attributes_of(provenance),
    }
    # The library stores the memory order of a strided array and puts its own objects into the dict it is
    # given: it only ever gets fresh contiguous copies in a dict of ours.
    copies = {name: storable(name, channels[name], window) for name in sorted(channels)}
    with written_aside(path) as part:
        OpenEXR.File(header, copies).write(str(part))


def read_exr(path: str | os.PathLike[str]) -> Exr:
    """Read every channel by name, in the type it is stored in.

    Raises FileMissing if there is no such file, UnreadableExr if it is not a whole, single-part, flat EXR.
    """
    path = Path(path)
    _refuse_what_is_no_image(path)
    part = _decoded(path)
    header = part.header
    data_window = _exclusive(header["dataWindow"])
    return Exr(
        {name: _pixels(path, name, channel, data_window) for name, channel in sorted(part.channels.items())},
        {
            key: value
            for key, value in sorted(header.items())
            if key.startswith(PREFIX) and isinstance(value, str)
        },
        data_window,
        _exclusive(header["displayWindow"]),
    )


def _inclusive(window: Window) -> tuple[tuple[int, int], tuple[int, int]]:
    x0, y0, x1, y1 = window
    return (x0, y0), (x1 - 1, y1 - 1)


def _exclusive(box: Any) -> Window:
    (x0, y0), (x1, y1) = box
    return int(x0), int(y0), int(x1) + 1, int(y1) + 1


def _refuse_what_is_no_image(path: Path) -> None:
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except FileNotFoundError as e:
        raise FileMissing(f"{path}: no such file") from e
    except OSError as e:
        raise UnreadableExr(f"{path}: cannot read: {e.strerror}") from e
    if not start:
        raise UnreadableExr(f"{path}: expected an EXR image, the file is empty (0 bytes)")
    magic, flags = struct.unpack("<II", start.ljust(8, b"\0"))
    if magic != MAGIC:
        raise UnreadableExr(f"{path}: expected an EXR image, the file starts with {start[:4]!r}")
    if flags & DEEP:
        raise UnreadableExr(f"{path}: a deep EXR has many samples a pixel; write a flat one")
    if flags & MULTI_PART:
        # Most readers see the first part only, and would compare that without a word.
        raise UnreadableExr(f"{path}: a multi-part EXR; which part is meant? Write a single-part one")


def _decoded(path: Path) -> Any:
    import OpenEXR

    size = path.stat().st_size
    damaged = UnreadableExr(f"{path}: a damaged or truncated EXR ({size} bytes); write it again")
    try:
        with _silenced():
            file = OpenEXR.File(str(path), separate_channels=True)
    except Exception as e:
        raise damaged from e
    if len(file.parts) != 1:  # a part that fails to decode is dropped by the library
        raise damaged
    return file.parts[0]


def _pixels(path: Path, name: str, channel: Any, window: Window) -> np.ndarray:
    x0, y0, x1, y1 = window
    shape = np.shape(channel.pixels)
    if shape != (y1 - y0, x1 - x0):
        raise UnreadableExr(f"{path}: channel '{name}' has {shape} values for window {window}: subsampled")
    return np.array(channel.pixels)  # a copy of ours: the library's own lives as long as its part


_one_at_a_time = threading.Lock()


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Keep the library's own words from the user: it prints to sys.stdout and to file descriptor 2."""
    with _one_at_a_time, contextlib.redirect_stdout(io.StringIO()), open(os.devnull, "wb") as nowhere:
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
