"""Which channels of an EXR file belong together."""

from collections.abc import Iterable, Mapping

import numpy as np

from caster.exr import Exr

Array = np.ndarray

LAYERS: Mapping[str, tuple[str, ...]] = {
    "hit": ("A",),
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "shading_normal": ("shading_normal.X", "shading_normal.Y", "shading_normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "uv": ("uv.U", "uv.V"),
    "diffuse": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "shape_id": ("id.shape",),
    "prim_id": ("id.prim",),
}
"""Group -> channels. Any other channel is a group of its own, judged like a colour, or exactly if uint."""


def stacked(exr: Exr, names: Iterable[str]) -> Array:
    """Channels of an image, (h, w, c) float64."""
    return np.stack([exr.channels[name].astype(np.float64) for name in names], -1)
