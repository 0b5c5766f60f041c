"""`mitsuba-ref judge`: answers that were computed elsewhere, of any rays or as an EXR file, against Mitsuba."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from caster.cli.exit_codes import DIFFERENCES, OK
from caster.cli.path_arguments import InputPath, OutputFolder
from caster.cli.scene_arguments import add_mesh_dirs
from caster.description.errors import SceneError
from mitsuba_ref.cli.options import HTML_SUFFIX, PRECISIONS, add_verdict_files, html_output
from mitsuba_ref.cli.validate import check_outputs, print_rows, write_results

if TYPE_CHECKING:
    from caster.scene.model import Scene
    from mitsuba_ref.runner.scene_runner import SceneEntry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--scene", metavar="SCENE", type=InputPath, help="the scene that was cast into")
    what.add_argument("--mesh", metavar="FILE", type=InputPath, help="the same as a mesh file: OBJ or PLY")
    answers = parser.add_mutually_exclusive_group(required=True)
    help_ = ".npz of t, and n, shape_id, prim_id, any_hit if given; or .npy of shape (n, 1), (n, 4), (n, 5)"
    answers.add_argument("--hits", metavar="FILE", type=InputPath, help=help_)
    help_ = "an EXR file of depth.Z, normal.X/Y/Z, position.X/Y/Z, A, of the scene's camera"
    answers.add_argument("--exr", metavar="FILE", type=InputPath, help=help_)
    add(
        "--rays",
        type=InputPath,
        metavar="FILE",
        help=".npz of `rays`, or .npy, (n, 8): o, d, t_min, t_max (docs/rays-and-hits.md)",
    )
    help_ = "the arithmetic of the answers, from which their bounds follow; default: the type of t and n"
    add("--precision", metavar="P", choices=PRECISIONS, help=help_)
    add("--rows", metavar="A:B", type=row_range, help="judge these rays alone: one, or from A up to B")
    add_mesh_dirs(parser)
    out_help = "write verdict.json, EXR files and reproducers into this folder"
    add("--out", metavar="DIR", type=OutputFolder, help=out_help)
    add_verdict_files(parser)
    html_help = f"write a report: a folder, or one file if PATH ends in {HTML_SUFFIX}"
    add("--html", metavar="PATH", type=html_output, help=html_help)
    parser.set_defaults(resume=False)


def row_range(text: str) -> tuple[int, int | None]:
    """A:B, A: or one row. Raises argparse.ArgumentTypeError."""
    first, colon, end = text.partition(":")
    if not (first.isdecimal() or (colon and not first)) or not (end.isdecimal() or not end):
        raise argparse.ArgumentTypeError(f"expected rows such as 17 or 100:200, got '{text}'")
    start = int(first or 0)
    stop = (int(end) if end else None) if colon else start + 1
    if stop is not None and stop <= start:
        raise argparse.ArgumentTypeError(f"expected at least one row, got '{text}'")
    return start, stop


def run(args: argparse.Namespace) -> int:
    """Judge the answers; 0 they pass, 1 they do not."""
    check_outputs(args)
    entries = exr_entries(args) if args.exr else hits_entries(args)
    from mitsuba_ref.reference import variants
    from mitsuba_ref.runner.validation_run import RunOptions, ValidationRun

    variants.variant_for(has_quadrics=False)
    start = time.perf_counter()
    options = RunOptions(out=Path(args.out) if args.out else None, html=args.html)
    running = ValidationRun(entries, options, entries[0].subject)
    try:
        print_rows(running)
        write_results(running, args, time.perf_counter() - start)
    finally:
        running.finish_report(running.verdict())
    return OK if running.verdict().ok else DIFFERENCES


def requested_scene(args: argparse.Namespace) -> Scene:
    """Of --scene, or the mesh of --mesh alone. Raises SceneError, FileMissing."""
    from caster.cameras.ray import Ray
    from caster.scene.files import load_scene
    from caster.scene.model import Scene
    from caster.shapes.mesh import MeshFile

    if args.scene:
        return load_scene(args.scene, args.mesh_dir)
    return Scene(camera=Ray(**Ray.MINIMAL), shapes=[MeshFile(file=args.mesh, name="mesh")])


def hits_entries(args: argparse.Namespace) -> list[SceneEntry]:
    """One scene to judge for nearest hits, and one for any-hit answers. Raises SceneError, FileMissing."""
    from mitsuba_ref.runner.scene_runner import SceneEntry
    from mitsuba_ref.subjects.ray_files import HitsFile, lay_out, read_hits, read_rays

    if args.rays is None:
        raise SceneError("--hits: expected --rays FILE beside it, the rays that these are the hits of")
    scene, rays, hits = requested_scene(args), read_rays(args.rays), read_hits(args.hits)
    count = len(rays.rows)
    for name, values in hits.items():
        if len(values.shape) == 0 or len(values) != count:
            raise SceneError(
                f"{args.hits}: {name}: expected one row for each of the {count} rays, got shape {values.shape}"
            )
    if not {"t", "any_hit"} & hits.keys():
        raise SceneError(f"{args.hits}: expected an array t, or any_hit; got {', '.join(hits)}")
    first, end = args.rows or (0, count)
    end = count if end is None else min(end, count)
    if first >= count:
        raise SceneError(f"--rows {first}: expected a ray of 0 to {count - 1}")
    whole = (first, end) == (0, count)
    some = rays._replace(rows=rays.rows[first:end], width=rays.width if whole else 0)
    film_scene, shared = lay_out(scene, some, args.rays)
    arrays = {name: values[first:end] for name, values in hits.items()}
    source = args.scene or args.mesh
    name = Path(source).stem
    entries = []
    for any_hit in (False, True):
        if ("any_hit" if any_hit else "t") in hits:
            subject = HitsFile(args.hits, arrays, args.precision, any_hit)
            title = f"{name} any-hit" if any_hit and "t" in hits else name
            about: dict[str, Any] = {
                "options": option_words(args),
                "command": "judge",
                "ray_range": (first, end),
            }
            entries.append(SceneEntry(film_scene, title, source, subject=subject, rays=shared, **about))
    return entries


def exr_entries(args: argparse.Namespace) -> list[SceneEntry]:
    """One scene to judge by its depth, and one by its position, if the file has it. Raises SceneError, FileMissing."""
    from caster.image.exr import read_exr
    from mitsuba_ref.runner.scene_runner import SceneEntry
    from mitsuba_ref.subjects.command import DEPTH, POSITION, ExrFile

    if args.rays is not None or args.rows is not None or args.mesh is not None:
        option = "--rays" if args.rays is not None else "--rows" if args.rows is not None else "--mesh"
        raise SceneError(f"{option}: not with --exr, whose pixels are rays of the scene's camera")
    scene = requested_scene(args)
    exr = read_exr(args.exr)
    ways = [way for way in (DEPTH, POSITION[0]) if way in exr.channels] or [DEPTH]
    entries = []
    for way in ways:
        subject = ExrFile(args.exr, exr, args.precision, by_position=way != DEPTH)
        title = Path(args.scene).stem + (" position" if way != DEPTH and len(ways) > 1 else "")
        entries.append(
            SceneEntry(scene, title, args.scene, subject=subject, options=option_words(args), command="judge")
        )
    return entries


def option_words(args: argparse.Namespace) -> tuple[str, ...]:
    """Options that show the same again."""
    named = ("scene", "mesh", "rays", "hits", "exr", "precision")
    given = [(name, getattr(args, name)) for name in named if getattr(args, name) is not None]
    folders = [("mesh-dir", folder) for folder in args.mesh_dir]
    return tuple(word for name, value in (*given, *folders) for word in (f"--{name}", str(value)))
