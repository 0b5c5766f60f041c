"""Description of an EXR file: channels, ranges, histograms, counts of NaN, inf and hits, provenance."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.image.exr import NO_ID, Part, Window, read_exr

__all__ = ["hit_mask"]

Array = np.ndarray[Any, np.dtype[Any]]

BINS = 24  # columns of a histogram beside ranges and counts
BLOCK_RAMP = " ▁▂▃▄▅▆▇█"
ASCII_RAMP = " .:-=+*#@"


def bin_counts(values: Array, bins: int = BINS) -> list[int]:
    """A histogram over `bins` equal parts of min..max. values: (n,), all finite.

    One bin if all values are equal, none without values.
    """
    if not values.size:
        return []
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return [int(values.size)]
    # by halves, as max - min may overflow float64
    share = (0.5 * values - 0.5 * low) / (0.5 * high - 0.5 * low)
    bin_index = np.minimum((bins * share).astype(int), bins - 1)
    return [int(count) for count in np.bincount(bin_index, minlength=bins)]


def histogram_text(counts: Sequence[int], ramp: str = BLOCK_RAMP) -> str:
    """A character for each count: blank for 0, else by its share of the largest, at least the lowest."""
    most, steps = max(counts, default=0), len(ramp) - 1
    return "".join(ramp[0 if not count else max(1, round(steps * count / most))] for count in counts)


def ramp_for(encoding: str | None) -> str:
    """The characters of a histogram: blocks if the encoding of the terminal has them, else ASCII."""
    try:
        BLOCK_RAMP.encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return ASCII_RAMP
    return BLOCK_RAMP


# ---- description ----

MAX_VALUE_CHARACTERS = 72  # characters of a provenance value on a terminal line; --json has all of them
TYPES = {"float32": "float", "float16": "half", "uint32": "uint"}
TABLE_COLUMNS = ("channel", "type", "min", "max", "NaN", "+inf", "-inf", "no id", "histogram")


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
    """Everything `caster info` prints, ready for JSON (numbers are finite, None where there is none).

    Ranges and histograms are over finite values; for uint channels over the pixels that carry an id.
    Pixels are (x, y) on the film. Warnings list values that no image of this renderer contains.
    Raises FileMissing or UnreadableExr.
    """
    exr = read_exr(path)
    x0, y0, x1, y1 = exr.data_window
    mask, source = hit_mask(exr.channels)
    return {
        "file": str(path),
        "bytes": Path(path).stat().st_size,
        "width": x1 - x0,
        "height": y1 - y0,
        "data_window": list(exr.data_window),
        "display_window": list(exr.display_window),
        "hit_pixels": None if mask is None else int(mask.sum()),
        "hit_channel": source or None,
        "parts": [{"name": part.name, "channels": list(part.channels)} for part in exr.parts],
        "channels": {name: _describe(values, exr.data_window) for name, values in exr.channels.items()},
        "warnings": _warnings(exr.channels, mask, source, exr.data_window),
        "provenance": dict(exr.provenance),
    }


def format_info(info: Mapping[str, Any], encoding: str | None = "utf-8") -> str:
    """Format the dict of describe_exr() for `caster info`. encoding: of the terminal."""
    return "\n".join(
        [
            f"{info['file']}  {info['width']} x {info['height']}, {info['bytes']} bytes",
            *_windows(info),
            *_parts(info),
            _hits(info),
            "",
            *_table(info["channels"], ramp_for(encoding)),
            *(f"warning: {text}" for text in info["warnings"]),
            "",
            *_provenance(info["provenance"]),
        ]
    )


def _describe(values: np.ndarray, window: Window) -> dict[str, Any]:
    has_ids = values.dtype == np.uint32
    wide = values.astype(np.float64)
    known = wide[values != NO_ID] if has_ids else wide[np.isfinite(wide)]
    number = int if has_ids else float
    nan = np.isnan(wide)
    return {
        "type": TYPES[str(values.dtype)],
        "min": number(known.min()) if known.size else None,
        "max": number(known.max()) if known.size else None,
        "nan": int(nan.sum()),
        "first_nan": _first(nan, window),
        "plus_inf": int((wide == np.inf).sum()),
        "minus_inf": int((wide == -np.inf).sum()),
        "no_id": int((values == NO_ID).sum()) if has_ids else None,
        "histogram": bin_counts(known),
    }


def _first(mask: np.ndarray, window: Window) -> list[int] | None:
    if not mask.any():
        return None
    y, x = np.unravel_index(int(mask.argmax()), mask.shape)
    return [window[0] + int(x), window[1] + int(y)]


def _warnings(channels: Mapping[str, np.ndarray], mask: np.ndarray | None, source: str, window: Window) -> list[str]:
    """Warnings on NaN, on infinities other than the depth of a miss, and on a mask that contradicts the depth."""
    found = []
    for name, values in channels.items():
        wide = values.astype(np.float64)
        found.append((np.isnan(wide), f"{name} is NaN"))
        miss = mask is not None and name == "depth.Z" and (wide == np.inf) & ~mask
        found.append((np.isinf(wide) & ~np.asarray(miss), f"{name} is infinite"))
    if mask is not None and "depth.Z" in channels:
        stray = np.isfinite(channels["depth.Z"]) & ~mask
        found.append((stray, f"depth.Z is finite where {source} is a miss"))
    return [f"{text} in {int(bad.sum())} pixels, first {_first(bad, window)}" for bad, text in found if bad.any()]


def _windows(info: Mapping[str, Any]) -> list[str]:
    if info["data_window"] == info["display_window"] == [0, 0, info["width"], info["height"]]:
        return []
    return [f"pixels {info['data_window']} of the film {info['display_window']} (x1 and y1 are outside)"]


def _parts(info: Mapping[str, Any]) -> list[str]:
    """Parts of a multi-part file with their channels."""
    parts = [str(Part(part["name"], tuple(part["channels"]))) for part in info["parts"]]
    return [f"{len(parts)} parts as one image:", *(f"  {_truncated(part)}" for part in parts)] if parts else []


def _hits(info: Mapping[str, Any]) -> str:
    if info["hit_pixels"] is None:
        return "hit pixels: unknown (no channel A, id.shape, id.prim or depth.Z)"
    pixels = info["width"] * info["height"]
    share = 100.0 * info["hit_pixels"] / pixels
    return f"hit pixels: {info['hit_pixels']} of {pixels} ({share:.1f} %), by channel {info['hit_channel']}"


def _table(channels: Mapping[str, Mapping[str, Any]], ramp: str) -> list[str]:
    keys = ("type", "min", "max", "nan", "plus_inf", "minus_inf", "no_id")
    rows: list[tuple[str, ...]] = [TABLE_COLUMNS]
    for name, entry in channels.items():
        rows.append((name, *(_cell(entry[key]) for key in keys), f"|{histogram_text(entry['histogram'], ramp)}|"))
    widths = [max(len(row[i]) for row in rows) for i in range(len(TABLE_COLUMNS))]
    sides = [str.ljust, str.ljust, *[str.rjust] * len(keys[1:]), str.ljust]
    return ["  ".join(map(_aligned, sides, row, widths)).rstrip() for row in rows]


def _aligned(side: Callable[[str, int], str], cell: str, width: int) -> str:
    return side(cell, width)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _provenance(provenance: Mapping[str, str]) -> list[str]:
    if not provenance:
        return ["provenance: none (no attribute under caster/)"]
    width = max(map(len, provenance))
    return ["provenance:", *(f"  {key.ljust(width)}  {_truncated(value)}" for key, value in provenance.items())]


def _truncated(value: str) -> str:
    # Text from a file: its control characters must not reach the terminal.
    shown = "".join(c if c.isprintable() else " " for c in value[: MAX_VALUE_CHARACTERS + 1])
    return (
        shown if len(value) <= MAX_VALUE_CHARACTERS else f"{shown[:MAX_VALUE_CHARACTERS]}... ({len(value)} characters)"
    )
