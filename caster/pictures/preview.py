"""Previews: pictures of some of the AOVs of a render, or of what an EXR file holds, in one file."""

import re
from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np

from caster import __version__
from caster.channels import aovs_of
from caster.exr import Exr, read_exr
from caster.info import hit_mask
from caster.pictures.files import write_picture
from caster.pictures.layout import strip
from caster.pictures.views import Picture, classes_view, view
from caster.rendering import Aovs
from caster.wording import SceneError, suggestion

CLASSES = "class"  # beside the AOVs, what a file of verdicts or differences holds
FIRST = ("diffuse", CLASSES, "normal", "depth")  # what is shown, if nobody says what


def pictures_of(aovs: Aovs, names: Sequence[str]) -> list[Picture]:
    """One for each name; without names, the one that tells most. Raises SceneError for one that is not there."""
    return [view(name, _image(aovs, name), aovs.hit) for name in names or _first(list(aovs) or ["hit"])]


def pictures_in(path: str | PathLike[str], names: Sequence[str]) -> list[Picture]:
    """The same of an EXR file, which may also hold classes. Raises FileMissing, UnreadableExr, SceneError."""
    exr = read_exr(path)
    shape = next(iter(exr.channels.values())).shape
    mask, _ = hit_mask(exr.channels)
    hit = np.ones(shape, bool) if mask is None else mask
    aovs = aovs_of({**exr.channels, "A": hit.astype(np.float32)})
    known = [*(name for name in aovs if name != "hit" or mask is not None), *_classes_in(exr)]
    if not known:
        raise SceneError(f"{path}: nothing to show: expected the channels of an AOV or class.I")
    for name in names:
        if name not in known:
            raise SceneError(
                f"{path}: no '{name}' in it{suggestion(name, known)} (it has {', '.join(known)})"
            )
    return [
        _classes(exr, hit) if name == CLASSES else view(name, _image(aovs, name), hit)
        for name in names or _first(known)
    ]


def write_preview(path: str, pictures: Sequence[Picture], about: Mapping[str, str] = {}) -> list[str]:
    """Write them as a strip; a line on each, which a PNG holds, too. Raises OutputError."""
    lines = [f"{each.name}: {each.words}" for each in pictures]
    write_picture(
        path, strip(pictures), {"Software": f"caster {__version__}", "Description": "\n".join(lines), **about}
    )
    return lines


def _image(aovs: Aovs, name: str) -> np.ndarray:
    if name == "hit":
        return aovs.hit.astype(np.float64)
    if name not in aovs:
        there = ["hit", *(other for other in aovs if other != "hit")]
        raise SceneError(
            f"preview of aov '{name}': it is not rendered{suggestion(name, there)} (there are {', '.join(there)})"
        )
    return aovs[name]


def _first(known: Sequence[str]) -> list[str]:
    return [next((name for name in FIRST if name in known), known[-1])]


def _classes_in(exr: Exr) -> list[str]:
    return [CLASSES] if "class.I" in exr.channels else []


def _classes(exr: Exr, hit: np.ndarray) -> Picture:
    """Names as in caster/classes ("0 agree, 1 tie"), colours as in caster/class_colors ("0 #102030, 1 #ffffff")."""
    told = exr.provenance.get("caster/classes") or exr.provenance.get("caster/class", "")
    names = {int(code): name for code, name in re.findall(r"(\d+) ([^,]+)", told)}
    colors = {
        int(code): (int(color[:2], 16), int(color[2:4], 16), int(color[4:], 16))
        for code, color in re.findall(r"(\d+) #([0-9a-f]{6})", exr.provenance.get("caster/class_colors", ""))
    }
    return classes_view(exr.channels["class.I"].astype(np.int64), names, colors, hit)
