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
from caster.cli.exit_codes import OK
from caster.cli.scene_arguments import add_scene, error_prefix, load
from caster.description.errors import SceneError

__all__ = ["AOV_NAMES", "DEFAULT_AOV_LIST", "check_exr_suffix", "write_render"]

if TYPE_CHECKING:
    from caster.cli.progress import ProgressBar
    from caster.rendering.images import Aovs
    from caster.scene.model import Scene

HELP = "render a scene to an EXR file"

# Named here too, since loading the AOVs loads the kernels (tests/unit/test_cli_help.py compares).
AOV_NAMES = "hit, depth, normal, shading_normal, position, uv, albedo, diffuse, shape_id, prim_id"
DEFAULT_AOV_LIST = "hit,depth,normal,position,diffuse"
CROP_METAVARS = ("X0", "Y0", "X1", "Y1")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add("-o", "--output", metavar="OUT.exr", help="default: the scene's name with .exr, in this folder")
    add("--aov", metavar="A,B,...", help=f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}")
    add(
        "--crop",
        nargs=4,
        type=int,
        metavar=CROP_METAVARS,
        help="these pixels only; X1 and Y1 are just outside",
    )
    add("--threads", type=positive_int, metavar="N", help="default: as many as there are cores")
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


def positive_int(text: str) -> int:
    """A whole number >= 1, or an error in argparse's way."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number >= 1, got '{text}'")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Render, write, and say what was written. Raises SceneError, FileMissing, OutputError."""
    from caster.cli.progress import announce_compilation, type_names

    with announce_compilation("mesh files"):
        scene = cropped(load(args), args.crop)
    output = output_path(args)
    from caster.image.atomic_files import check_writable
    from caster.rendering.images import check_names, render_film

    aovs = tuple(dict.fromkeys((DEFAULT_AOV_LIST if args.aov is None else args.aov).split(",")))
    check_names(aovs)
    shown = preview_names(args, aovs)
    check_writable(output)  # before a render that may take long
    with error_prefix(args.scene), announce_compilation(type_names(scene)), closing(bar_for(scene)) as bar:
        rendered = render_film(scene, aovs, threads=args.threads, on_progress=bar.add)
    images = rendered.aovs
    write_render(output, scene, images, args.scene)
    if args.preview is not None:
        preview(args.preview, images, shown)
    if args.json:
        from caster.jit.decorators import COMPILATION_LOG
        from caster.rendering.explain import account

        kernels = {"compiled": COMPILATION_LOG.compiled, "loaded": COMPILATION_LOG.loaded}
        print(json.dumps({"output": output, **account(rendered, aovs), "kernels": kernels}, indent=2))
        return OK
    if args.explain:
        from caster.rendering.explain import explain

        print(explain(rendered, aovs))
    height, width = images.hit.shape
    print(f"{output}: {width} x {height} pixels, {int(images.hit.sum())} hit; {', '.join(aovs)}")
    return OK


def output_path(args: argparse.Namespace) -> str:
    """Where to write: as asked, else the scene's name in the current folder."""
    output = args.output if args.output is not None else f"{Path(args.scene).stem}.exr"
    check_exr_suffix(output)
    return output


def bar_for(scene: Scene) -> ProgressBar:
    """How far a render has come."""
    from caster.cli.progress import ProgressBar

    x0, y0, x1, y1 = scene.film.window
    return ProgressBar("rendering", (x1 - x0) * (y1 - y0), "rays")


def preview_names(args: argparse.Namespace, aovs: Sequence[str]) -> list[str]:
    """The AOVs to show. Raises SceneError or OutputError now, and not after a render that may take long."""
    if args.preview is None:
        if args.preview_aov is not None:
            raise SceneError(f"--preview-aov {args.preview_aov}: needs --preview PNG, the file to write")
        return []
    from caster.image.atomic_files import check_writable
    from caster.image.image_files import check_image_name

    check_image_name("--preview", args.preview)
    check_writable(args.preview)
    names = [] if args.preview_aov is None else list(dict.fromkeys(args.preview_aov.split(",")))
    for name in names:
        if name not in {*aovs, "hit"}:
            raise SceneError(f"--preview-aov {args.preview_aov}: '{name}' is none of --aov {','.join(aovs)}")
    return names


def preview(path: str, images: Aovs, names: Sequence[str]) -> None:
    """Write the picture, and what its colours mean to standard error."""
    from caster.image.previews import aov_images, write_preview

    for line in write_preview(path, aov_images(images, names)):
        print(f"{path}: {line}", file=sys.stderr)


def check_exr_suffix(output: str) -> None:
    """Raise SceneError for an output that other programs would not take for an EXR file."""
    if Path(output).suffix.lower() != ".exr":
        raise SceneError(f"-o {output}: expected a name that ends in .exr")


def cropped(scene: Scene, crop: list[int] | None) -> Scene:
    """The scene with the crop that was asked for."""
    if crop is None:
        return scene
    with error_prefix("--crop", *crop):
        return scene.with_film(crop=crop)


def write_render(output: str, scene: Scene, images: Aovs, path: str, more: Mapping[str, str] = {}) -> None:
    """The file: channels, where they lie on the film, and where they come from; more: about that."""
    from caster.image.channels import aovs_to_channels, provenance
    from caster.image.exr import write_exr

    film = (0, 0, scene.film.width, scene.film.height)
    about = {**provenance(scene, __version__, path), **more}
    write_exr(output, aovs_to_channels(images), about, data_window=scene.film.window, display_window=film)
