"""`caster info` and `caster preview`: contents of EXR files, and images of AOVs for viewing."""

import json
import os
import sys
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from caster.cli.shared_arguments import Adder, InputPath, OutputFile
from caster.system.process import OK
from caster.system.terminal import printable

MAX_VALUE_CHARACTERS = 72  # characters of a provenance value on a terminal line; --json has all of them
TYPES = {"float32": "float", "float16": "half", "uint32": "uint"}

# ---- caster info ----


def add_info_arguments(add: Adder) -> None:
    add("file", InputPath, "an EXR file; of a multi-part one, all parts", metavar="FILE.exr")
    add("--json", bool, "as JSON, with all of the provenance")


def info(args: Namespace) -> int:
    """Print the description of an EXR file. Raises FileMissing, UnreadableExr."""
    found = describe_exr(args.file)
    print(json.dumps(found, indent=2) if args.json else format_info(found))
    return OK


def describe_exr(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Everything `caster info` prints, ready for JSON. Raises FileMissing, UnreadableExr."""
    from caster.image.channels import hit_mask
    from caster.image.exr import read_exr

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


# ---- caster preview ----


def add_preview_arguments(add: Adder) -> None:
    add("file", InputPath, "a file of `caster render`, or of verdicts or differences", metavar="FILE.exr")
    add("-o --output", OutputFile, ".png or .tga; default: the file's name with .png, in this folder", metavar="IMAGE")
    add("--aov", str, "default: diffuse, else class, normal or depth", metavar="A")


def preview(args: Namespace) -> int:
    """Write the image, and its colour legend to standard error.

    Raises FileMissing, UnreadableExr, SceneError, OutputError.
    """
    from caster.image.image_files import check_image_name, write_image
    from caster.image.previews import exr_image

    output = args.output if args.output is not None else f"{Path(args.file).stem}.png"
    check_image_name("-o", output)
    image = exr_image(args.file, args.aov)
    write_image(output, image.pixels)
    print(f"{output}: {image.name}: {image.legend}", file=sys.stderr)
    print(output)
    return OK
