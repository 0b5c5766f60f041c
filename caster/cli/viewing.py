"""`caster info`, `caster preview` and `caster sheet`: contents of EXR files, and images of AOVs for viewing."""

import argparse
import json
import math
import sys
from functools import partial
from pathlib import Path

from caster.cli.shared_arguments import (
    InputPath,
    OutputFile,
    add_mesh_dirs,
    add_threads,
    comma_separated,
    display_names,
    positive_int,
    scene_files,
)
from caster.description.errors import error_prefix
from caster.system.process import NOTHING_SELECTED, OK

# ---- caster info ----


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.exr", type=InputPath, help="an EXR file; of a multi-part one, all parts")
    parser.add_argument("--json", action="store_true", help="as JSON, with all of the provenance")


def info(args: argparse.Namespace) -> int:
    """Print the description of an EXR file. Raises FileMissing, UnreadableExr."""
    from caster.image.exr_info import describe_exr, format_info

    found = describe_exr(args.file)
    print(json.dumps(found, indent=2) if args.json else format_info(found))
    return OK


# ---- caster preview ----


def add_preview_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE.exr", type=InputPath, help="a file of `caster render`, or of verdicts or differences")
    add(
        "-o",
        "--output",
        metavar="IMAGE",
        type=OutputFile,
        help=".png or .tga; default: the file's name with .png, in this folder",
    )
    add(
        "--aov",
        type=str,
        metavar="A,B,...",
        help="which; several become a labelled strip; default: diffuse, else class, normal or depth",
    )


def preview(args: argparse.Namespace) -> int:
    """Write the image, and its colour legend to standard error.

    Raises FileMissing, UnreadableExr, SceneError, OutputError.
    """
    from caster.image.image_files import check_image_name
    from caster.image.previews import exr_images, write_preview

    output = args.output if args.output is not None else f"{Path(args.file).stem}.png"
    check_image_name("-o", output)
    images = exr_images(args.file, comma_separated(args.aov))
    for line in write_preview(output, images, {"Source": Path(args.file).name}):
        print(f"{output}: {line}", file=sys.stderr)
    print(output)
    return OK


# ---- caster sheet ----


def add_sheet_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("scenes", metavar="SCENE|DIR", type=InputPath, nargs="+", help="scene files, or folders of them")
    add("-o", "--output", metavar="PNG", type=OutputFile, default="sheet.png", help="default: sheet.png")
    add(
        "--aov", type=str, metavar="A", default="diffuse", help="default: diffuse, and normals of scenes without lights"
    )
    add("--side", type=positive_int, metavar="N", default=160, help="longer side of each, in pixels; default: 160")
    add("--columns", type=positive_int, metavar="N", help="default: so many that the sheet is wider than high")
    add_threads(parser)
    add_mesh_dirs(parser)


def sheet(args: argparse.Namespace) -> int:
    """Render all scenes as thumbnails and write the sheet. Raises SceneError, FileMissing, OutputError."""
    from caster.image import previews
    from caster.image.image_files import check_image_name, write_image
    from caster.rendering.images import check_names, render
    from caster.scene.files import load_scene
    from caster.system.atomic_files import check_writable

    check_image_name("-o", args.output)
    check_names([args.aov])
    check_writable(args.output)
    files = scene_files(args.scenes)
    if not files:
        print(f"nothing selected: no scene file in {', '.join(args.scenes)}", file=sys.stderr)
        return NOTHING_SELECTED
    scenes = [load_scene(file, args.mesh_dir) for file in files]  # all errors before any rendering
    images, draw = [], partial(render, threads=args.threads)
    for file, scene, name in zip(files, scenes, display_names(files), strict=True):
        with error_prefix(file):
            images.append(previews.thumbnail(scene, name, args.side, args.aov, draw))
    columns = args.columns or max(1, round(math.sqrt(1.5 * len(images))))  # half as wide again as high
    about = {"Description": ", ".join(image.name for image in images)}
    write_image(args.output, previews.sheet(images, columns), about)
    print(f"{args.output}: {len(images)} scenes")
    return OK
