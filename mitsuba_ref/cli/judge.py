"""`mitsuba-ref rays` and `mitsuba-ref judge`: rays for other programs, and their answers against Mitsuba."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from caster.cli.shared_arguments import (
    InputPath,
    OutputFile,
    OutputFolder,
    add_mesh_dirs,
    add_scene,
    load,
    positive_int,
)
from caster.description.errors import SceneError
from caster.system.process import OK
from mitsuba_ref.cli.options import PRECISIONS, add_verdict_files, given_words
from mitsuba_ref.cli.validate import check_outputs, exit_code, print_rows, write_results

if TYPE_CHECKING:
    import numpy as np

    from caster.scene.model import Scene
    from mitsuba_ref.runner.many_scenes import SceneEntry
    from mitsuba_ref.subjects.subject import Subject


# ---- rays of a scene, as a file ----

RAY_KINDS = ("camera", "random", "edges", "vertices", "silhouettes", "surface", "mixed", "shadow")
SHADOW_T_MIN = 2.0**-10  # lengths of d, the way to a point light: a shadow ray leaves its own surface


def add_rays_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add("-o", "--output", metavar="RAYS", type=OutputFile, required=True, help=".npz, or .npy for the rows alone")
    help_ = "camera (default); random; aimed at edges, vertices or silhouettes; from surfaces; mixed; shadow: from "
    help_ += "what the camera sees to a light"
    add("--kind", choices=RAY_KINDS, default="camera", help=help_)
    add("--count", metavar="N", type=positive_int, default=4096, help="of rays that are aimed; default 4096")
    add("--seed", metavar="S", type=int, default=0, help="of random numbers; default 0")
    add("--light", metavar="I", type=int, default=0, help="number of the light of shadow rays; default 0")
    add("--t-min", metavar="T", type=float, help="t_min of every ray, in lengths of d")
    add("--t-max", metavar="T", type=float, help="t_max of every ray")
    add("--float64", action="store_true", help="write the same numbers, of float32, as float64")


def run_rays(args: argparse.Namespace) -> int:
    """Write the rays; the number of them goes to standard output."""
    scene = load(args)
    import numpy as np

    from mitsuba_ref.subjects.ray_files import checked_rays, write_rays

    make = {"camera": camera_rows, "shadow": shadow_rows}.get(args.kind, aimed_rows)
    with np.errstate(over="ignore"):
        rows, pixels = make(scene, args)
        for column, limit in ((6, args.t_min), (7, args.t_max)):
            if limit is not None:
                rows[:, column] = limit
        rows = rows.astype(np.float32)
    whole = pixels is not None and len(pixels) == scene.film.width * scene.film.height
    rays = checked_rays(rows, args.output, scene.film.width if whole else 0)
    if args.float64:
        rays = rays._replace(rows=rays.rows.astype(np.float64))
    write_rays(args.output, rays, **({} if pixels is None else {"pixels": pixels}))
    print(f"{args.output}: {len(rows)} rays")
    return OK


def camera_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """(the rays that `validate` shares with Mitsuba (n, 8), their pixels (n, 2))."""
    import numpy as np

    from mitsuba_ref.reference.shared_input import pixel_of, shared_rays

    rays = shared_rays(scene)
    there = np.flatnonzero(rays.t_max >= 0.0)
    rows = np.column_stack([rays.o, rays.d, np.zeros(len(rays.t_max)), rays.t_max])[there]
    return rows, np.array([pixel_of(scene, int(row)) for row in there], np.int32).reshape(-1, 2)


def shadow_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """Rays from what the camera hits to a light, d all the way to one that is a point. Raises SceneError."""
    import numpy as np

    from caster.rendering.hits import cast
    from mitsuba_ref.error_model.lambert import direction_to_light

    lights = [light for light in scene.lights if light.type != "ambient"]
    if not 0 <= args.light < len(lights):
        raise SceneError(f"--light {args.light}: the scene has {len(lights)} lights that cast shadows")
    rows, pixels = camera_rows(scene, args)
    hits = cast(scene, rows[:, :3], rows[:, 3:6])
    hit = np.isfinite(hits.t) & (hits.t <= rows[:, 7])
    p = hits.surface.p[hit].astype(np.float32).astype(np.float64)
    to_light, reach = direction_to_light(lights[args.light], p)
    some = hit.nonzero()[0]
    shadow = np.column_stack([p, to_light, np.full(len(p), SHADOW_T_MIN), reach])
    return shadow, None if pixels is None else pixels[some]


def aimed_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """Rays at what the kind says, from around the scene. Raises SceneError for a scene without primitives."""
    import numpy as np

    from mitsuba_ref.hard import rays as hard_rays
    from mitsuba_ref.reference.shared_input import packed_float32
    from mitsuba_ref.shapes.targets import random_directions

    targets, rng = hard_rays.Targets(packed_float32(scene)), np.random.default_rng(args.seed)
    if not targets.counts.sum():
        raise SceneError(f"--kind {args.kind}: {args.scene} has no primitive to aim at")
    sort = {"random": "inside", "edges": "edge", "vertices": "corner"}.get(args.kind)
    at = targets.points(rng, targets.pick(rng, args.count), sort)
    size = float(np.ptp(at.p, axis=0).max()) or 1.0
    if args.kind == "silhouettes":
        o, d = hard_rays.tangents(rng, targets, hard_rays.Frame(size), args.count)
    elif args.kind == "surface":
        o, d = at.p, random_directions(rng, args.count)
    else:
        distance = size * rng.uniform(0.5, 4.0, (args.count, 1))
        o = at.p + distance * random_directions(rng, args.count)
        d = at.p - o
    end = np.full(args.count, np.inf)
    return np.column_stack([o, d, np.zeros(args.count), end]), None


# ---- answers to any rays, or an EXR file ----


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--scene", metavar="SCENE", type=InputPath, help="the scene that was cast into")
    mesh_help = "the same as a mesh file: OBJ, PLY, STL, OFF, glTF"
    what.add_argument("--mesh", metavar="FILE", type=InputPath, help=mesh_help)
    answers = parser.add_mutually_exclusive_group(required=True)
    help_ = ".npz of t, and n, shape_id, prim_id, any_hit if given; or .npy of shape (n, 1), (n, 4), (n, 5)"
    answers.add_argument("--hits", metavar="FILE", type=InputPath, help=help_)
    help_ = "an EXR file of depth.Z, normal.X/Y/Z, A, of the scene's camera"
    answers.add_argument("--exr", metavar="FILE", type=InputPath, help=help_)
    help_ = ".npz of `rays`, or .npy, (n, 8): o, d, t_min, t_max (docs/rays-and-hits.md)"
    add("--rays", type=InputPath, metavar="FILE", help=help_)
    help_ = "the arithmetic of the answers, from which their bounds follow; default: the type of t and n"
    add("--precision", metavar="P", choices=PRECISIONS, help=help_)
    add("--rows", metavar="A:B", type=row_range, help="judge these rays alone: one, or from A up to B")
    add_mesh_dirs(parser)
    out_help = "write verdict.json, EXR files and reproducers into this folder"
    add("--out", metavar="DIR", type=OutputFolder, help=out_help)
    add_verdict_files(parser)
    add("--html", metavar="DIR", type=OutputFolder, help="write a report for the browser into this folder: index.html")


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
    from mitsuba_ref.runner.many_scenes import JudgeOptions
    from mitsuba_ref.runner.validation_run import RunOptions, ValidationRun

    variants.require_variants()
    start = time.perf_counter()
    judge = JudgeOptions(Path(args.out) if args.out else None, subject=entries[0].subject)
    running = ValidationRun(entries, RunOptions(judge, html=args.html))
    try:
        print_rows(running)
    finally:  # whatever ends the work, the results so far are written
        write_results(running, args, time.perf_counter() - start)
    return exit_code(running.verdict(), running.errors)


def requested_scene(args: argparse.Namespace) -> Scene:
    """Of --scene, or the mesh of --mesh alone. Raises SceneError, FileMissing."""
    from caster.cameras.single_ray import Ray
    from caster.scene.files import load_scene
    from caster.scene.model import Scene
    from caster.shapes.mesh import MeshFile

    if args.scene:
        return load_scene(args.scene, args.mesh_dir)
    return Scene(camera=Ray(**Ray.MINIMAL), shapes=[MeshFile(file=args.mesh, name="mesh")])


def entry_of(args: argparse.Namespace, scene: Scene, more: str, subject: Subject, **about: Any) -> SceneEntry:
    """A scene to judge, its name ending in `more`, with the options that show the same again."""
    from mitsuba_ref.runner.many_scenes import SceneEntry

    source = args.scene or args.mesh
    options = given_words(args, "scene", "mesh", "rays", "hits", "exr", "precision", "mesh_dir")
    name = Path(source).stem + more
    return SceneEntry(name, source, options=options, given=scene, subject=subject, command="judge", **about)


def hits_entries(args: argparse.Namespace) -> list[SceneEntry]:
    """One scene to judge for nearest hits, and one for any-hit answers. Raises SceneError, FileMissing."""
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
    width = rays.width if (first, end) == (0, count) else 0
    film_scene, shared = lay_out(scene, rays._replace(rows=rays.rows[first:end], width=width))
    arrays = {name: values[first:end] for name, values in hits.items()}
    entries = []
    for any_hit in (any_hit for any_hit in (False, True) if ("any_hit" if any_hit else "t") in hits):
        subject = HitsFile(args.hits, arrays, args.precision, any_hit)
        more = " any-hit" if any_hit and "t" in hits else ""
        entries.append(entry_of(args, film_scene, more, subject, rays=shared, ray_range=(first, end)))
    return entries


def exr_entries(args: argparse.Namespace) -> list[SceneEntry]:
    """The scene to judge by the image's depth. Raises SceneError, FileMissing."""
    from caster.image.exr import read_exr
    from mitsuba_ref.subjects.command import ExrFile

    for option in (option for option in ("rays", "rows", "mesh") if getattr(args, option) is not None):
        raise SceneError(f"--{option}: not with --exr, whose pixels are rays of the scene's camera")
    return [entry_of(args, requested_scene(args), "", ExrFile(args.exr, read_exr(args.exr), args.precision))]
