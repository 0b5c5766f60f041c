"""What an EXR file can hold: channels of one shape, names and text of limited length, float32 or uint32."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import FileMissing, SceneError

__all__ = ["PROVENANCE_PREFIX"]

Window = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels of the full film; x1 and y1 are the first column and row outside."""

PROVENANCE_PREFIX = "caster/"
MAX_NAME_BYTES = 255  # bytes; the library drops a longer attribute without a word


class UnreadableExr(FileMissing):
    """A file that is there but is not a whole, flat EXR picture."""


def common_shape(channels: Mapping[str, np.ndarray]) -> tuple[int, int]:
    """(height, width) of all channels. Raises SceneError for none, for another shape, for a name that cannot be."""
    if not channels:
        raise SceneError("an EXR needs at least one channel, got none")
    first = next(iter(channels))
    shape = np.shape(channels[first])
    for name, values in channels.items():
        _check_name("channel", name)
        if np.ndim(values) != 2 or np.size(values) == 0:
            raise SceneError(
                f"channel '{name}': expected a (height, width) array, got shape {np.shape(values)}"
            )
        if np.shape(values) != shape:
            raise SceneError(f"channel '{name}' has shape {np.shape(values)}, channel '{first}' has {shape}")
    return int(shape[0]), int(shape[1])


def _check_name(kind: str, name: object) -> None:
    if not isinstance(name, str) or not name or "\0" in name or len(_utf8(kind, name)) > MAX_NAME_BYTES:
        raise SceneError(
            f"{kind} name {name!r:.60}: expected 1 to {MAX_NAME_BYTES} bytes of text without NUL"
        )


def _utf8(what: str, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as e:
        raise SceneError(f"{what}: text that is no valid Unicode cannot be stored: {text!r:.60}") from e


def checked_window(what: str, window: Window) -> Window:
    """The window in whole numbers. Raises SceneError for one without a pixel."""
    x0, y0, x1, y1 = (int(edge) for edge in window)
    if x1 <= x0 or y1 <= y0:
        raise SceneError(f"{what}: expected x0 < x1 and y0 < y1, got ({x0}, {y0}, {x1}, {y1})")
    return x0, y0, x1, y1


def header_attributes(provenance: Mapping[str, str]) -> dict[str, str]:
    """Header attributes under caster/. Raises SceneError for what is no text."""
    attributes: dict[str, str] = {}
    for key, value in sorted(provenance.items()):
        name = PROVENANCE_PREFIX + key.removeprefix(PROVENANCE_PREFIX)
        _check_name("provenance", name)
        if not isinstance(value, str) or name in attributes:
            raise SceneError(f"provenance {name!r}: expected one string, got {value!r:.60}")
        _utf8(f"provenance {name!r}", value)
        attributes[name] = value
    return attributes


def to_storable(name: str, values: np.ndarray, window: Window) -> np.ndarray:
    """A contiguous float32 or uint32 copy. Raises SceneError for a finite value that float32 cannot hold."""
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
            f"channel '{name}' at pixel ({window[0] + x}, {window[1] + y}): "
            f"{float(values[y, x])!r} is beyond float32 (largest {np.finfo(np.float32).max:.9g})"
        )
    return narrow


# The parts of a multi-part EXR file as one picture: what their channels are called, and what makes no picture.
#
# Blender, Nuke, Arnold and RenderMan write a part for each layer. A channel that names its layer (`ViewLayer.Depth.Z`)
# keeps its name, any other is called after its part (`Z` of the part `depth` is `depth.Z`, that of the part
# `Z` is `Z`).


# Parts of these names hold the picture itself, whose channels are R G B A everywhere; the library and OpenImageIO
# number parts that were given no name.
MAIN_PART_NAME = re.compile(r"(.*\.)?(rgba?|beauty|combined|main|part ?\d+|subimage ?\d+)", re.IGNORECASE)


class Part(NamedTuple):
    """A part of a file by its name, and its channels as the whole picture calls them."""

    name: str
    channels: tuple[str, ...]

    def __str__(self) -> str:
        """Such as `depth (Z)`: without its own name again before each channel."""
        return f"{self.name} ({', '.join(name.removeprefix(f'{self.name}.') for name in self.channels)})"


def check_parts(path: Path, headers: Sequence[Mapping[str, Any]], window: Callable[[Any], Window]) -> None:
    """Raise UnreadableExr for parts that are no layers of one flat picture, saying which.

    headers: of all parts; window: what the library's box is in our way of saying it.
    """
    deep = [_part_name(each) for each in headers if "deep" in str(each.get("type"))]
    if deep:
        raise UnreadableExr(
            f"{path}: deep data, many samples a pixel, in part {_quoted_list(deep)}; write flat parts"
        )
    views = dict.fromkeys(str(each["view"]) for each in headers if each.get("view"))
    if len(views) > 1:
        raise UnreadableExr(
            f"{path}: pictures of {len(views)} views ({_quoted_list(views)}); write one of them"
        )
    windows = [window(each["dataWindow"]) for each in headers]
    if len(set(windows)) > 1:
        shown = [f"'{_part_name(each)}' shows {box}" for each, box in zip(headers, windows, strict=True)]
        raise UnreadableExr(
            f"{path}: parts of different sizes, expected layers of one picture: pixels (x0, y0, x1, y1): part "
            f"{', '.join(shown)}; write one of them, or all with the same data window"
        )


def check_all_read(path: Path, headers: Sequence[Mapping[str, Any]], read: Sequence[str]) -> None:
    """Raise UnreadableExr for parts that are in the file and were not decoded: the library drops these."""
    left = [name for name in map(_part_name, headers) if name not in read]
    if left:
        raise UnreadableExr(
            f"{path}: cannot read part {_quoted_list(left)}: damaged, truncated or of a kind not known"
        )


def merged_channel_names(path: Path, parts: Mapping[str, Sequence[str]]) -> dict[tuple[str, str], str]:
    """(part, channel) -> the name of the channel in the whole picture; parts: their channels.

    Raises UnreadableExr where two would have one name.
    """
    plain = {(part, channel): _merged_name(part, channel) for part, each in parts.items() for channel in each}
    times = Counter(plain.values())
    names = {
        (part, channel): f"{part}.{channel}" if times[name] > 1 else name
        for (part, channel), name in plain.items()
    }
    twice = sorted(name for name, count in Counter(names.values()).items() if count > 1)
    if twice:
        raise UnreadableExr(f"{path}: two parts have a channel that would be called '{twice[0]}'; rename one")
    return names


def _merged_name(part: str, channel: str) -> str:
    if "." in channel or channel == part or MAIN_PART_NAME.fullmatch(part):
        return channel
    return f"{part}.{channel}"


def merged_provenance(path: Path, told: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """What the parts say together of where they are from. Raises UnreadableExr where they contradict each other."""
    whole: dict[str, str] = {}
    for each in told:
        for key, value in each.items():
            if whole.setdefault(key, value) != value:
                raise UnreadableExr(
                    f"{path}: its parts say different things of '{key}': parts of several files?"
                )
    return dict(sorted(whole.items()))


def _part_name(header: Mapping[str, Any]) -> str:
    return str(header.get("name", ""))


def _quoted_list(names: Any) -> str:
    return ", ".join(f"'{name}'" for name in names)
