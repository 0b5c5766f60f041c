"""Colours that mean something: a scale of even steps for the eye, colours for numbers, the curve of a screen."""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import AOVS, BY_NAME
from caster.description.errors import SceneError, suggestion

ImageArray = np.ndarray[Any, np.dtype[Any]]

# OKLab by B. Ottosson (2020): perceived lightness and two opponent axes; equal distances look about equally far.
# Its two matrices, as published: the cube roots of cone responses -> Lab is the inverse of the first.
LMS_FROM_OKLAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
LINEAR_SRGB_FROM_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)

COLORMAP_STEPS = 256  # of the scale: as many as a byte tells apart
# (sqrt(5) - 1) / 2: its multiples fall evenly on a circle, far apart (Fibonacci hashing)
GOLDEN_RATIO_CONJUGATE = 0.6180339887498949


def oklab_to_linear_srgb(lab: ImageArray) -> ImageArray:
    """OKLab (..., 3) -> linear sRGB, which is outside 0..1 for what no screen shows."""
    return (lab @ LMS_FROM_OKLAB.T) ** 3 @ LINEAR_SRGB_FROM_LMS.T


def srgb_encoded(linear: ImageArray) -> ImageArray:
    """Linear light -> what a screen is sent, both 0..1 (IEC 61966-2-1); what is beyond is cut off."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def to_bytes(values: ImageArray) -> ImageArray:
    """0..1 -> 0..255, rounded; what is beyond is cut off."""
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def colormap_path(t: ImageArray) -> ImageArray:
    """OKLab colours from dark violet (t = 0) by blue and green to light yellow (t = 1), all of them on a screen."""
    lightness = 0.22 + 0.73 * t
    hue = 2.0 * math.pi * (0.83 - 0.53 * t)
    chroma = 0.085 + 0.11 * t - 0.05 * np.sin(math.pi * t)
    return np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


@cache
def colormap() -> ImageArray:
    """(STEPS, 3) bytes: neighbours look equally far from each other, and each is lighter than the one before."""
    t = np.linspace(0.0, 1.0, 16 * COLORMAP_STEPS)
    steps = np.linalg.norm(np.diff(colormap_path(t), axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.interp(np.linspace(0.0, along[-1], COLORMAP_STEPS), along, t)
    return to_bytes(srgb_encoded(oklab_to_linear_srgb(colormap_path(even))))


def colormap_lookup(values: ImageArray) -> ImageArray:
    """0..1 -> colours of the scale, (..., 3) bytes; what is beyond is cut off."""
    return colormap()[np.round((COLORMAP_STEPS - 1) * np.clip(values, 0.0, 1.0)).astype(int)]


def label_colors(numbers: ImageArray) -> ImageArray:
    """(..., 3) bytes: a colour for each whole number >= 0, the same in every picture; near numbers get far hues."""
    n = numbers.astype(np.int64)
    hue = 2.0 * math.pi * ((n * GOLDEN_RATIO_CONJUGATE) % 1.0)
    lightness = np.array([0.72, 0.6, 0.84])[n // 5 % 3]
    lab = np.stack([lightness, 0.11 * np.cos(hue), 0.11 * np.sin(hue)], axis=-1)
    return to_bytes(srgb_encoded(oklab_to_linear_srgb(lab)))


# An AOV as a picture: which colours it gets, and words on what they mean.


Array = np.ndarray[Any, np.dtype[Any]]

CHECKER_PIXELS = 8  # pixels: the side of a square behind misses
CHECKER_GREYS = (58, 66)  # its two greys
NON_FINITE_COLOR = (255, 0, 255)

# Where half of a picture is this many times as far as the nearest point, 1 / depth would leave it a few dark colours.
LOG_DEPTH_RATIO = 32.0

# The brightest hundredth of what is lit does not decide how dark all the rest is.
WHITE_QUANTILE = 0.99


class LabelledImage(NamedTuple):
    """pixels: (h, w, 3) bytes. words: what the colours mean, with the range in numbers."""

    name: str
    pixels: Array
    words: str


Colored = tuple[Array, str]
Coloring = Callable[[Array, Array], Colored]
"""(values, which of them to show (h, w) bool) -> ((h, w, 3) bytes, words). Of the others colours may be anything."""


def aov_view(name: str, values: Array, hit: Array) -> LabelledImage:
    """The picture of one AOV. hit: (h, w) bool, where there is something; the rest shows a checker.

    Values that are not finite where something is hit are magenta, and counted in the words. Raises SceneError for an
    AOV that has no picture.
    """
    if name not in BY_NAME or BY_NAME[name].PREVIEW not in COLORINGS:
        known = [aov.NAME for aov in AOVS if aov.PREVIEW in COLORINGS]
        raise SceneError(f"no picture of aov '{name}'{suggestion(name, known)} (known: {', '.join(known)})")
    kind = BY_NAME[name].PREVIEW
    finite = _in_all_channels(np.isfinite(values))
    shown = (np.ones_like(hit) if kind == "mask" else hit) & finite
    if shown.any():
        with np.errstate(all="ignore"):  # of what is not shown
            pixels, words = COLORINGS[kind](values, shown)
    else:
        pixels, words = np.zeros((*hit.shape, 3), np.uint8), "nothing to show"
    broken = hit & ~finite
    if broken.any():
        words += f"; {non_finite_counts(values, broken)}: magenta"
    pixels = np.where(shown[..., None], pixels, checkerboard(hit.shape))
    return LabelledImage(
        name, np.where(broken[..., None], np.array(NON_FINITE_COLOR, np.uint8), pixels), words
    )


def non_finite_counts(values: Array, broken: Array) -> str:
    """ "12 pixels NaN, 3 pixels infinite"."""
    nan = broken & ~_in_all_channels(~np.isnan(values))
    counts = {"NaN": int(nan.sum()), "infinite": int((broken & ~nan).sum())}
    return ", ".join(f"{n} pixel{'s' * (n != 1)} {what}" for what, n in counts.items() if n)


def _in_all_channels(fine: Array) -> Array:
    """(h, w) bool: fine in every channel."""
    return fine if fine.ndim == 2 else np.all(fine, axis=-1)


def checkerboard(shape: tuple[int, ...]) -> Array:
    """(h, w, 3) bytes."""
    y, x = np.indices(shape[:2]) // CHECKER_PIXELS
    return np.repeat(np.array(CHECKER_GREYS, np.uint8)[(x + y) % 2][..., None], 3, axis=-1)


def _depth(values: Array, shown: Array) -> Colored:
    """By 1 / depth, in which things near the eye and a plane up to the horizon both have colours of their own."""
    seen = values[shown]
    near, far, middle = float(seen.min()), float(seen.max()), float(np.median(seen))
    t = np.where(shown, values, far)
    if not near > 0.0:
        how, closeness, farthest, nearest = "", -t, -far, -near
    elif middle < LOG_DEPTH_RATIO * near:
        how, closeness, farthest, nearest = "by 1 / depth, ", near / t, near / far, 1.0
    else:
        how, closeness, farthest, nearest = (
            "by its logarithm, ",
            -np.log(t / near),
            -math.log(far / near),
            0.0,
        )
    span = nearest - farthest
    scale = (closeness - farthest) / span if span > 0.0 else np.ones(t.shape)
    return colormap_lookup(scale), f"{how}{near:.6g} (light) to {far:.6g} (dark)"


def _direction(values: Array, shown: Array) -> Colored:
    return to_bytes(
        0.5 + 0.5 * np.where(shown[..., None], values, 0.0)
    ), "x, y, z from -1 to 1 as red, green, blue"


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
    return _srgb_bytes(
        values / white, shown
    ), f"0 to {white:.4g} on an sRGB screen, {cut} pixels are brighter"


def _reflectance(values: Array, shown: Array) -> Colored:
    return _srgb_bytes(values, shown), "0 to 1 on an sRGB screen"


def _srgb_bytes(values: Array, shown: Array) -> Array:
    return to_bytes(srgb_encoded(np.where(shown[..., None], values, 0.0)))


def _mask(values: Array, shown: Array) -> Colored:
    return np.repeat(to_bytes(values)[..., None], 3, axis=-1), f"white: {int((values != 0).sum())} pixels hit"


def _labels(values: Array, shown: Array) -> Colored:
    count = len(np.unique(values[shown]))
    return label_colors(np.where(shown, values, 0)), f"a colour a number, {count} of them"


# By what an AOV declares as its PREVIEW.
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
    classes: Array,
    names: Mapping[int, str],
    colors: Mapping[int, tuple[int, int, int]],
    hit: Array,
) -> LabelledImage:
    """A map of classes, (h, w) whole numbers, with the counts in words; without a colour of its own, one by number.

    hit: (h, w) bool, which pixels have one.
    """
    pixels = label_colors(classes)
    for code, color in colors.items():
        pixels[classes == code] = color
    found, counts = np.unique(classes[hit], return_counts=True)
    words = ", ".join(f"{names.get(int(code), str(code))} {n}" for code, n in zip(found, counts, strict=True))
    return LabelledImage("class", np.where(hit[..., None], pixels, checkerboard(classes.shape)), words)
