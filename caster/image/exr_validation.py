"""Validation of EXR content: shapes, types and names of channels, attributes, and the parts of multi-part files.

Blender, Nuke, Arnold and RenderMan write a part for each layer. A channel that names its layer (`ViewLayer.Depth.Z`)
keeps its name; any other is prefixed by its part (`Z` of the part `depth` is `depth.Z`, of the part `Z` it is `Z`).
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.errors import FileMissing, SceneError
from caster.system.processor import available_bytes

__all__ = ["PROVENANCE_PREFIX"]

Window = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels of the full film; x1 and y1 are exclusive."""

Header = Mapping[str, Any]  # attributes of a part by name
PROVENANCE_PREFIX = "caster/"
MAX_COORDINATE = (1 << 30) - 1  # of a pixel; the library reads images within it
MAX_NAME_BYTES = 255  # the library silently drops an attribute with a longer name


class UnreadableExr(FileMissing):
    """A file that exists but is not a complete, flat EXR image."""


def common_shape(channels: Mapping[str, np.ndarray]) -> tuple[int, int]:
    """The common (height, width) of channels. Raises SceneError for no channels, differing shapes, invalid names."""
    if not channels:
        raise SceneError("an EXR needs at least one channel, got none")
    first = next(iter(channels))
    shape = np.shape(channels[first])
    for name, values in channels.items():
        _check_name("channel", name)
        if np.ndim(values) != 2 or np.size(values) == 0:
            raise SceneError(f"channel '{name}': expected a (height, width) array, got shape {np.shape(values)}")
        if np.shape(values) != shape:
            raise SceneError(f"channel '{name}' has shape {np.shape(values)}, channel '{first}' has {shape}")
    return int(shape[0]), int(shape[1])


def _check_name(kind: str, name: str) -> None:
    if not name or "\0" in name or len(name.encode()) > MAX_NAME_BYTES:
        raise SceneError(f"{kind} name {name!r:.60}: expected 1 to {MAX_NAME_BYTES} bytes of text without NUL")


def checked_window(what: str, window: Window) -> Window:
    """A window as integers. Raises SceneError for an empty one, or for pixels that the library does not read."""
    x0, y0, x1, y1 = (int(edge) for edge in window)
    if not (-MAX_COORDINATE < x0 < x1 < MAX_COORDINATE and -MAX_COORDINATE < y0 < y1 < MAX_COORDINATE):
        raise SceneError(f"{what}: expected x0 < x1 and y0 < y1, between -2^30 and 2^30, got ({x0}, {y0}, {x1}, {y1})")
    return x0, y0, x1, y1


def window_of(box: Any) -> Window:
    """A Window from the library's box, whose last pixel is inside."""
    (x0, y0), (x1, y1) = box
    return int(x0), int(y0), int(x1) + 1, int(y1) + 1


def header_attributes(provenance: Mapping[str, str]) -> dict[str, str]:
    """Header attributes under caster/ of provenance. Raises SceneError for values that are no text."""
    attributes: dict[str, str] = {}
    for key, value in sorted(provenance.items()):
        name = PROVENANCE_PREFIX + key.removeprefix(PROVENANCE_PREFIX)
        _check_name("provenance", name)
        if not isinstance(value, str):
            raise SceneError(f"provenance {name!r}: expected a string, got {value!r:.60}")
        attributes[name] = value
    return attributes


def to_storable(name: str, values: np.ndarray, corner: tuple[int, int]) -> np.ndarray:
    """A contiguous float32 or uint32 copy. Raises SceneError for a finite value that float32 cannot hold.

    corner: the pixel of the film at which the values begin.
    """
    values = np.asarray(values)
    if values.dtype == np.uint32:
        return np.array(values, np.uint32, order="C")
    if values.dtype != bool and not np.issubdtype(values.dtype, np.floating):
        raise SceneError(f"channel '{name}': an EXR holds floats, bools or uint32, got {values.dtype}")
    with np.errstate(over="ignore"):
        narrow = np.array(values, np.float32, order="C")
    lost = np.isinf(narrow) & np.isfinite(values)
    if lost.any():
        y, x = np.argwhere(lost)[0]
        raise SceneError(
            f"channel '{name}' at pixel ({corner[0] + x}, {corner[1] + y}): "
            f"{float(values[y, x])!r} is beyond float32 (largest {np.finfo(np.float32).max:.9g})"
        )
    return narrow


