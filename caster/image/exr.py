"""Reading and writing OpenEXR files of named channels and provenance. The only module that imports OpenEXR."""

import contextlib
import io
import os
import struct
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.description.input_files import FileName, opened_input
from caster.image.exr_validation import (
    UnreadableExr,
    Window,
    check_memory,
    check_parts,
    checked_window,
    common_shape,
    header_attributes,
    merged_channel_names,
    merged_provenance,
    part_name,
    quoted_list,
    to_storable,
    window_of,
)
from caster.system.atomic_files import OutputError, atomic_write

__all__ = ["NO_ID", "Exr", "OutputError", "UnreadableExr", "read_exr", "write_exr"]

NO_ID = 0xFFFFFFFF
"""`id.shape` and `id.prim` of a pixel that hits nothing."""

MAGIC = 20000630  # first four bytes of an EXR file, little endian
VERSION, TILED, LONG_NAMES = 2, 0x200, 0x400  # of the files written here; names may be longer than 31 bytes
ZIP, INCREASING_Y, ONE_LEVEL = 3, 0, 0  # values of attributes
UINT, FLOAT = 0, 2  # types of channels

TILE = 64  # pixels on a side: what OpenEXR's own tools write, and rows of tiles of 65536 pixels stay below 2^22 pixels
# Of zlib, the fastest. The images are 6 to 20 % smaller than by the library, which compresses 16 rows at a time at its
# level 4, and are written in as much time by two threads (every-shape, cornell-box, teapot; 5 and 11 channels).
COMPRESSION_LEVEL = 1


class Exr(NamedTuple):
    """An EXR image."""

    channels: dict[str, NDArray[Any]]  # by name: (h, w), float32, float16 or uint32, as stored
    provenance: dict[str, str]  # string attributes, by names that begin with caster/
    data_window: Window  # x0, y0, x1, y1, pixels of the film that the channels hold; x1 and y1 are outside
    display_window: Window  # the whole film, in the same way
    parts: tuple[str, ...] = ()  # the names of the parts of a multi-part file


def write_exr(
    path: FileName,
    channels: Mapping[str, NDArray[Any]],
    provenance: Mapping[str, str] = {},
    *,
    data_window: Window | None = None,
    display_window: Window | None = None,
    threads: int = 1,
) -> None:
    """Write a single-part EXR file in tiles, float32; the same input gives the same bytes.

    channels: name -> (h, w), any strides; uint32 stays UINT, floats of any width and bools become float32.
    provenance: string attributes `caster/<key>`; a key without `caster/` gets it.
    data_window: where the arrays lie on the film, default (0, 0, w, h).
    display_window: the whole film, default the data window.
    threads: how many compress; none remain afterwards.
    Raises SceneError for arrays that an EXR cannot hold (another shape, a finite value beyond float32), OutputError if
    the file cannot be written; an older file of that name then stays untouched.
    """
    height, width = common_shape(channels)
    window = checked_window("data_window", (0, 0, width, height) if data_window is None else data_window)
    if (window[2] - window[0], window[3] - window[1]) != (width, height):
        raise SceneError(f"data_window {window} does not fit channels of {width} x {height} pixels")
    write_bands(path, [channels], provenance, window, display_window or window, threads)


Attribute = tuple[Any, ...]
"""Type, layout as `struct` has it, values."""


