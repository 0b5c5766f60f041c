"""`caster preview`: what is in an EXR file, as a picture."""

import argparse
import sys
from pathlib import Path

from caster.cli.exit_codes import OK

HELP = "show AOVs or class maps of an EXR file as a PNG picture"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE.exr", help="a file of `caster render`, or of verdicts or differences")
    add(
        "-o",
        "--output",
        metavar="IMAGE",
        help=".png or .tga; default: the file's name with .png, in this folder",
    )
    add(
        "--aov",
        metavar="A,B,...",
        help="which; several become a labelled strip; default: the one that tells most",
    )


def run(args: argparse.Namespace) -> int:
    """Write the picture and say what its colours mean. Raises FileMissing, UnreadableExr, SceneError, OutputError."""
    from caster.image.image_files import check_image_name
    from caster.image.previews import exr_images, write_preview

    output = args.output if args.output is not None else f"{Path(args.file).stem}.png"
    check_image_name("-o", output)
    names = [] if args.aov is None else list(dict.fromkeys(args.aov.split(",")))
    for line in write_preview(output, exr_images(args.file, names), {"Source": Path(args.file).name}):
        print(f"{output}: {line}", file=sys.stderr)
    print(output)
    return OK
