"""A small picture of a scene."""

import base64

import numpy as np

from caster.pictures.files import encoded
from caster.rendering import Aovs

WIDTH, HEIGHT = 96, 72  # at most, in pixels: shown at half of that, sharp on a screen of twice the density
LEVELS = 32  # of each colour: such a PNG is half as large as one of 256
BACKGROUND = (40, 44, 52)


def thumbnail(aovs: Aovs) -> str:
    """The diffuse picture, the normals of one that is dark or not given, or else depth, as a data URI."""
    image = _shades(aovs)
    small = _halved(np.where(aovs.hit[..., None], image, np.array(BACKGROUND) / 255.0))
    levels = np.round(np.round(small * (LEVELS - 1)) * (255 / (LEVELS - 1))).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(encoded(levels, "PNG")).decode("ascii")


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
    return _near_is_light(aovs)


def _near_is_light(aovs: Aovs) -> np.ndarray:
    """Depth, where nothing else is given."""
    depth = aovs["depth"]
    told = depth[np.isfinite(depth)]
    near, far = (told.min(), told.max()) if len(told) else (0.0, 0.0)
    with np.errstate(invalid="ignore"):
        gray = np.nan_to_num(1.0 - 0.85 * (depth - near) / (far - near or 1.0), nan=0.0)
    return np.repeat(np.clip(gray, 0.0, 1.0)[..., None], 3, axis=-1)


def _halved(image: np.ndarray) -> np.ndarray:
    """The mean of blocks of pixels, so many that it fits."""
    height, width, _ = image.shape
    step = max(1, -(-width // WIDTH), -(-height // HEIGHT))
    padded = np.pad(image, ((0, -height % step), (0, -width % step), (0, 0)), mode="edge")
    tall, wide = padded.shape[0] // step, padded.shape[1] // step
    mean: np.ndarray = padded.reshape(tall, step, wide, step, 3).mean(axis=(1, 3))
    return mean
