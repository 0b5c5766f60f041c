"""Arrays and thumbnails as text: bytes of equal weight grouped, deflated, in base64; lossless.

mitsuba_ref/report/html/page/arrays.js decodes the arrays.
"""

import base64
import zlib
from typing import Any

import numpy as np

from caster.image.image_files import encode_image
from caster.rendering.images import Aovs

Packed = dict[str, Any]  # {"type": "f4", "z": text}, and "delta" or "xor" for the step before

ZLIB_LEVEL = 4  # takes 0.6 of the time of the default 6, for 1.02 of the size
DROPPED_MANTISSA_BITS = 12  # of a float32 by `coarse`: a resolution of one part in 2^11 remains


def packed(values: np.ndarray, like: np.ndarray | None = None) -> Packed:
    """(n,) numbers or (n, c), whose channels follow one another.

    like: nearly equal floats of the same shape, with whose bits these are XORed.
    """
    values = _in_a_row(values)
    bits = values.view(f"<u{values.itemsize}")
    if like is not None:
        return {
            "type": _type(values),
            "xor": 1,
            "z": _deflated(bits ^ base_bits(_in_a_row(like), values.dtype)),
        }
    plain, delta = _deflated(bits), _deflated(np.diff(bits, prepend=bits.dtype.type(0)))
    if len(delta) < len(plain):
        return {"type": _type(values), "delta": 1, "z": delta}
    return {"type": _type(values), "z": plain}


def base_bits(like: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray:
    """Bits of the same numbers in this type; 0 for NaN, whose bits a conversion may change."""
    numbers = np.where(np.isnan(like), 0.0, like).astype(dtype)
    return numbers.view(f"<u{dtype.itemsize}")


def narrowest(values: np.ndarray) -> np.ndarray:
    """The same numbers as float32, if each is one, else as they are."""
    single = rounded(values)
    return single if np.array_equal(single, values, equal_nan=True) else values


def rounded(values: np.ndarray) -> np.ndarray:
    """As float32, inf where it holds no such number."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def coarse(values: np.ndarray) -> np.ndarray:
    """Shares and bounds, >= 0, as float32 of a few digits: up to 2^-11 more than they are, never less; NaN as inf.

    1 stays 1, and what is more than 1 stays more.
    """
    single = rounded(np.where(np.isnan(values), np.inf, values))
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    step = np.uint32((1 << DROPPED_MANTISSA_BITS) - 1)
    return ((single.view(np.uint32) + step) & ~step).view(np.float32)


def _in_a_row(values: np.ndarray) -> np.ndarray:
    """Channel after channel, little-endian."""
    return np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()


def _type(values: np.ndarray) -> str:
    return f"{values.dtype.kind}{values.itemsize}"


def _deflated(bits: np.ndarray) -> str:
    planes = np.ascontiguousarray(bits).view(np.uint8).reshape(-1, bits.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), ZLIB_LEVEL)).decode("ascii")


# ---- thumbnails ----

MAX_WIDTH, MAX_HEIGHT = 96, 72  # pixels: shown at half of that, sharp on a screen of twice the density
COLOR_LEVELS = 32  # of each colour: such a PNG is half as large as one of 256
BACKGROUND = (40, 44, 52)


def thumbnail(aovs: Aovs) -> str:
    """A small image as a data URI: diffuse, normals if that is dark or missing, else depth."""
    image = _shades(aovs)
    small = _halved(np.where(aovs.hit[..., None], image, np.array(BACKGROUND) / 255.0))
    levels = np.round(np.round(small * (COLOR_LEVELS - 1)) * (255 / (COLOR_LEVELS - 1))).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(encode_image(levels, "PNG")).decode("ascii")


def _shades(aovs: Aovs) -> np.ndarray:
    """(h, w, 3) from 0 to 1."""
    if "diffuse" in aovs and aovs.hit.any():
        shown = np.nan_to_num(aovs["diffuse"], nan=0.0, posinf=0.0, neginf=0.0)
        brightest = float(np.quantile(shown[aovs.hit].max(axis=-1), 0.98))
        if brightest > 0.0:
            bright: np.ndarray = np.clip(shown / brightest, 0.0, 1.0) ** (1.0 / 2.2)
            return bright
    if "normal" in aovs:
        turned: np.ndarray = np.clip(0.5 + 0.5 * np.nan_to_num(aovs["normal"]), 0.0, 1.0)
        return turned
    return _depth_as_gray(aovs)


def _depth_as_gray(aovs: Aovs) -> np.ndarray:
    """Depth as gray, near is light."""
    depth = aovs["depth"]
    finite = depth[np.isfinite(depth)]
    near, far = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    with np.errstate(invalid="ignore"):
        gray = np.nan_to_num(1.0 - 0.85 * (depth - near) / (far - near or 1.0), nan=0.0)
    return np.repeat(np.clip(gray, 0.0, 1.0)[..., None], 3, axis=-1)


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of blocks of pixels, as large as needed to fit."""
    height, width, _ = image.shape
    step = max(1, -(-width // MAX_WIDTH), -(-height // MAX_HEIGHT))
    padded = np.pad(image, ((0, -height % step), (0, -width % step), (0, 0)), mode="edge")
    tall, wide = padded.shape[0] // step, padded.shape[1] // step
    mean: np.ndarray = padded.reshape(tall, step, wide, step, 3).mean(axis=(1, 3))
    return mean
