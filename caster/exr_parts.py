"""The parts of a multi-part EXR file as one picture: what their channels are called, and what makes no picture.

Blender, Nuke, Arnold and RenderMan write a part for each layer. A channel that names its layer (`ViewLayer.Depth.Z`)
keeps its name, any other is called after its part (`Z` of the part `depth` is `depth.Z`, that of the part `Z` is `Z`).
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from caster.exr_content import UnreadableExr, Window

# Parts of these names hold the picture itself, whose channels are R G B A everywhere; the library and OpenImageIO
# number parts that were given no name.
PICTURE = re.compile(r"(.*\.)?(rgba?|beauty|combined|main|part ?\d+|subimage ?\d+)", re.IGNORECASE)


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
    deep = [_name(each) for each in headers if "deep" in str(each.get("type"))]
    if deep:
        raise UnreadableExr(
            f"{path}: deep data, many samples a pixel, in part {_listed(deep)}; write flat parts"
        )
    views = dict.fromkeys(str(each["view"]) for each in headers if each.get("view"))
    if len(views) > 1:
        raise UnreadableExr(f"{path}: pictures of {len(views)} views ({_listed(views)}); write one of them")
    windows = [window(each["dataWindow"]) for each in headers]
    if len(set(windows)) > 1:
        shown = [f"'{_name(each)}' shows {box}" for each, box in zip(headers, windows, strict=True)]
        raise UnreadableExr(
            f"{path}: parts of different sizes, expected layers of one picture: pixels (x0, y0, x1, y1): part "
            f"{', '.join(shown)}; write one of them, or all with the same data window"
        )


def check_all_read(path: Path, headers: Sequence[Mapping[str, Any]], read: Sequence[str]) -> None:
    """Raise UnreadableExr for parts that are in the file and were not decoded: the library drops these."""
    left = [name for name in map(_name, headers) if name not in read]
    if left:
        raise UnreadableExr(
            f"{path}: cannot read part {_listed(left)}: damaged, truncated or of a kind not known"
        )


def names_in_whole(path: Path, parts: Mapping[str, Sequence[str]]) -> dict[tuple[str, str], str]:
    """(part, channel) -> the name of the channel in the whole picture; parts: their channels.

    Raises UnreadableExr where two would have one name.
    """
    plain = {(part, channel): _called(part, channel) for part, each in parts.items() for channel in each}
    times = Counter(plain.values())
    names = {
        (part, channel): f"{part}.{channel}" if times[name] > 1 else name
        for (part, channel), name in plain.items()
    }
    twice = sorted(name for name, count in Counter(names.values()).items() if count > 1)
    if twice:
        raise UnreadableExr(f"{path}: two parts have a channel that would be called '{twice[0]}'; rename one")
    return names


def _called(part: str, channel: str) -> str:
    if "." in channel or channel == part or PICTURE.fullmatch(part):
        return channel
    return f"{part}.{channel}"


def provenance_of(path: Path, told: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """What the parts say together of where they are from. Raises UnreadableExr where they contradict each other."""
    whole: dict[str, str] = {}
    for each in told:
        for key, value in each.items():
            if whole.setdefault(key, value) != value:
                raise UnreadableExr(
                    f"{path}: its parts say different things of '{key}': parts of several files?"
                )
    return dict(sorted(whole.items()))


def _name(header: Mapping[str, Any]) -> str:
    return str(header.get("name", ""))


def _listed(names: Any) -> str:
    return ", ".join(f"'{name}'" for name in names)
