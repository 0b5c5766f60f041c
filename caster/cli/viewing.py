"""`caster info`, `caster preview` and `caster sheet`: contents of EXR files, and images of AOVs for viewing."""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from caster.image.previews import LabelledImage
    from caster.scene.model import Scene

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
    from caster.image import previews
    from caster.image.image_files import check_image_name, write_image

    output = args.output if args.output is not None else f"{Path(args.file).stem}.png"
    check_image_name("-o", output)
    images = previews.exr_images(args.file, comma_separated(args.aov))
    legend = [f"{each.name}: {each.legend}" for each in images]
    pixels = images[0].pixels if len(images) == 1 else previews.sheet(images, len(images))
    write_image(output, pixels, {"Description": "\n".join(legend), "Source": Path(args.file).name})
    for line in legend:
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
    from caster.rendering.images import check_names
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
    images = []
    for file, scene, name in zip(files, scenes, display_names(files), strict=True):
        with error_prefix(file):
            images.append(thumbnail(scene, name, args))
    columns = args.columns or max(1, round(math.sqrt(1.5 * len(images))))  # the sheet is wider than high
    about = {"Description": ", ".join(image.name for image in images)}
    write_image(args.output, previews.sheet(images, columns), about)
    print(f"{args.output}: {len(images)} scenes")
    return OK


def thumbnail(scene: "Scene", name: str, args: argparse.Namespace) -> "LabelledImage":
    """A scene rendered at --side; a smaller film is enlarged by an integer factor."""
    from caster.image.previews import LabelledImage, aov_view
    from caster.rendering.images import render

    film = scene.film
    share = min(1.0, args.side / max(film.width, film.height))
    small = scene.with_film(width=max(1, round(share * film.width)), height=max(1, round(share * film.height)))
    aov = "normal" if args.aov == "diffuse" and not scene.lights else args.aov
    aovs = render(small, (aov,), threads=args.threads)
    image = aov_view(aov, aovs[aov].astype(float), aovs.hit)
    times = max(1, args.side // max(image.pixels.shape[:2]))
    return LabelledImage(name, image.pixels.repeat(times, axis=0).repeat(times, axis=1), image.legend)
