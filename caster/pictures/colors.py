"""Colours that mean something: a scale of even steps for the eye, colours for numbers, the curve of a screen."""

import math
from functools import cache
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

# OKLab by B. Ottosson (2020): perceived lightness and two opponent axes; equal distances look about equally far.
# Its two matrices, as published: the cube roots of cone responses -> Lab is the inverse of the first.
CONES_OF_LAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
RGB_OF_CONES = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)

STEPS = 256  # of the scale: as many as a byte tells apart
GOLDEN = 0.6180339887498949  # (sqrt(5) - 1) / 2: its multiples fall evenly on a circle, far apart (Fibonacci hashing)


def linear_of_lab(lab: Array) -> Array:
    """OKLab (..., 3) -> linear sRGB, which is outside 0..1 for what no screen shows."""
    return (lab @ CONES_OF_LAB.T) ** 3 @ RGB_OF_CONES.T


def screen(linear: Array) -> Array:
    """Linear light -> what a screen is sent, both 0..1 (IEC 61966-2-1); what is beyond is cut off."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def to_bytes(values: Array) -> Array:
    """0..1 -> 0..255, rounded; what is beyond is cut off."""
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def path_of_scale(t: Array) -> Array:
    """OKLab colours from dark violet (t = 0) by blue and green to light yellow (t = 1), all of them on a screen."""
    lightness = 0.22 + 0.73 * t
    hue = 2.0 * math.pi * (0.83 - 0.53 * t)
    chroma = 0.085 + 0.11 * t - 0.05 * np.sin(math.pi * t)
    return np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


@cache
def scale() -> Array:
    """(STEPS, 3) bytes: neighbours look equally far from each other, and each is lighter than the one before."""
    t = np.linspace(0.0, 1.0, 16 * STEPS)
    steps = np.linalg.norm(np.diff(path_of_scale(t), axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.interp(np.linspace(0.0, along[-1], STEPS), along, t)
    return to_bytes(screen(linear_of_lab(path_of_scale(even))))


def scaled(values: Array) -> Array:
    """0..1 -> colours of the scale, (..., 3) bytes; what is beyond is cut off."""
    return scale()[np.round((STEPS - 1) * np.clip(values, 0.0, 1.0)).astype(int)]


def of_numbers(numbers: Array) -> Array:
    """(..., 3) bytes: a colour for each whole number >= 0, the same in every picture; near numbers get far hues."""
    n = numbers.astype(np.int64)
    hue = 2.0 * math.pi * ((n * GOLDEN) % 1.0)
    lightness = np.array([0.72, 0.6, 0.84])[n // 5 % 3]
    lab = np.stack([lightness, 0.11 * np.cos(hue), 0.11 * np.sin(hue)], axis=-1)
    return to_bytes(screen(linear_of_lab(lab)))
