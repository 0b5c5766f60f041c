"""Previews of AOVs and EXR files: false colours for each kind of AOV."""

import math
import re
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import AOVS, BY_NAME
from caster.description.errors import SceneError, suggestion
from caster.image.channels import channels_to_aovs, hit_mask
from caster.image.exr import Exr, read_exr

__all__ = ["aov_view"]

Array = np.ndarray[Any, np.dtype[Any]]

# ---- colours ----

# Equal steps along a perceptually uniform path from dark violet over blue and green to light yellow.
COLORMAP_ANCHORS = np.reshape(
    [*bytes.fromhex("210d3c 262e5a 264f74 247289 279597 40b698 73d38a b4e96a fcf730")], (-1, 3)
)
# (sqrt(5) - 1) / 2: its multiples modulo 1 are evenly spread, and successive ones are far apart (Fibonacci hashing).
GOLDEN_RATIO_CONJUGATE = 0.6180339887498949


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
    """Categorical colours of integers >= 0, (..., 3) bytes; neighbouring numbers get distant ones."""
    return colormap_lookup(numbers.astype(np.int64) * GOLDEN_RATIO_CONJUGATE % 1.0)


# ---- AOVs ----

CHECKER_PIXELS = 8  # side of a square of the checkerboard behind misses
CHECKER_GREYS = (58, 66)  # of the two kinds of squares
NON_FINITE_COLOR = (255, 0, 255)

# White is this quantile of the lit pixels, so that highlights do not darken the rest.
WHITE_QUANTILE = 0.99


class LabelledImage(NamedTuple):
    """An image for viewing. pixels: (h, w, 3) bytes; legend: what the colours mean, with numeric ranges."""

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
    finite = np.isfinite(values) if values.ndim == 2 else np.isfinite(values).all(axis=-1)
    shown = hit & finite
    if shown.any():
        with np.errstate(all="ignore"):  # in pixels outside the mask
            pixels, legend = COLORINGS[BY_NAME[name].PREVIEW](values, shown)
    else:
        pixels, legend = np.zeros((*hit.shape, 3), np.uint8), "nothing to show"
    broken = hit & ~finite
    if broken.any():
        legend += f"; {int(broken.sum())} pixels not finite: magenta"
    pixels = np.where(shown[..., None], pixels, checkerboard(hit.shape))
    return LabelledImage(name, np.where(broken[..., None], np.array(NON_FINITE_COLOR, np.uint8), pixels), legend)


def checkerboard(shape: tuple[int, ...]) -> Array:
    """A grey checkerboard, (h, w, 3) bytes."""
    y, x = np.indices(shape[:2]) // CHECKER_PIXELS
    return np.repeat(np.array(CHECKER_GREYS, np.uint8)[(x + y) % 2][..., None], 3, axis=-1)


def _depth(values: Array, shown: Array) -> Colored:
    """By the logarithm, which resolves near objects as well as a plane up to the horizon."""
    near, far = float(values[shown].min()), float(values[shown].max())
    if near > 0.0:
        how, behind, span = "by its logarithm, ", np.log(values / near), math.log(far / near)
    else:
        how, behind, span = "", values - near, far - near
    scale = 1.0 - behind / span if span > 0.0 else np.ones(values.shape)
    return colormap_lookup(scale), f"{how}{near:.6g} (light) to {far:.6g} (dark)"


def _ranges(values: Array, shown: Array) -> Colored:
    """Each of up to three channels from its least value to its greatest."""
    low, high = values[shown].min(axis=0), values[shown].max(axis=0)
    colors = np.zeros((*shown.shape, 3))
    colors[..., : len(low)] = (values - low) / np.where(high > low, high - low, 1.0)
    words = zip(("red", "green", "blue"), low, high, strict=False)
    return to_bytes(colors), ", ".join(f"{color} {a:.6g} to {b:.6g}" for color, a, b in words)


def _radiance(values: Array, shown: Array) -> Colored:
    lit = values[shown].max(axis=-1)
    white = float(np.quantile(lit[lit > 0.0], WHITE_QUANTILE)) if (lit > 0.0).any() else 1.0
    cut = int((lit > white).sum())
    return _srgb_bytes(values / white), f"0 to {white:.4g} on an sRGB screen, {cut} pixels are brighter"


def _srgb_bytes(linear: Array) -> Array:
    """Linear light as sRGB bytes, clipped (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    return to_bytes(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055))


# By the PREVIEW that an AOV declares.
COLORINGS: Mapping[str, Coloring] = {
    "mask": lambda values, shown: (np.full((*shown.shape, 3), 255, np.uint8), f"white: {int(shown.sum())} pixels hit"),
    "depth": _depth,
    "direction": lambda values, shown: (to_bytes(0.5 + 0.5 * values), "x, y, z from -1 to 1 as red, green, blue"),
    "ranges": _ranges,
    "reflectance": lambda values, shown: (_srgb_bytes(values), "0 to 1 on an sRGB screen"),
    "radiance": _radiance,
    "ids": lambda values, shown: (
        label_colors(values),
        f"one colour per number, {len(np.unique(values[shown]))} numbers",
    ),
}


# ---- EXR files ----

CLASS_MAP = "class"  # the layer of an EXR file of verdicts or differences
DEFAULT_PREVIEWS = ("diffuse", CLASS_MAP, "normal", "depth")  # the first of these that exists is shown by default


def exr_image(path: str | PathLike[str], name: str | None) -> LabelledImage:
    """The image of an AOV, or the class map, of an EXR file; None: of the first of DEFAULT_PREVIEWS that it has.

    Raises FileMissing, UnreadableExr, SceneError.
    """
    exr = read_exr(path)
    shape = next(iter(exr.channels.values())).shape
    mask, _ = hit_mask(exr.channels)
    hit = np.ones(shape, bool) if mask is None else mask
    aovs = channels_to_aovs({**exr.channels, "A": hit.astype(np.float32)})
    known = [name for name in aovs if name != "hit" or mask is not None]
    known += [CLASS_MAP] if "class.I" in exr.channels else []
    if not known:
        raise SceneError(f"{path}: nothing to show: expected the channels of an AOV or class.I")
    shown = next((each for each in DEFAULT_PREVIEWS if each in known), known[-1]) if name is None else name
    if shown not in known:
        raise SceneError(f"{path}: no '{shown}' in it{suggestion(shown, known)} (it has {', '.join(known)})")
    if shown == CLASS_MAP:
        return _class_map(exr, hit)
    return aov_view(shown, aovs[shown], hit)


def _class_map(exr: Exr, hit: Array) -> LabelledImage:
    """The class map of a file, with counts in the legend.

    Names are those of the attribute caster/classes ("0 agree, 1 tie"), colours those of caster/class_colors
    ("0 #102030, 1 #ffffff"). hit: (h, w) bool, the pixels that have a class.
    """
    names = dict(re.findall(r"(\d+) ([^,]+)", exr.provenance.get("caster/classes", "")))
    classes = exr.channels["class.I"].astype(np.int64)
    pixels = label_colors(classes)
    for code, color in re.findall(r"(\d+) #([0-9a-f]{6})", exr.provenance.get("caster/class_colors", "")):
        pixels[classes == int(code)] = list(bytes.fromhex(color))
    found, counts = np.unique(classes[hit], return_counts=True)
    legend = ", ".join(f"{names.get(str(code), code)} {n}" for code, n in zip(found, counts, strict=True))
    return LabelledImage(CLASS_MAP, np.where(hit[..., None], pixels, checkerboard(classes.shape)), legend)
