"""`caster 6837`: scene files, options and pictures of the course MIT 6.837."""

from __future__ import annotations

import argparse
import sys

from caster.commands.render import thread_count
from caster.commands.scene_arguments import add_mesh_dirs, blamed_on
from caster.exits import OK
from caster.wording import SceneError

NAME = "6837"
HELP = "draw a scene file of MIT 6.837, with that course's options and pictures (docs/classroom.md)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("-input", metavar="SCENE.txt", required=True, help="a scene file of the course")
    add("-size", nargs=2, type=int, metavar=("W", "H"), default=(100, 100), help="default: 100 100")
    add("-output", metavar="IMAGE", help="the colours: diffuse and ambient light, .png or .tga")
    add(
        "-depth",
        nargs=3,
        metavar=("NEAR", "FAR", "IMAGE"),
        help="t along the ray: white at NEAR, black at FAR and where nothing is hit",
    )
    add("-normals", metavar="IMAGE", help="|x|, |y|, |z| of the normal as red, green, blue")
    add("-shade_back", action="store_true", help="light surfaces from behind, too, instead of black")
    add("-shadows", action="store_true", help="lights cast shadows")
    add("--threads", type=thread_count, metavar="N", help="default: as many as there are cores")
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Draw, write, and say what was written and what was left out. Raises SceneError, FileMissing, OutputError."""
    near, far = depth_range(args.depth)
    pictures = {"-output": args.output, "-depth": args.depth and args.depth[2], "-normals": args.normals}
    wanted = {option: path for option, path in pictures.items() if path is not None}
    check(wanted)
    check_size(args.size)
    from caster.classroom.drawing import bytes_of, depth_picture, draw, normal_picture
    from caster.classroom.reading import load_course_scene
    from caster.pictures.files import write_picture
    from caster.progress import announced, kinds_in

    options = {"shade_back": args.shade_back, "shadows": args.shadows, "mesh_dirs": args.mesh_dir}
    with announced("mesh files"):
        course = load_course_scene(args.input, *args.size, **options)
    for text in course.left_out:
        print(text, file=sys.stderr)
    with blamed_on(args.input), announced(kinds_in(course.scene)):
        drawn = draw(course, args.threads)
    draws = {
        "-output": lambda: bytes_of(drawn.color),
        "-depth": lambda: depth_picture(drawn, near, far),
        "-normals": lambda: normal_picture(drawn),
    }
    for option, path in wanted.items():
        write_picture(path, draws[option]())
    height, width = drawn.hit.shape
    found = (
        f"t {drawn.t[drawn.hit].min():.6g} to {drawn.t[drawn.hit].max():.6g}" if drawn.hit.any() else "no hit"
    )
    print(f"{', '.join(wanted.values())}: {width} x {height} pixels, {int(drawn.hit.sum())} hit, {found}")
    return OK


def depth_range(words: list[str] | None) -> tuple[float, float]:
    """NEAR and FAR. Raises SceneError unless they are two different numbers."""
    if words is None:
        return 0.0, 1.0
    try:
        near, far = float(words[0]), float(words[1])
    except ValueError:
        raise SceneError(f"-depth {' '.join(words)}: expected two numbers and a file name") from None
    if not (abs(near) < float("inf") and abs(far) < float("inf") and near < far):
        raise SceneError(f"-depth {' '.join(words)}: expected NEAR < FAR, two finite numbers")
    return near, far


def check(wanted: dict[str, str]) -> None:
    """Raise SceneError or OutputError now, and not after the work."""
    from caster.pictures.files import check_picture_name
    from caster.whole_files import check_writable

    if not wanted:
        raise SceneError("nothing to draw: expected at least one of -output, -depth, -normals")
    for option, path in wanted.items():
        check_picture_name(option, path)
        check_writable(path)


def check_size(size: tuple[int, int]) -> None:
    """Raise SceneError for no film, in the words of the option, since a scene file of the course says nothing of it."""
    from caster.film import Film

    with blamed_on("-size", *size):
        Film(width=size[0], height=size[1])
