"""Previews of AOVs and EXR files: false colours of each kind of AOV, labelled strips and sheets, thumbnails."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from caster import __version__
from caster.aovs import AOVS, BY_NAME, Aovs
from caster.description.errors import SceneError, suggestion
from caster.image.channels import channels_to_aovs
from caster.image.exr import Exr, read_exr
from caster.image.exr_info import hit_mask
from caster.image.image_files import BACKGROUND, label_image, write_image
from caster.scene.model import Scene

__all__ = ["aov_images"]

Array = np.ndarray[Any, np.dtype[Any]]

# ---- colours ----

# Of a perceptually uniform path from dark violet over blue and green to light yellow, in equal steps.
COLORMAP_ANCHORS = np.array(
    [
        *([33, 13, 60], [38, 46, 90], [38, 79, 116], [36, 114, 137], [39, 149, 151]),
        *([64, 182, 152], [115, 211, 138], [180, 233, 106], [252, 247, 48]),
    ]
)
# (sqrt(5) - 1) / 2: its multiples modulo 1 are evenly spread, and successive ones far apart (Fibonacci hashing)
GOLDEN_RATIO_CONJUGATE = 0.6180339887498949


def srgb_encoded(linear: Array) -> Array:
    """Linear light -> sRGB values, both 0..1, clipped (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def to_bytes(values: Array) -> Array:
    """0..1 -> 0..255, clipped and rounded."""
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def colormap_lookup(values: Array) -> Array:
    """0..1, clipped -> colours from dark violet to light yellow, (..., 3) bytes."""
    place = np.clip(values, 0.0, 1.0) * (len(COLORMAP_ANCHORS) - 1)
    steps = np.arange(len(COLORMAP_ANCHORS))
    channels = [np.interp(place, steps, channel) for channel in COLORMAP_ANCHORS.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def label_colors(numbers: Array) -> Array:
    """Categorical colours of integers >= 0, (..., 3) bytes: the same in every image; near numbers get distant hues."""
    n = numbers.astype(np.int64)[..., None]
    hue = 6.0 * ((n * GOLDEN_RATIO_CONJUGATE) % 1.0)
    pure = np.clip(np.abs((hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    value = np.array([0.9, 0.7, 1.0])[n // 5 % 3]
    return to_bytes(value * (0.35 + 0.65 * pure))


# ---- AOVs ----

CHECKER_PIXELS = 8  # side of a square of the checkerboard behind misses
CHECKER_GREYS = (58, 66)  # of the two kinds of squares
NON_FINITE_COLOR = (255, 0, 255)

# Median depth over least depth beyond which 1 / depth would leave half of the image a few dark colours.
LOG_DEPTH_RATIO = 32.0

# White is this quantile of the lit pixels, so that highlights do not darken the rest.
WHITE_QUANTILE = 0.99


class LabelledImage(NamedTuple):
    """An image for viewing. pixels: (h, w, 3) bytes; legend: the meaning of the colours, with ranges in numbers."""

    name: str
    pixels: Array
    legend: str


Colored = tuple[Array, str]
Coloring = Callable[[Array, Array], Colored]
"""(values, (h, w) bool mask of pixels to show) -> ((h, w, 3) bytes, legend); colours outside the mask are arbitrary."""


def aov_view(name: str, values: Array, hit: Array) -> LabelledImage:
    """The image of one AOV. hit: (h, w) bool mask; misses show a checkerboard.

    Non-finite values of hit pixels are magenta and counted in the legend. Raises SceneError for an AOV without a
    colour mapping.
    """
    if name not in BY_NAME or BY_NAME[name].PREVIEW not in COLORINGS:
        known = [aov.NAME for aov in AOVS if aov.PREVIEW in COLORINGS]
        raise SceneError(f"no preview of aov '{name}'{suggestion(name, known)} (known: {', '.join(known)})")
    kind = BY_NAME[name].PREVIEW
    finite = _in_all_channels(np.isfinite(values))
    shown = (np.ones_like(hit) if kind == "mask" else hit) & finite
    if shown.any():
        with np.errstate(all="ignore"):  # in pixels outside the mask
            pixels, legend = COLORINGS[kind](values, shown)
    else:
        pixels, legend = np.zeros((*hit.shape, 3), np.uint8), "nothing to show"
    broken = hit & ~finite
    if broken.any():
        legend += f"; {non_finite_counts(values, broken)}: magenta"
    pixels = np.where(shown[..., None], pixels, checkerboard(hit.shape))
    return LabelledImage(name, np.where(broken[..., None], np.array(NON_FINITE_COLOR, np.uint8), pixels), legend)


def non_finite_counts(values: Array, broken: Array) -> str:
    """Counts in words: "12 pixels NaN, 3 pixels infinite"."""
    nan = broken & ~_in_all_channels(~np.isnan(values))
    counts = {"NaN": int(nan.sum()), "infinite": int((broken & ~nan).sum())}
    return ", ".join(f"{n} pixel{'s' * (n != 1)} {what}" for what, n in counts.items() if n)


def _in_all_channels(fine: Array) -> Array:
    """Logical and over the channels, (h, w) bool."""
    return fine if fine.ndim == 2 else np.all(fine, axis=-1)


def checkerboard(shape: tuple[int, ...]) -> Array:
    """A grey checkerboard, (h, w, 3) bytes."""
    y, x = np.indices(shape[:2]) // CHECKER_PIXELS
    return np.repeat(np.array(CHECKER_GREYS, np.uint8)[(x + y) % 2][..., None], 3, axis=-1)


def _depth(values: Array, shown: Array) -> Colored:
    """Mapping by 1 / depth, which resolves near objects as well as a plane up to the horizon; wide ranges by log."""
    depths = values[shown]
    near, far, middle = float(depths.min()), float(depths.max()), float(np.median(depths))
    t = np.where(shown, values, far)
    if not near > 0.0:
        how, closeness, farthest, nearest = "", -t, -far, -near
    elif middle < LOG_DEPTH_RATIO * near:
        how, closeness, farthest, nearest = "by 1 / depth, ", near / t, near / far, 1.0
    else:
        how, closeness, farthest, nearest = ("by its logarithm, ", -np.log(t / near), -math.log(far / near), 0.0)
    span = nearest - farthest
    scale = (closeness - farthest) / span if span > 0.0 else np.ones(t.shape)
    return colormap_lookup(scale), f"{how}{near:.6g} (light) to {far:.6g} (dark)"


def _direction(values: Array, shown: Array) -> Colored:
    return to_bytes(0.5 + 0.5 * np.where(shown[..., None], values, 0.0)), "x, y, z from -1 to 1 as red, green, blue"


def _position(values: Array, shown: Array) -> Colored:
    low, high = values[shown].min(axis=0), values[shown].max(axis=0)
    t = (values - low) / np.where(high > low, high - low, 1.0)
    ranges = ", ".join(f"{axis} {a:.6g} to {b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return to_bytes(np.where(shown[..., None], t, 0.0)), f"{ranges} as red, green, blue"


def _uv(values: Array, shown: Array) -> Colored:
    inside = values[shown].min() >= 0.0 and values[shown].max() <= 1.0
    t = values if inside else values - np.floor(values)
    t = np.where(shown[..., None], t, 0.0)
    how = "from 0 to 1" if inside else "modulo 1"
    return to_bytes(np.concatenate([t, np.zeros_like(t[..., :1])], axis=-1)), f"u, v {how} as red, green"


def _radiance(values: Array, shown: Array) -> Colored:
    lit = values[shown].max(axis=-1)
    white = float(np.quantile(lit[lit > 0.0], WHITE_QUANTILE)) if (lit > 0.0).any() else 1.0
    cut = int((lit > white).sum())
    return _srgb_bytes(values / white, shown), f"0 to {white:.4g} on an sRGB screen, {cut} pixels are brighter"


def _reflectance(values: Array, shown: Array) -> Colored:
    return _srgb_bytes(values, shown), "0 to 1 on an sRGB screen"


def _srgb_bytes(values: Array, shown: Array) -> Array:
    return to_bytes(srgb_encoded(np.where(shown[..., None], values, 0.0)))


def _mask(values: Array, shown: Array) -> Colored:
    return np.repeat(to_bytes(values)[..., None], 3, axis=-1), f"white: {int((values != 0).sum())} pixels hit"


def _labels(values: Array, shown: Array) -> Colored:
    count = len(np.unique(values[shown]))
    return label_colors(np.where(shown, values, 0)), f"a colour a number, {count} of them"


# Colour mappings by the PREVIEW that an AOV declares.
COLORINGS: Mapping[str, Coloring] = {
    "mask": _mask,
    "depth": _depth,
    "direction": _direction,
    "position": _position,
    "uv": _uv,
    "reflectance": _reflectance,
    "radiance": _radiance,
    "ids": _labels,
}


def class_map_view(
    classes: Array, names: Mapping[int, str], colors: Mapping[int, tuple[int, int, int]], hit: Array
) -> LabelledImage:
    """The image of a class map, (h, w) integers, with counts in the legend.

    names, colors: by class; a class without a colour gets a categorical one. hit: (h, w) bool, pixels with a class.
    """
    pixels = label_colors(classes)
    for code, color in colors.items():
        pixels[classes == code] = color
    found, counts = np.unique(classes[hit], return_counts=True)
    legend = ", ".join(f"{names.get(int(code), str(code))} {n}" for code, n in zip(found, counts, strict=True))
    return LabelledImage("class", np.where(hit[..., None], pixels, checkerboard(classes.shape)), legend)


# ---- strips, sheets and thumbnails

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
DEFAULT_PREVIEWS = ("diffuse", CLASS_MAP, "normal", "depth")  # the first of these that exists is shown by default


def aov_images(aovs: Aovs, names: Sequence[str]) -> list[LabelledImage]:
    """Images of AOVs of a render; without names, of a default one. Raises SceneError for an AOV not rendered."""
    return [aov_view(name, _image(aovs, name), aovs.hit) for name in names or _default_names(list(aovs) or ["hit"])]


def exr_images(path: str | PathLike[str], names: Sequence[str]) -> list[LabelledImage]:
    """Images of AOVs and class maps of an EXR file. Raises FileMissing, UnreadableExr, SceneError."""
    exr = read_exr(path)
    shape = next(iter(exr.channels.values())).shape
    mask, _ = hit_mask(exr.channels)
    hit = np.ones(shape, bool) if mask is None else mask
    aovs = channels_to_aovs({**exr.channels, "A": hit.astype(np.float32)})
    known = [name for name in aovs if name != "hit" or mask is not None]
    known += [CLASS_MAP] if "class.I" in exr.channels else []
    if not known:
        raise SceneError(f"{path}: nothing to show: expected the channels of an AOV or class.I")
    for name in names:
        if name not in known:
            raise SceneError(f"{path}: no '{name}' in it{suggestion(name, known)} (it has {', '.join(known)})")
    return [
        _classes(exr, hit) if name == CLASS_MAP else aov_view(name, _image(aovs, name), hit)
        for name in names or _default_names(known)
    ]


def write_preview(path: str, images: Sequence[LabelledImage], about: Mapping[str, str] = {}) -> list[str]:
    """Write images as a strip; returns the legend lines, which a PNG also contains. Raises OutputError."""
    lines = [f"{each.name}: {each.legend}" for each in images]
    write_image(path, strip(images), {"Software": f"caster {__version__}", "Description": "\n".join(lines), **about})
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
    small = scene.with_film(width=max(1, round(share * film.width)), height=max(1, round(share * film.height)))
    aov = aov if aov != "diffuse" or scene.lights else UNLIT_AOV
    aovs = render(small, (aov,))
    image = aov_view(aov, aovs[aov].astype(np.float64) if aov == "hit" else aovs[aov], aovs.hit)
    times = max(1, side // max(image.pixels.shape[:2]))
    return LabelledImage(name, image.pixels.repeat(times, axis=0).repeat(times, axis=1), image.legend)
