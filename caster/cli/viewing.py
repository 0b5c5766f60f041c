"""`caster info` and `caster preview`: contents of EXR files, and images of AOVs for viewing."""

import argparse
import json
import sys
from pathlib import Path

from caster.cli.shared_arguments import InputPath, OutputFile, adder
from caster.system.process import OK

# ---- caster info ----


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("file", InputPath, "an EXR file; of a multi-part one, all parts", metavar="FILE.exr")
    add("--json", bool, "as JSON, with all of the provenance")


def info(args: argparse.Namespace) -> int:
    """Print the description of an EXR file. Raises FileMissing, UnreadableExr."""
    from caster.image.exr_info import describe_exr, format_info

    found = describe_exr(args.file)
    print(json.dumps(found, indent=2) if args.json else format_info(found))
    return OK


# ---- caster preview ----


def add_preview_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("file", InputPath, "a file of `caster render`, or of verdicts or differences", metavar="FILE.exr")
    help_ = ".png or .tga; default: the file's name with .png, in this folder"
    add("-o --output", OutputFile, help_, metavar="IMAGE")
    add("--aov", str, "default: diffuse, else class, normal or depth", metavar="A")


def preview(args: argparse.Namespace) -> int:
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
