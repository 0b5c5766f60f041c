"""`caster render`, `check` and `schema`: scene files rendered to EXR files, and validated; their JSON Schema."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from caster.cli.shared_arguments import (
    AOV_NAMES,
    DEFAULT_AOV_LIST,
    SCENE_FILE,
    Adder,
    InputPath,
    OutputFile,
    add_mesh_dirs,
    add_scene,
    add_threads,
    check_exr_suffix,
    comma_separated,
    engine,
    load,
)
from caster.description.errors import SceneError, error_prefix
from caster.system.process import FILE, OK, USAGE
from caster.system.terminal import folded

if TYPE_CHECKING:
    from caster.aovs import Aovs
    from caster.rendering.images import RenderResult

# ---- render: a scene file in, an EXR file out ----


def add_arguments(add: Adder) -> None:
    add_scene(add)
    add(
        "-o --output",
        OutputFile,
        "default: the scene's name with .exr, in this folder; written in tiles, as they are rendered",
        metavar="OUT.exr",
    )
    add("--aov", str, f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}", metavar="A,B,...")
    add("--crop", int, "render these pixels only; X1 and Y1 are exclusive", nargs=4, metavar=("X0", "Y0", "X1", "Y1"))
    add_threads(add)
    add(
        "--engine",
        engine,
        "what renders the bands of a large film: local; dask, a Dask cluster started here; or dask:ADDRESS",
        metavar="ENGINE",
        default="local",
    )
    add("--explain", bool, "print how the image was computed, and what was skipped")
    add("--json", bool, "print the same as JSON, with counts of the work done")


def run(args: Namespace) -> int:
    """Render, write the file band by band and print a summary. Raises SceneError, FileMissing, OutputError."""
    scene = load(args)
    if args.crop is not None:
        with error_prefix("--crop", *args.crop):
            scene = scene.with_film(crop=args.crop)
    output = args.output if args.output is not None else f"{Path(args.scene).stem}.exr"
    check_exr_suffix(output)
    from caster.cli.distributed_render import bands_on
    from caster.image.channels import write_render
    from caster.rendering.images import bands_of, check_names, render_bands, render_film
    from caster.rendering.threads import thread_count
    from caster.rendering.warm_up import compile_for
    from caster.system.terminal import ProgressBar

    aovs = tuple(comma_separated(DEFAULT_AOV_LIST if args.aov is None else args.aov))
    check_names(aovs)
    x0, y0, x1, y1 = scene.film.window
    with error_prefix(args.scene):
        compile_for(scene, f"film {' '.join(aovs)}", lambda small: render_film(small, aovs))
    rendered: RenderResult

    def bands() -> Iterator[Aovs]:
        nonlocal rendered
        with error_prefix(args.scene):
            found = (render_film(each, aovs, threads=args.threads, on_progress=bar.add) for each in bands_of(scene))
            if args.engine != "local":
                found = bands_on(args.engine, args.threads, scene, (args.scene, *args.mesh_dir), aovs, bar.add)
            with closing(found):
                for rendered in render_bands(scene, found):
                    yield rendered.aovs

    with closing(ProgressBar("rendering", (x1 - x0) * (y1 - y0))) as bar:
        write_render(output, scene, bands(), args.scene, threads=thread_count(args.threads))
    if args.json:
        from caster.cli.inspection import account
        from caster.jit.decorators import COMPILATION_LOG

        kernels = {"compiled": COMPILATION_LOG.compiled, "loaded": COMPILATION_LOG.loaded}
        print(json.dumps({"output": output, **account(rendered, aovs), "kernels": kernels}, indent=2))
        return OK
    if args.explain:
        from caster.cli.inspection import explain

        print(explain(rendered, aovs))
    print(f"{output}: {x1 - x0} x {y1 - y0} pixels, {rendered.hits} hit; {', '.join(aovs)}")
    return OK


# ---- check and schema ----


def add_check_arguments(add: Adder) -> None:
    add("scenes", InputPath, SCENE_FILE, metavar="SCENE", nargs="+")
    add_mesh_dirs(add)


def run_check(args: Namespace) -> int:
    """Print one line for a valid scene, all errors of an invalid one. 2 if any is invalid, 4 if any is missing."""
    from caster.geometry.packing import in_words
    from caster.scene.files import load_scene

    codes = set()
    for path in args.scenes:
        try:
            scene = load_scene(path, args.mesh_dir)
            with error_prefix(path):
                never_hit = in_words(scene)  # of packed shapes: some errors appear only in world space
        except SceneError as error:
            print(folded(str(error)))
            codes.add(error.exit_code)
            continue
        print(f"{path}: ok, {len(scene.shapes)} shapes" + (f"; faces never hit: {never_hit}" if never_hit else ""))
    return next((code for code in (USAGE, FILE) if code in codes), OK)


def print_schema(args: Namespace) -> int:
    """Print the JSON Schema of scene files."""
    from caster.scene.files import scene_schema

    print(json.dumps(scene_schema(), indent=2))
    return OK
