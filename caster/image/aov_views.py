"""False-colour images of AOVs: colormaps, sRGB encoding, and the colour mapping of each kind of AOV."""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import AOVS, BY_NAME
from caster.description.errors import SceneError, suggestion

Array = np.ndarray[Any, np.dtype[Any]]

# OKLab by B. Ottosson (2020), a perceptually uniform space: lightness and two opponent axes. Its two matrices, as
# published: the cube roots of cone responses (LMS) -> Lab is the inverse of the first.
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

COLORMAP_STEPS = 256  # entries of the colormap: the values of a byte
# (sqrt(5) - 1) / 2: its multiples modulo 1 are evenly spread, and successive ones far apart (Fibonacci hashing)
GOLDEN_RATIO_CONJUGATE = 0.6180339887498949


def oklab_to_linear_srgb(lab: Array) -> Array:
    """OKLab (..., 3) -> linear sRGB, outside 0..1 where the colour is out of gamut."""
    return (lab @ LMS_FROM_OKLAB.T) ** 3 @ LINEAR_SRGB_FROM_LMS.T


def srgb_encoded(linear: Array) -> Array:
    """Linear light -> sRGB values, both 0..1, clipped (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def to_bytes(values: Array) -> Array:
    """0..1 -> 0..255, clipped and rounded."""
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def colormap_path(t: Array) -> Array:
    """OKLab colours from dark violet (t = 0) over blue and green to light yellow (t = 1), all within the sRGB gamut."""
    lightness = 0.22 + 0.73 * t
    hue = 2.0 * math.pi * (0.83 - 0.53 * t)
    chroma = 0.085 + 0.11 * t - 0.05 * np.sin(math.pi * t)
    return np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


@cache
def colormap() -> Array:
    """The colormap, (COLORMAP_STEPS, 3) bytes: perceptually uniform, with increasing lightness."""
    t = np.linspace(0.0, 1.0, 16 * COLORMAP_STEPS)
    steps = np.linalg.norm(np.diff(colormap_path(t), axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.interp(np.linspace(0.0, along[-1], COLORMAP_STEPS), along, t)
    return to_bytes(srgb_encoded(oklab_to_linear_srgb(colormap_path(even))))


def colormap_lookup(values: Array) -> Array:
    """0..1, clipped -> colours of the colormap, (..., 3) bytes."""
    return colormap()[np.round((COLORMAP_STEPS - 1) * np.clip(values, 0.0, 1.0)).astype(int)]


def label_colors(numbers: Array) -> Array:
    """Categorical colours of integers >= 0, (..., 3) bytes: the same in every image; near numbers get distant hues."""
    n = numbers.astype(np.int64)
    hue = 2.0 * math.pi * ((n * GOLDEN_RATIO_CONJUGATE) % 1.0)
    lightness = np.array([0.72, 0.6, 0.84])[n // 5 % 3]
    lab = np.stack([lightness, 0.11 * np.cos(hue), 0.11 * np.sin(hue)], axis=-1)
    return to_bytes(srgb_encoded(oklab_to_linear_srgb(lab)))


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
    return LabelledImage(
        name, np.where(broken[..., None], np.array(NON_FINITE_COLOR, np.uint8), pixels), legend
    )


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
    classes: Array,
    names: Mapping[int, str],
    colors: Mapping[int, tuple[int, int, int]],
    hit: Array,
) -> LabelledImage:
    """The image of a class map, (h, w) integers, with counts in the legend.

    names, colors: by class; a class without a colour gets a categorical one. hit: (h, w) bool, pixels with a class.
    """
    pixels = label_colors(classes)
    for code, color in colors.items():
        pixels[classes == code] = color
    found, counts = np.unique(classes[hit], return_counts=True)
    legend = ", ".join(
        f"{names.get(int(code), str(code))} {n}" for code, n in zip(found, counts, strict=True)
    )
    return LabelledImage("class", np.where(hit[..., None], pixels, checkerboard(classes.shape)), legend)
