"""Previews of renders and EXR files, labelled strips and sheets, thumbnails of scenes."""

import re
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from caster import __version__
from caster.aovs import Aovs
from caster.description.errors import SceneError, suggestion
from caster.image.aov_views import LabelledImage, aov_view, class_map_view
from caster.image.channels import channels_to_aovs
from caster.image.exr import Exr, read_exr
from caster.image.exr_info import hit_mask
from caster.image.image_files import BACKGROUND, label_image, write_image
from caster.scene.model import Scene

Array = np.ndarray[Any, np.dtype[Any]]

GAP_PIXELS = 4  # between images of a sheet
LABEL_PIXELS = 18  # height of a label


def strip(images: Sequence[LabelledImage]) -> Array:
    """Images side by side with labels, (h, w, 3) bytes; a single image unchanged."""
    return images[0].pixels if len(images) == 1 else sheet(images, len(images))


def sheet(images: Sequence[LabelledImage], columns: int) -> Array:
    """A grid of images with the given number of columns, each centred in its cell above its name."""
    height = max(each.pixels.shape[0] for each in images)
    width = max(each.pixels.shape[1] for each in images)
    cells = [_cell(each, height, width) for each in images]
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    blank = blank_image(height + LABEL_PIXELS, width)
    rows[-1] += [blank] * (min(columns, len(cells)) - len(rows[-1]))
    return _joined([_joined(row, axis=1) for row in rows], axis=0)


def blank_image(height: int, width: int) -> Array:
    return np.full((height, width, 3), BACKGROUND, np.uint8)


def _cell(image: LabelledImage, height: int, width: int) -> Array:
    cell = blank_image(height + LABEL_PIXELS, width)
    h, w, _ = image.pixels.shape
    y, x = (height - h) // 2, (width - w) // 2
    cell[y : y + h, x : x + w] = image.pixels
    cell[height:] = label_image(image.name, width, LABEL_PIXELS)
    return cell


def _joined(parts: Sequence[Array], axis: int) -> Array:
    """Concatenate images along an axis with gaps between them."""
    if len(parts) == 1:
        return parts[0]
    shape = list(parts[0].shape)
    shape[axis] = GAP_PIXELS
    gap = np.full(shape, BACKGROUND[0], np.uint8)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=axis)


# ---- previews ----

CLASS_MAP = "class"  # the layer of an EXR file of verdicts or differences
DEFAULT_PREVIEWS = (
    "diffuse",
    CLASS_MAP,
    "normal",
    "depth",
)  # the first of these that exists is shown by default


def aov_images(aovs: Aovs, names: Sequence[str]) -> list[LabelledImage]:
    """Images of AOVs of a render; without names, of a default one. Raises SceneError for an AOV not rendered."""
    return [
        aov_view(name, _image(aovs, name), aovs.hit)
        for name in names or _default_names(list(aovs) or ["hit"])
    ]


def exr_images(path: str | PathLike[str], names: Sequence[str]) -> list[LabelledImage]:
    """Images of AOVs and class maps of an EXR file. Raises FileMissing, UnreadableExr, SceneError."""
    exr = read_exr(path)
    shape = next(iter(exr.channels.values())).shape
    mask, _ = hit_mask(exr.channels)
    hit = np.ones(shape, bool) if mask is None else mask
    aovs = channels_to_aovs({**exr.channels, "A": hit.astype(np.float32)})
    known = [*(name for name in aovs if name != "hit" or mask is not None), *_classes_in(exr)]
    if not known:
        raise SceneError(f"{path}: nothing to show: expected the channels of an AOV or class.I")
    for name in names:
        if name not in known:
            raise SceneError(
                f"{path}: no '{name}' in it{suggestion(name, known)} (it has {', '.join(known)})"
            )
    return [
        _classes(exr, hit) if name == CLASS_MAP else aov_view(name, _image(aovs, name), hit)
        for name in names or _default_names(known)
    ]


def write_preview(path: str, images: Sequence[LabelledImage], about: Mapping[str, str] = {}) -> list[str]:
    """Write images as a strip; returns the legend lines, which a PNG also contains. Raises OutputError."""
    lines = [f"{each.name}: {each.legend}" for each in images]
    write_image(
        path, strip(images), {"Software": f"caster {__version__}", "Description": "\n".join(lines), **about}
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


def _default_names(known: Sequence[str]) -> list[str]:
    return [next((name for name in DEFAULT_PREVIEWS if name in known), known[-1])]


def _classes_in(exr: Exr) -> list[str]:
    return [CLASS_MAP] if "class.I" in exr.channels else []


def _classes(exr: Exr, hit: np.ndarray) -> LabelledImage:
    """The class map of a file, named by its attribute caster/classes ("0 agree, 1 tie").

    Colours are those of caster/class_colors ("0 #102030, 1 #ffffff").
    """
    listed = exr.provenance.get("caster/classes") or exr.provenance.get("caster/class", "")
    names = {int(code): name for code, name in re.findall(r"(\d+) ([^,]+)", listed)}
    colors = {
        int(code): (int(color[:2], 16), int(color[2:4], 16), int(color[4:], 16))
        for code, color in re.findall(r"(\d+) #([0-9a-f]{6})", exr.provenance.get("caster/class_colors", ""))
    }
    return class_map_view(exr.channels["class.I"].astype(np.int64), names, colors, hit)


# ---- thumbnails ----

UNLIT_AOV = "normal"  # shown instead of diffuse for a scene without lights


def thumbnail(
    scene: Scene, name: str, side: int, aov: str, render: Callable[[Scene, Sequence[str]], Aovs]
) -> LabelledImage:
    """A scene rendered at a longer side of `side` pixels; a smaller film is enlarged by an integer factor."""
    film = scene.film
    share = min(1.0, side / max(film.width, film.height))
    small = scene.with_film(
        width=max(1, round(share * film.width)), height=max(1, round(share * film.height))
    )
    aov = aov if aov != "diffuse" or scene.lights else UNLIT_AOV
    aovs = render(small, (aov,))
    image = aov_view(aov, aovs[aov].astype(np.float64) if aov == "hit" else aovs[aov], aovs.hit)
    times = max(1, side // max(image.pixels.shape[:2]))
    return LabelledImage(name, image.pixels.repeat(times, axis=0).repeat(times, axis=1), image.legend)


def sheet_columns(count: int, ratio: float = 1.5) -> int:
    """The number of columns for which a sheet of square cells is about `ratio` times as wide as high."""
    return max(1, round(float(np.sqrt(ratio * count))))
