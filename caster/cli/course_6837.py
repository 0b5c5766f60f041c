"""`caster 6837`: scene files, options and images of the course MIT 6.837."""

from __future__ import annotations

import argparse
import math
import sys

from caster.cli.shared_arguments import InputPath, OutputFile, add_mesh_dirs, add_threads, output_file_unless_number
from caster.description.errors import SceneError, error_prefix
from caster.system.process import OK

MAX_LISTED = 50  # of what a file has and the images do not


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("-input", metavar="SCENE.txt", type=InputPath, required=True, help="a scene file of the course")
    add("-size", nargs=2, type=int, metavar=("W", "H"), default=(100, 100), help="default: 100 100")
    add("-output", metavar="IMAGE", type=OutputFile, help="the colours: diffuse and ambient light, .png or .tga")
    add(
        "-depth",
        nargs=3,
        type=output_file_unless_number,
        metavar=("NEAR", "FAR", "IMAGE"),
        help="t along the ray: white at NEAR, black at FAR and where nothing is hit",
    )
    add("-normals", metavar="IMAGE", type=OutputFile, help="|x|, |y|, |z| of the normal as red, green, blue")
    add("-shade_back", action="store_true", help="light surfaces from behind, too, instead of black")
    add("-shadows", action="store_true", help="lights cast shadows")
    add_threads(parser)
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Render and write the images; print what was written and what was left out.

    Raises SceneError, FileMissing, OutputError.
    """
    near, far = _depth_range(args.depth) if args.depth else (0.0, 1.0)
    paths = {"-output": args.output, "-depth": args.depth and args.depth[2], "-normals": args.normals}
    wanted = {option: path for option, path in paths.items() if path is not None}
    if not wanted:
        raise SceneError("nothing to render: expected at least one of -output, -depth, -normals")
    from caster.image.image_files import check_image_name, write_image

    for option, path in wanted.items():
        check_image_name(option, path)
    from caster.classroom.course_files import load_course_scene
    from caster.classroom.course_images import depth_image, normal_image, render_course, to_bytes_truncated
    from caster.scene.model import Film

    with error_prefix("-size", *args.size):
        Film(width=args.size[0], height=args.size[1])
    options = {"shade_back": args.shade_back, "shadows": args.shadows, "mesh_dirs": args.mesh_dir}
    course = load_course_scene(args.input, *args.size, **options)
    more = len(course.left_out) - MAX_LISTED
    for text in (*course.left_out[:MAX_LISTED], *([f"and {more} more left out"] if more > 0 else ())):
        print(text, file=sys.stderr)
    with error_prefix(args.input):
        images = render_course(course, args.threads)
    encoders = {
        "-output": lambda: to_bytes_truncated(images.color),
        "-depth": lambda: depth_image(images, near, far),
        "-normals": lambda: normal_image(images),
    }
    for option, path in wanted.items():
        write_image(path, encoders[option]())
    height, width = images.hit.shape
    found = f"t {images.t[images.hit].min():.6g} to {images.t[images.hit].max():.6g}" if images.hit.any() else "no hit"
    print(f"{', '.join(wanted.values())}: {width} x {height} pixels, {int(images.hit.sum())} hit, {found}")
    return OK


def _depth_range(words: list[str]) -> tuple[float, float]:
    """NEAR and FAR of -depth. Raises SceneError unless NEAR < FAR, both finite."""
    try:
        near, far = float(words[0]), float(words[1])
    except ValueError:
        raise SceneError(f"-depth {' '.join(words)}: expected two numbers and a file name") from None
    if not -math.inf < near < far < math.inf:
        raise SceneError(f"-depth {' '.join(words)}: expected NEAR < FAR, two finite numbers")
    return near, far
