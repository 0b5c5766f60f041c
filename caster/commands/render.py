"""`caster render`: a scene file in, an EXR file out."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from caster import __version__
from caster.commands.scene_arguments import add_scene, blamed_on, load
from caster.exits import OK
from caster.wording import SceneError

if TYPE_CHECKING:
    from caster.progress_bar import Bar
    from caster.rendering import Aovs
    from caster.scene import Scene

HELP = "render a scene to an EXR file"

# Named here too, since loading the AOVs loads the kernels (tests/unit/test_cli_help.py compares).
AOVS = "hit, depth, normal, shading_normal, position, uv, albedo, diffuse, shape_id, prim_id"
DEFAULT = "hit,depth,normal,position,diffuse"
CORNERS = ("X0", "Y0", "X1", "Y1")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add("-o", "--output", metavar="OUT.exr", help="default: the scene's name with .exr, in this folder")
    add("--aov", metavar="A,B,...", help=f"of {AOVS}; default: {DEFAULT}")
    add("--crop", nargs=4, type=int, metavar=CORNERS, help="these pixels only; X1 and Y1 are just outside")
    add("--threads", type=thread_count, metavar="N", help="default: as many as there are cores")
    add("--explain", action="store_true", help="say how it was computed, and what was skipped")
    add("--json", action="store_true", help="say the same as JSON, with counts of the work done")
    add(
        "--preview",
        metavar="PNG",
        help="write a picture as well, and say on standard error what its colours mean",
    )
    add(
        "--preview-aov",
        metavar="A,B,...",
        help="what it shows; several become a labelled strip; default: the one that tells most",
    )


def thread_count(text: str) -> int:
    """A whole number >= 1, or an error in argparse's way."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number >= 1, got '{text}'")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Render, write, and say what was written. Raises SceneError, FileMissing, OutputError."""
    from caster.progress import announced, kinds_in

    with announced("mesh files"):
        scene = cropped(load(args), args.crop)
    output = output_path(args)
    from caster.rendering import check_names, render_film
    from caster.whole_files import check_writable

    aovs = tuple(dict.fromkeys((DEFAULT if args.aov is None else args.aov).split(",")))
    check_names(aovs)
    shown = preview_names(args, aovs)
    check_writable(output)  # before a render that may take long
    with blamed_on(args.scene), announced(kinds_in(scene)), closing(bar_for(scene)) as bar:
        rendered = render_film(scene, aovs, threads=args.threads, told=bar.add)
    images = rendered.aovs
    write(output, scene, images, args.scene)
    if args.preview is not None:
        preview(args.preview, images, shown)
    if args.json:
        from caster.explain import account
        from caster.kernels.jit import WORK

        kernels = {"compiled": WORK.compiled, "loaded": WORK.loaded}
        print(json.dumps({"output": output, **account(rendered, aovs), "kernels": kernels}, indent=2))
        return OK
    if args.explain:
        from caster.explain import explain

        print(explain(rendered, aovs))
    height, width = images.hit.shape
    print(f"{output}: {width} x {height} pixels, {int(images.hit.sum())} hit; {', '.join(aovs)}")
    return OK


def output_path(args: argparse.Namespace) -> str:
    """Where to write: as asked, else the scene's name in the current folder."""
    output = args.output if args.output is not None else f"{Path(args.scene).stem}.exr"
    check_suffix(output)
    return output


def bar_for(scene: Scene) -> Bar:
    """How far a render has come."""
    from caster.progress_bar import Bar

    x0, y0, x1, y1 = scene.film.window
    return Bar("rendering", (x1 - x0) * (y1 - y0), "rays")


def preview_names(args: argparse.Namespace, aovs: Sequence[str]) -> list[str]:
    """The AOVs to show. Raises SceneError or OutputError now, and not after a render that may take long."""
    if args.preview is None:
        if args.preview_aov is not None:
            raise SceneError(f"--preview-aov {args.preview_aov}: needs --preview PNG, the file to write")
        return []
    from caster.pictures.files import check_picture_name
    from caster.whole_files import check_writable

    check_picture_name("--preview", args.preview)
    check_writable(args.preview)
    names = [] if args.preview_aov is None else list(dict.fromkeys(args.preview_aov.split(",")))
    for name in names:
        if name not in {*aovs, "hit"}:
            raise SceneError(f"--preview-aov {args.preview_aov}: '{name}' is none of --aov {','.join(aovs)}")
    return names


def preview(path: str, images: Aovs, names: Sequence[str]) -> None:
    """Write the picture, and what its colours mean to standard error."""
    from caster.pictures.preview import pictures_of, write_preview

    for line in write_preview(path, pictures_of(images, names)):
        print(f"{path}: {line}", file=sys.stderr)


def check_suffix(output: str) -> None:
    """Raise SceneError for an output that other programs would not take for an EXR file."""
    if Path(output).suffix.lower() != ".exr":
        raise SceneError(f"-o {output}: expected a name that ends in .exr")


def cropped(scene: Scene, crop: list[int] | None) -> Scene:
    """The scene with the crop that was asked for."""
    if crop is None:
        return scene
    with blamed_on("--crop", *crop):
        return scene.with_film(crop=crop)


def write(output: str, scene: Scene, images: Aovs, path: str, more: Mapping[str, str] = {}) -> None:
    """The file: channels, where they lie on the film, and where they come from; more: about that."""
    from caster.channels import channels_of, provenance
    from caster.exr import write_exr

    film = (0, 0, scene.film.width, scene.film.height)
    about = {**provenance(scene, __version__, path), **more}
    write_exr(output, channels_of(images), about, data_window=scene.film.window, display_window=film)