# ---- parts ----

# Parts of these names hold the beauty image with channels R G B A; unnamed parts are numbered by the library and by
# OpenImageIO.
MAIN_PART_NAME = re.compile(r"(.*\.)?(rgba?|beauty|combined|main|part ?\d+|subimage ?\d+)", re.IGNORECASE)


def check_parts(path: Path, headers: Sequence[Header]) -> None:
    """Raise UnreadableExr, naming the parts, unless they are layers of one flat image. headers: of all parts."""
    deep = [part_name(each) for each in headers if "deep" in str(each.get("type"))]
    if deep:
        raise UnreadableExr(f"{path}: deep data, many samples per pixel, in part {quoted_list(deep)}; write flat parts")
    views = dict.fromkeys(str(each["view"]) for each in headers if each.get("view"))
    if len(views) > 1:
        raise UnreadableExr(f"{path}: images of {len(views)} views ({quoted_list(views)}); write one of them")
    windows = [window_of(each["dataWindow"]) for each in headers]
    if len(set(windows)) > 1:
        shown = [f"'{part_name(each)}' shows {box}" for each, box in zip(headers, windows, strict=True)]
        raise UnreadableExr(
            f"{path}: parts of different sizes, expected layers of one image: pixels (x0, y0, x1, y1): part "
            f"{', '.join(shown)}; write one of them, or all with the same data window"
        )


BYTES_PER_VALUE = 8  # four in the library's array, and four in its copy


def check_memory(path: Path, headers: Sequence[Header]) -> None:
    """Raise UnreadableExr with the numbers for an image that does not fit into the memory that is left."""
    x0, y0, x1, y1 = window_of(headers[0]["dataWindow"])
    count = sum(len(each["channels"]) for each in headers)
    needed, left = (x1 - x0) * (y1 - y0) * count * BYTES_PER_VALUE, available_bytes()
    if needed > left:
        raise UnreadableExr(
            f"{path}: {x1 - x0} x {y1 - y0} pixels of {count} channels need {needed / 1e9:.1f} GB, and "
            f"{left / 1e9:.1f} GB are left: render a crop, or fewer AOVs"
        )


def merged_channel_names(path: Path, parts: Mapping[str, Sequence[str]]) -> dict[tuple[str, str], str]:
    """(part, channel) -> the name of the channel in the merged image. parts: channels by part.

    Raises UnreadableExr where two channels would have the same name.
    """
    plain: dict[tuple[str, str], str] = {}
    for part, channels in parts.items():
        whole_image = MAIN_PART_NAME.fullmatch(part)
        for channel in channels:
            own = whole_image or "." in channel or channel == part
            plain[part, channel] = channel if own else f"{part}.{channel}"
    times = Counter(plain.values())
    names = {place: ".".join(place) if times[name] > 1 else name for place, name in plain.items()}
    twice = sorted(name for name, count in Counter(names.values()).items() if count > 1)
    if twice:
        raise UnreadableExr(f"{path}: two parts have a channel that would be called '{twice[0]}'; rename one")
    return names


def merged_provenance(path: Path, headers: Sequence[Header]) -> dict[str, str]:
    """The provenance in the headers of all parts. Raises UnreadableExr where parts contradict each other."""
    whole: dict[str, str] = {}
    for header in headers:
        for key, value in header.items():
            if not (key.startswith(PROVENANCE_PREFIX) and isinstance(value, str)):
                continue
            if whole.setdefault(key, value) != value:
                raise UnreadableExr(f"{path}: its parts have different values of '{key}': parts of several files?")
    return dict(sorted(whole.items()))


def part_name(header: Header) -> str:
    return str(header.get("name", ""))


def quoted_list(names: Any) -> str:
    """'a', 'b'"""
    return ", ".join(f"'{name}'" for name in names)
