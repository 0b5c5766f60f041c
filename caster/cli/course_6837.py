"""`caster 6837`: scene files, options and images of the course MIT 6.837."""

import math
import sys
from argparse import Namespace

from caster.cli.shared_arguments import (
    Adder,
    InputPath,
    OutputFile,
    add_mesh_dirs,
    add_threads,
    check_film_size,
    output_file_unless_number,
)
from caster.description.errors import SceneError, error_prefix
from caster.system.process import OK


def add_arguments(add: Adder) -> None:
    add("-input", InputPath, "a scene file of the course", metavar="SCENE.txt", required=True)
    add("-size", int, "default: 100 100", nargs=2, metavar=("W", "H"), default=(100, 100))
    add("-output", OutputFile, "the colours: diffuse and ambient light, .png or .tga", metavar="IMAGE")
    add(
        "-depth",
        output_file_unless_number,
        "t along the ray: white at NEAR, black at FAR and where nothing is hit",
        nargs=3,
        metavar=("NEAR", "FAR", "IMAGE"),
    )
    add("-normals", OutputFile, "|x|, |y|, |z| of the normal as red, green, blue", metavar="IMAGE")
    add("-shade_back", bool, "light surfaces from behind, too, instead of black")
    add("-shadows", bool, "lights cast shadows")
    add_threads(add)
    add_mesh_dirs(add)


def run(args: Namespace) -> int:
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
    from caster.description.parsing import list_errors

    check_film_size("-size", *args.size)
    options = {"shade_back": args.shade_back, "shadows": args.shadows, "mesh_dirs": args.mesh_dir}
    course = load_course_scene(args.input, *args.size, **options)
    if course.left_out:
        print(list_errors(course.left_out, len(course.left_out), args.input), file=sys.stderr)
    with error_prefix(args.input):
        images = render_course(course, args.threads)
    pictures = {
        "-output": to_bytes_truncated(images.color),
        "-depth": depth_image(images, near, far),
        "-normals": normal_image(images),
    }
    for option, path in wanted.items():
        write_image(path, pictures[option])
    height, width = images.hit.shape
    found = f"t {images.t[images.hit].min():.6g} to {images.t[images.hit].max():.6g}" if images.hit.any() else "no hit"
    print(f"{', '.join(wanted.values())}: {width} x {height} pixels, {int(images.hit.sum())} hit, {found}")
    return OK


def _depth_range(words: list[str]) -> tuple[float, float]:
    """NEAR and FAR of -depth. Raises SceneError unless NEAR < FAR, both finite."""
    try:
        near, far = float(words[0]), float(words[1])
    except ValueError:
        near = far = math.nan
    if not -math.inf < near < far < math.inf:
        raise SceneError(f"-depth {' '.join(words)}: expected two finite numbers NEAR < FAR, and a file name")
    return near, far