def write_bands(
    path: FileName,
    bands: Iterable[Mapping[str, NDArray[Any]]],
    provenance: Mapping[str, str],
    data_window: Window,
    display_window: Window,
    threads: int,
) -> None:
    """Write an EXR file as `write_exr` does, from bands of its rows, in memory for one of them.

    bands: from the top down, all with the same channels, and of a multiple of TILE rows except for the last one.
    """
    x0, y0, x1, y1 = checked_window("data_window", data_window)
    attributes: dict[str, Attribute] = {
        "compression": ("compression", "B", ZIP),
        "dataWindow": ("box2i", "4i", *_inclusive(data_window)),
        "displayWindow": ("box2i", "4i", *_inclusive(checked_window("display_window", display_window))),
        "lineOrder": ("lineOrder", "B", INCREASING_Y),
        "pixelAspectRatio": ("float", "f", 1.0),
        "screenWindowCenter": ("v2f", "2f", 0.0, 0.0),
        "screenWindowWidth": ("float", "f", 1.0),
        "tiles": ("tiledesc", "2IB", TILE, TILE, ONE_LEVEL),
        **{name: _text("string", text.encode()) for name, text in header_attributes(provenance).items()},
    }
    offsets = np.zeros((-(-(y1 - y0) // TILE), -(-(x1 - x0) // TILE)), "<u8")  # of tiles, known when they are written
    with atomic_write(path) as part, part.open("wb") as file, ThreadPoolExecutor(threads) as pool:
        first = 0  # row of the band
        for channels in bands:
            planes = {name: to_storable(name, channels[name], (x0, y0 + first)) for name in sorted(channels)}
            if first == 0:
                file.write(_header(planes, attributes))
                table = file.tell()
                file.write(offsets.tobytes())
            rows, columns = common_shape(planes)
            places = [(y, x) for y in range(0, rows, TILE) for x in range(0, columns, TILE)]
            for (y, x), chunk in zip(places, pool.map(partial(_tile, [*planes.values()]), places), strict=True):
                row, column = (first + y) // TILE, x // TILE
                offsets[row, column] = file.tell()
                file.write(struct.pack("<5i", column, row, 0, 0, len(chunk)) + chunk)
            first += rows
        if not offsets.all():
            raise ValueError(f"the bands have {first} of {y1 - y0} rows")
        file.seek(table)
        file.write(offsets.tobytes())


def _text(kind: str, text: bytes) -> Attribute:
    return kind, f"{len(text)}s", text


def _header(planes: Mapping[str, np.ndarray], attributes: Mapping[str, Attribute]) -> bytes:
    """The header of an image of these channels."""
    kinds = {name: UINT if plane.dtype == np.uint32 else FLOAT for name, plane in planes.items()}
    channels = b"".join(name.encode() + struct.pack("<x4i", kind, 0, 1, 1) for name, kind in kinds.items()) + b"\0"
    header = struct.pack("<2I", MAGIC, VERSION | TILED | LONG_NAMES)
    for name, (kind, layout, *values) in {"channels": _text("chlist", channels), **attributes}.items():
        value = struct.pack("<" + layout, *values)
        header += f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value
    return header + b"\0"


def _tile(planes: Sequence[np.ndarray], corner: tuple[int, int]) -> bytes:
    """The pixels of a tile, compressed; as they are where that is no longer."""
    y, x = corner
    words = np.stack([plane.view(np.uint32)[y : y + TILE, x : x + TILE] for plane in planes], axis=1)
    halves = words.view(np.uint8).reshape(-1, 2).T.reshape(-1)  # bytes at even places, then those at odd ones
    differences = np.diff(halves, prepend=np.uint8(128)) + np.uint8(128)  # modulo 256; the first is the byte itself
    chunk = zlib.compress(differences.data, COMPRESSION_LEVEL)
    return chunk if len(chunk) < words.nbytes else words.tobytes()


def read_exr(path: FileName) -> Exr:
    """Read all channels of a file, of all its parts, in the types in which they are stored.

    A channel without a layer (`Z`) gets the name of its part (`depth.Z`), unless the part is called `rgba`, `rgb`,
    `beauty`, `combined` or `main`. Of several resolutions, the finest is read.
    Raises FileMissing for a file that cannot be opened, UnreadableExr if it is not a complete, flat EXR image, or if
    its parts are not layers of one image, such as parts of different sizes or views, or do not fit into memory.
    """
    path = Path(path)
    headers = _headers(path)
    check_memory(path, headers)
    read = _decode(path)
    names = {part.name(): part.channels for part in read}
    if dropped := quoted_list(name for name in map(part_name, headers) if name not in names):
        raise UnreadableExr(f"{path}: cannot read part {dropped}: damaged, truncated or of an unknown kind")
    called = merged_channel_names(path, names) if len(names) > 1 else {}
    header = read[0].header
    x0, y0, x1, y1 = window = window_of(header["dataWindow"])
    channels: dict[str, np.ndarray] = {}
    for part in read:
        for stored, channel in part.channels.items():
            name, shape = called.get((part.name(), stored), stored), np.shape(channel.pixels)
            if shape != (y1 - y0, x1 - x0):
                raise UnreadableExr(f"{path}: channel '{name}' has {shape} values for window {window}: subsampled")
            channels[name] = np.array(channel.pixels)  # copied: the library's array lives only as long as its part
    return Exr(
        dict(sorted(channels.items())),
        merged_provenance(path, [part.header for part in read]),
        window,
        window_of(header["displayWindow"]),
        tuple(names) if len(names) > 1 else (),
    )


def _inclusive(window: Window) -> Window:
    x0, y0, x1, y1 = window
    return x0, y0, x1 - 1, y1 - 1


def _headers(path: Path) -> list[Any]:
    """The headers of all parts. Raises FileMissing, and UnreadableExr for anything but layers of one flat image."""
    with opened_input(path, "EXR image") as file:
        start = file.read(4)
    if start != struct.pack("<I", MAGIC):
        begins = f"got a file that starts with '{start.decode('latin-1').strip()}'"
        raise UnreadableExr(f"{path}: expected an EXR image, {begins if start else 'the file is empty (0 bytes)'}")
    headers = [part.header for part in _decode(path, header_only=True)]
    check_parts(path, headers)
    return headers


def _decode(path: Path, *, header_only: bool = False) -> list[Any]:
    """Decode the parts of a file. Raises UnreadableExr if none is left, as the library drops damaged ones."""
    import OpenEXR

    damaged = UnreadableExr(f"{path}: a damaged or truncated EXR ({path.stat().st_size} bytes); write it again")
    try:
        with _library_output_suppressed():
            file = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except Exception as e:
        raise damaged from e
    if not file.parts:  # a part that fails to decode is dropped by the library
        raise damaged
    return list(file.parts)


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
