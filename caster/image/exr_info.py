"""Description of an EXR file: its size, parts and channels, its count of hits, and its provenance."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from caster.image.exr import NO_ID, read_exr
from caster.system.terminal import printable

__all__ = ["hit_mask"]

MAX_VALUE_CHARACTERS = 72  # characters of a provenance value on a terminal line; --json has all of them
TYPES = {"float32": "float", "float16": "half", "uint32": "uint"}


def hit_mask(channels: Mapping[str, np.ndarray]) -> tuple[np.ndarray | None, str]:
    """The hit mask, (h, w) bool, and the channel it is derived from; (None, "") if there is none.

    By the mask channel `A`, else the ids, else depth (other renderers mark misses by other values).
    """
    if "A" in channels:
        return channels["A"] != 0, "A"
    for name in ("id.shape", "id.prim"):
        if name in channels:
            return channels[name] != NO_ID, name
    if "depth.Z" in channels:
        return channels["depth.Z"] != np.inf, "depth.Z"
    return None, ""


def describe_exr(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Everything `caster info` prints, ready for JSON. Raises FileMissing, UnreadableExr."""
    exr = read_exr(path)
    mask, source = hit_mask(exr.channels)
    x0, y0, x1, y1 = exr.data_window
    return {
        "file": str(path),
        "bytes": Path(path).stat().st_size,
        "width": x1 - x0,
        "height": y1 - y0,
        "data_window": list(exr.data_window),
        "display_window": list(exr.display_window),
        "hit_pixels": None if mask is None else int(mask.sum()),
        "hit_channel": source or None,
        "parts": list(exr.parts),
        "channels": {name: {"type": TYPES[str(values.dtype)]} for name, values in exr.channels.items()},
        "provenance": dict(exr.provenance),
    }


def format_info(info: Mapping[str, Any]) -> str:
    """The dict of describe_exr() as text for a terminal."""
    lines = [f"{info['file']}  {info['width']} x {info['height']}, {info['bytes']} bytes"]
    if not info["data_window"] == info["display_window"] == [0, 0, info["width"], info["height"]]:
        lines.append(f"pixels {info['data_window']} of the film {info['display_window']} (x1 and y1 are outside)")
    if info["parts"]:
        lines.append(f"{len(info['parts'])} parts as one image: {_truncated(', '.join(info['parts']))}")
    if info["hit_pixels"] is None:
        lines.append("hit pixels: unknown (no channel A, id.shape, id.prim or depth.Z)")
    else:
        pixels = info["width"] * info["height"]
        share = 100.0 * info["hit_pixels"] / pixels
        lines.append(f"hit pixels: {info['hit_pixels']} of {pixels} ({share:.1f} %), by channel {info['hit_channel']}")
    lines += ["channels:", *_table({name: channel["type"] for name, channel in info["channels"].items()})]
    if info["provenance"]:
        return "\n".join([*lines, "provenance:", *_table(info["provenance"])])
    return "\n".join([*lines, "provenance: none (no attribute under caster/)"])


def _table(rows: Mapping[str, str]) -> list[str]:
    width = max(map(len, rows))
    return [f"  {key.ljust(width)}  {_truncated(value)}" for key, value in rows.items()]


def _truncated(value: str) -> str:
    """A value of a file on one line."""
    shown = printable(value[:MAX_VALUE_CHARACTERS], keep="")
    return shown if len(value) <= MAX_VALUE_CHARACTERS else f"{shown}... ({len(value)} characters)"
