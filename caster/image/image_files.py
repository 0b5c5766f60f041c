"""Writing PNG and TGA files."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.errors import SceneError, join_words
from caster.system.atomic_files import write_bytes

__all__ = ["encode_image"]

Array = np.ndarray[Any, np.dtype[Any]]

IMAGE_FORMATS = {".png": "PNG", ".tga": "TGA"}


def check_image_name(option: str, path: str) -> None:
    """Raise SceneError for a file name without the suffix of a supported format."""
    if Path(path).suffix.lower() not in IMAGE_FORMATS:
        raise SceneError(f"{option} {path}: expected a name that ends in {join_words(IMAGE_FORMATS)}")


def write_image(path: str, pixels: Array) -> None:
    """Write (h, w, 3) bytes as a .png or .tga file, deterministically. Raises OutputError."""
    write_bytes(path, encode_image(pixels, IMAGE_FORMATS[Path(path).suffix.lower()]))


def encode_image(pixels: Array, kind: str) -> bytes:
    """Encode (h, w, 3) bytes in one of the formats of IMAGE_FORMATS."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(out, kind, optimize=True)  # which is an option of PNG alone
    return out.getvalue()
