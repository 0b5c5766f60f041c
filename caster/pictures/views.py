"""An AOV as a picture: which colours it gets, and words on what they mean."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from caster.pictures.colors import of_numbers, scaled, screen, to_bytes
from caster.wording import SceneError, suggestion

Array = np.ndarray[Any, np.dtype[Any]]

CHECK = 8  # pixels: the side of a square behind misses
CHECKER = (58, 66)  # its two greys
NOT_FINITE = (255, 0, 255)

# Where half of a picture is this many times as far as the nearest point, 1 / depth would leave it a few dark colours.
WIDE = 32.0

# The brightest hundredth of what is lit does not decide how dark all the rest is.
BRIGHT = 0.99


class Picture(NamedTuple):
    """pixels: (h, w, 3) bytes. words: what the colours mean, with the range in numbers."""

    name: str
    pixels: Array
    words: str


Painted = tuple[Array, str]
Painter = Callable[[Array, Array], Painted]
"""(values, which of them to show (h, w) bool) -> ((h, w, 3) bytes, words). Of the others colours may be anything."""


def view(name: str, values: Array, hit: Array) -> Picture:
    """The picture of one AOV. hit: (h, w) bool, where there is something; the rest shows a checker.

    Values that are not finite where something is hit are magenta, and counted in the words. Raises SceneError for an
    AOV that has no picture.
    """
    if name not in PAINTERS:
        raise SceneError(
            f"no picture of aov '{name}'{suggestion(name, PAINTERS)} (known: {', '.join(PAINTERS)})"
        )
    finite = _everywhere(np.isfinite(values))
    shown = (np.ones_like(hit) if name == "hit" else hit) & finite
    if shown.any():
        with np.errstate(all="ignore"):  # of what is not shown
            pixels, words = PAINTERS[name](values, shown)
    else:
        pixels, words = np.zeros((*hit.shape, 3), np.uint8), "nothing to show"
    broken = hit & ~finite
    if broken.any():
        words += f"; {count_words(values, broken)}: magenta"
    pixels = np.where(shown[..., None], pixels, checker(hit.shape))
    return Picture(name, np.where(broken[..., None], np.array(NOT_FINITE, np.uint8), pixels), words)


def count_words(values: Array, broken: Array) -> str:
    """ "12 pixels NaN, 3 pixels infinite"."""
    nan = broken & ~_everywhere(~np.isnan(values))
    counts = {"NaN": int(nan.sum()), "infinite": int((broken & ~nan).sum())}
    return ", ".join(f"{n} pixel{'s' * (n != 1)} {what}" for what, n in counts.items() if n)


def _everywhere(fine: Array) -> Array:
    """(h, w) bool: fine in every channel."""
    return fine if fine.ndim == 2 else np.all(fine, axis=-1)


def checker(shape: tuple[int, ...]) -> Array:
    """(h, w, 3) bytes."""
    y, x = np.indices(shape[:2]) // CHECK
    return np.repeat(np.array(CHECKER, np.uint8)[(x + y) % 2][..., None], 3, axis=-1)


def _depth(values: Array, shown: Array) -> Painted:
    """By 1 / depth, in which things near the eye and a plane up to the horizon both have colours of their own."""
    seen = values[shown]
    near, far, middle = float(seen.min()), float(seen.max()), float(np.median(seen))
    t = np.where(shown, values, far)
    if not near > 0.0:
        how, closeness, farthest, nearest = "", -t, -far, -near
    elif middle < WIDE * near:
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
    return scaled(scale), f"{how}{near:.6g} (light) to {far:.6g} (dark)"


def _direction(values: Array, shown: Array) -> Painted:
    return to_bytes(
        0.5 + 0.5 * np.where(shown[..., None], values, 0.0)
    ), "x, y, z from -1 to 1 as red, green, blue"


def _position(values: Array, shown: Array) -> Painted:
    low, high = values[shown].min(axis=0), values[shown].max(axis=0)
    t = (values - low) / np.where(high > low, high - low, 1.0)
    ranges = ", ".join(f"{axis} {a:.6g} to {b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return to_bytes(np.where(shown[..., None], t, 0.0)), f"{ranges} as red, green, blue"


def _uv(values: Array, shown: Array) -> Painted:
    inside = values[shown].min() >= 0.0 and values[shown].max() <= 1.0
    t = values if inside else values - np.floor(values)
    t = np.where(shown[..., None], t, 0.0)
    how = "from 0 to 1" if inside else "modulo 1"
    return to_bytes(np.concatenate([t, np.zeros_like(t[..., :1])], axis=-1)), f"u, v {how} as red, green"


def _radiance(values: Array, shown: Array) -> Painted:
    lit = values[shown].max(axis=-1)
    white = float(np.quantile(lit[lit > 0.0], BRIGHT)) if (lit > 0.0).any() else 1.0
    cut = int((lit > white).sum())
    return _on_screen(values / white, shown), f"0 to {white:.4g} on an sRGB screen, {cut} pixels are brighter"


def _reflectance(values: Array, shown: Array) -> Painted:
    return _on_screen(values, shown), "0 to 1 on an sRGB screen"


def _on_screen(values: Array, shown: Array) -> Array:
    return to_bytes(screen(np.where(shown[..., None], values, 0.0)))


def _mask(values: Array, shown: Array) -> Painted:
    return np.repeat(to_bytes(values)[..., None], 3, axis=-1), f"white: {int((values != 0).sum())} pixels hit"


def _numbers(values: Array, shown: Array) -> Painted:
    count = len(np.unique(values[shown]))
    return of_numbers(np.where(shown, values, 0)), f"a colour a number, {count} of them"


PAINTERS: Mapping[str, Painter] = {
    "hit": _mask,
    "depth": _depth,
    "normal": _direction,
    "shading_normal": _direction,
    "position": _position,
    "uv": _uv,
    "albedo": _reflectance,
    "diffuse": _radiance,
    "shape_id": _numbers,
    "prim_id": _numbers,
}


def classes_view(
    classes: Array,
    names: Mapping[int, str],
    colors: Mapping[int, tuple[int, int, int]],
    hit: Array,
) -> Picture:
    """A map of classes, (h, w) whole numbers, with the counts in words; without a colour of its own, one by number.

    hit: (h, w) bool, which pixels have one.
    """
    pixels = of_numbers(classes)
    for code, color in colors.items():
        pixels[classes == code] = color
    found, counts = np.unique(classes[hit], return_counts=True)
    words = ", ".join(f"{names.get(int(code), str(code))} {n}" for code, n in zip(found, counts, strict=True))
    return Picture("class", np.where(hit[..., None], pixels, checker(classes.shape)), words)
