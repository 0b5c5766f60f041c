"""`caster render`, `check` and `schema`: scene files rendered to EXR files, and validated; their JSON Schema."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from caster.cli.shared_arguments import (
    AOV_NAMES,
    DEFAULT_AOV_LIST,
    SCENE_FILE,
    InputPath,
    OutputFile,
    add_mesh_dirs,
    add_scene,
    add_threads,
    check_exr_suffix,
    comma_separated,
    load,
)
from caster.description.errors import SceneError, error_prefix
from caster.system.process import FILE, OK, USAGE

if TYPE_CHECKING:
    from caster.aovs import Aovs
    from caster.scene.model import Scene
    from caster.system.terminal import ProgressBar

# ---- render: a scene file in, an EXR file out ----

CROP_METAVARS = ("X0", "Y0", "X1", "Y1")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add(
        "-o", "--output", metavar="OUT.exr", type=OutputFile, help="default: the scene's name with .exr, in this folder"
    )
    add("--aov", type=str, metavar="A,B,...", help=f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}")
    add("--crop", nargs=4, type=int, metavar=CROP_METAVARS, help="render these pixels only; X1 and Y1 are exclusive")
    add_threads(parser)
    add("--explain", action="store_true", help="print how the image was computed, and what was skipped")
    add("--json", action="store_true", help="print the same as JSON, with counts of the work done")
    add(
        "--preview",
        type=OutputFile,
        metavar="PNG",
        help="write an image for viewing as well, and its colour legend to standard error",
    )
    add(
        "--preview-aov",
        type=str,
        metavar="A,B,...",
        help="which AOVs it shows; several become a labelled strip; default: diffuse, else normal or depth",
    )


def run(args: argparse.Namespace) -> int:
    """Render, write the file and print a summary. Raises SceneError, FileMissing, OutputError."""
    scene = cropped(load(args), args.crop)
    output = output_path(args)
    from caster.image.channels import write_render
    from caster.rendering.images import check_names, render_film
    from caster.rendering.threads import thread_count
    from caster.rendering.warm_up import compile_film
    from caster.system.atomic_files import check_writable

    aovs = tuple(comma_separated(DEFAULT_AOV_LIST if args.aov is None else args.aov))
    check_names(aovs)
    shown = preview_names(args, aovs)
    check_writable(output)  # before a render that may take long
    with error_prefix(args.scene):
        compile_film(scene, aovs)
    with error_prefix(args.scene), closing(bar_for(scene)) as bar:
        rendered = render_film(scene, aovs, threads=args.threads, on_progress=bar.add)
    images = rendered.aovs
    threads = thread_count(args.threads)
    write_render(output, scene, images, args.scene, threads=threads)
    if args.preview is not None:
        save_preview(args.preview, images, shown)
    if args.json:
        from caster.jit.decorators import COMPILATION_LOG
        from caster.rendering.inspection import account

        kernels = {"compiled": COMPILATION_LOG.compiled, "loaded": COMPILATION_LOG.loaded}
        print(json.dumps({"output": output, **account(rendered, aovs), "kernels": kernels}, indent=2))
        return OK
    if args.explain:
        from caster.rendering.inspection import explain

        print(explain(rendered, aovs))
    height, width = images.hit.shape
    print(f"{output}: {width} x {height} pixels, {int(images.hit.sum())} hit; {', '.join(aovs)}")
    return OK


def output_path(args: argparse.Namespace) -> str:
    """The value of -o, default the scene's name in the current folder."""
    output = args.output if args.output is not None else f"{Path(args.scene).stem}.exr"
    check_exr_suffix(output)
    return output


def bar_for(scene: Scene) -> ProgressBar:
    """The progress bar of a render, counted in camera rays."""
    from caster.system.terminal import ProgressBar

    x0, y0, x1, y1 = scene.film.window
    return ProgressBar("rendering", (x1 - x0) * (y1 - y0), "rays")


def preview_names(args: argparse.Namespace, aovs: Sequence[str]) -> list[str]:
    """The AOVs of the preview, validated before a render that may take long. Raises SceneError, OutputError."""
    if args.preview is None:
        if args.preview_aov is not None:
            raise SceneError(f"--preview-aov {args.preview_aov}: needs --preview PNG, the file to write")
        return []
    from caster.image.image_files import check_image_name
    from caster.system.atomic_files import check_writable

    check_image_name("--preview", args.preview)
    check_writable(args.preview)
    names = comma_separated(args.preview_aov)
    for name in names:
        if name not in {*aovs, "hit"}:
            raise SceneError(f"--preview-aov {args.preview_aov}: '{name}' is none of --aov {','.join(aovs)}")
    return names


def save_preview(path: str, images: Aovs, names: Sequence[str]) -> None:
    """Write the preview image, and its colour legend to standard error."""
    from caster.image.previews import aov_images, write_preview

    for line in write_preview(path, aov_images(images, names)):
        print(f"{path}: {line}", file=sys.stderr)


def cropped(scene: Scene, crop: list[int] | None) -> Scene:
    """The scene with the film window of --crop."""
    if crop is None:
        return scene
    with error_prefix("--crop", *crop):
        return scene.with_film(crop=crop)


# ---- check and schema ----


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", metavar="SCENE", type=InputPath, nargs="+", help=SCENE_FILE)
    add_mesh_dirs(parser)


def run_check(args: argparse.Namespace) -> int:
    """Print one line for a valid scene, all errors of an invalid one. 2 if any is invalid, 4 if any is missing."""
    codes = {check_file(scene, args.mesh_dir) for scene in args.scenes}
    return next(code for code in (USAGE, FILE, OK) if code in codes)


def check_file(path: str, mesh_dirs: list[str]) -> int:
    """Validate one scene file with its meshes and print the outcome; its exit code."""
    from caster.geometry.packing import in_words, pack
    from caster.scene.files import load_scene

    try:
        scene = load_scene(path, mesh_dirs)
        with error_prefix(path):
            pack(scene)  # some errors appear only in world space
            never_hit = in_words(scene)
    except SceneError as error:
        print(error)
        return error.exit_code
    print(f"{path}: ok, {len(scene.shapes)} shapes" + (f"; faces never hit: {never_hit}" if never_hit else ""))
    return OK


def no_arguments(parser: argparse.ArgumentParser) -> None:
    """`caster schema` takes none."""


def print_schema(args: argparse.Namespace) -> int:
    """Print the JSON Schema of scene files."""
    from caster.scene.files import scene_schema

    print(json.dumps(scene_schema(), indent=2))
    return OK
