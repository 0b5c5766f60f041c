"""Image files that were written, read back: every channel to the bit, under the name that docs/exr.md gives it.

The file is read by the OpenEXR library, without the reader and the tables of names that wrote it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.aovs import BY_NAME, Aovs
from mitsuba_ref.judge.verdict import SceneCheck

MASK, NO_ID = "A", 2**32 - 1  # channel of the hit mask; an id on a miss
CHANNELS = {
    "hit": (MASK,),
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "shading_normal": ("shading_normal.X", "shading_normal.Y", "shading_normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "uv": ("uv.U", "uv.V"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "diffuse": ("R", "G", "B"),
    "shape_id": ("id.shape",),
    "prim_id": ("id.prim",),
}


class WrittenImage(NamedTuple):
    """A file, and its expected contents."""

    path: Path
    planes: Mapping[str, np.ndarray]  # (h, w) float32 or uint32, by channel
    window: tuple[int, int, int, int]  # x0, y0, x1, y1 of the pixels on the film, x1 and y1 exclusive
    film: tuple[int, int]  # width, height


def stored_planes(images: Aovs) -> dict[str, np.ndarray]:
    """Channels of AOVs as docs/exr.md has them: ids as uint32, all else as float32, finite beyond it as its largest."""
    planes = {MASK: images.hit.astype(np.float32)}
    largest = np.finfo(np.float32).max
    for name, image in images.items():
        layers = np.moveaxis(image.reshape(*images.hit.shape, -1), -1, 0)
        for channel, layer in zip(CHANNELS.get(name) or BY_NAME[name].CHANNELS, layers, strict=True):
            if layer.dtype.kind in "iu":
                planes[channel] = np.where(layer < 0, NO_ID, layer).astype(np.uint32)
            else:
                finite = np.clip(layer, -float(largest), float(largest))
                planes[channel] = np.where(np.isinf(layer), layer, finite).astype(np.float32)
    return planes


def check_exr_files(written: Sequence[WrittenImage]) -> SceneCheck:
    """Each file against memory; infinite for one that differs, with file, channel, pixel and both values."""
    for each in written:
        if found := difference(each):
            return SceneCheck("files", np.inf, f"{each.path.name}: {found}")
    return SceneCheck("files", 0.0, f"{len(written)} files read back")


def difference(written: WrittenImage) -> str:
    """What of a file is other than in memory; "" for nothing."""
    import OpenEXR  # deferred, so that `--help` does not load it

    with OpenEXR.File(str(written.path), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        x0, y0, x1, y1 = written.window
        boxes = {
            "dataWindow": ((x0, y0), (x1 - 1, y1 - 1)),
            "displayWindow": ((0, 0), (written.film[0] - 1, written.film[1] - 1)),
        }
        for name, box in boxes.items():
            found = tuple(tuple(int(number) for number in corner) for corner in header[name])
            if found != box:
                return f"{name} {found}, expected {box}"
        if set(channels) != set(written.planes):
            return f"channels {', '.join(sorted(channels))}, expected {', '.join(sorted(written.planes))}"
        for name, expected in written.planes.items():
            pixels = np.ascontiguousarray(channels[name].pixels)
            if (pixels.shape, pixels.dtype) != (expected.shape, expected.dtype):
                got = f"{pixels.shape} {pixels.dtype}"
                return f"{name} is {got}, expected {expected.shape} {expected.dtype}"
            other = np.argwhere(pixels.view(np.uint32) != np.ascontiguousarray(expected).view(np.uint32))
            if len(other):
                y, x = other[0].tolist()
                values = f"{pixels[y, x]}, expected {expected[y, x]}"
                return f"{name} at ({x0 + x}, {y0 + y}) is {values}; {len(other)} pixels"
    return ""
