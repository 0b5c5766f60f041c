"""The arguments of the commands that load slowly; their work is in the modules beside this one."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from caster.cli.shared_arguments import (
    AOV_NAMES,
    DEFAULT_AOV_LIST,
    InputPath,
    OutputFile,
    OutputFolder,
    add_mesh_dirs,
    add_pixel,
    add_scene,
    positive_int,
)
from mitsuba_ref.cli.options import (
    BUILTIN_SETS,
    DEFAULT_SCENES,
    PRECISIONS,
    REFERENCE_SECONDS,
    ScenePath,
    add_candidate,
    add_skip_unsupported,
    positive_seconds,
)

if TYPE_CHECKING:
    from mitsuba_ref.runner.shards import Shard

RAY_KINDS = ("camera", "features", "silhouettes", "surface", "random", "shadow")
NUMBERS = {
    "depth_rtol": "of depth and position, instead of the derived bound",
    "normal_atol": "of normals, instead of the derived bound",
    "uv_atol": "of uv, instead of the derived bound",
    "color_rtol": "of every channel that is not geometry, relative",
    "color_atol": "of every channel that is not geometry, absolute",
}


# ---- options of several commands ----


def add_selection(parser: argparse.ArgumentParser) -> None:
    """Add scenes, -k, -j, --size and --mesh-dir."""
    add = parser.add_argument
    add(
        "scenes",
        metavar="SCENE|MESH|DIR",
        type=ScenePath,
        nargs="*",
        default=DEFAULT_SCENES,
        help="scene files, mesh files (OBJ, PLY, STL, OFF, glTF), folders of scenes, builtin:NAME; default: the folder "
        "scenes",
    )
    add(
        "--builtin",
        metavar="SET",
        nargs="?",
        const="all",
        choices=BUILTIN_SETS,
        help=f"scenes that are installed with the program: {', '.join(BUILTIN_SETS)}; without a word, all",
    )
    add(
        "-k",
        type=str,
        metavar="EXPR",
        dest="expression",
        help="scenes whose name fits, such as 'mesh and not teapot'; type:mesh is true of those with such a shape or "
        "camera, type:triangles of those with any made of triangles",
    )
    add("-j", metavar="N", dest="workers", type=positive_int, help="scenes at a time; default: one a core")
    add("--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scenes' own")
    add_mesh_dirs(parser)


def add_timeout(parser: argparse.ArgumentParser) -> None:
    """Add --timeout."""
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=positive_seconds,
        default=REFERENCE_SECONDS,
        help=f"seconds that Mitsuba may take for one scene, or one band of a large film; default {REFERENCE_SECONDS:g}",
    )


def add_reading(parser: argparse.ArgumentParser, more: str = "") -> Callable[..., argparse.Action]:
    """Add --map, --depth and --miss; the function that adds more options to their group."""
    add = parser.add_argument_group("files of other programs (docs/candidates.md)" + more).add_argument
    map_help = "a channel or group by its name there, such as depth=range or normal=facing; any number of them"
    add("--map", type=str, action="append", default=[], metavar="OURS=THEIRS", help=map_help)
    depths = ("distance", "z", "near")
    depth_help = "what depth is: along the ray (default), along z, or along the ray from the near plane"
    add("--depth", choices=depths, help=depth_help)
    miss_help = "the depth of a miss, such as 0, 1e10 or FLT_MAX; default: a miss has alpha 0, no id, or depth inf"
    add("--miss", type=str, metavar="VALUE", help=miss_help)
    return add


def add_report_files(parser: argparse.ArgumentParser) -> None:
    """Add --out, --html, and the options of add_verdict_files."""
    add = parser.add_argument
    add(
        "--out", metavar="DIR", type=OutputFolder, help="write verdict.json, EXR files and reproducers into this folder"
    )
    add("--html", metavar="DIR", type=OutputFolder, help="write a report for the browser into this folder: index.html")
    add_verdict_files(parser)


def add_verdict_files(parser: argparse.ArgumentParser) -> None:
    """Add --json, --junit and --summary-md."""
    add = parser.add_argument
    add("--json", metavar="FILE", type=OutputFile, help="write the verdict as JSON")
    add("--junit", metavar="FILE", type=OutputFile, help="write the verdict as JUnit XML")
    help_ = "append a summary in Markdown to this file, such as $GITHUB_STEP_SUMMARY"
    add("--summary-md", metavar="FILE", type=OutputFile, help=help_)


# ---- commands ----


def add_validate_arguments(parser: argparse.ArgumentParser) -> None:
    add_selection(parser)
    add = parser.add_argument
    add_report_files(parser)
    add(
        "--expected",
        metavar="FILE",
        type=InputPath,
        help="known failures, as --write-expected writes them: the run fails only by others, and names fixed ones",
    )
    help_ = "write the failures of this run as a file for --expected"
    add("--write-expected", metavar="FILE", type=OutputFile, help=help_)
    add_skip_unsupported(parser, "scenes")
    help_ = "fail where fewer scenes are judged and not declined; default 1 with --skip-unsupported"
    add("--min-scenes", metavar="N", type=positive_int, default=0, help=help_)
    add("--maxfail", metavar="N", type=positive_int, help="stop after so many scenes that fail")
    add("--shard", metavar="I/N", type=shard, help="judge part I of N of the scenes, balanced by pixels")
    help_ = "also test our caster beyond the judged films: other routes, scales, brute force; compiles more kernels"
    add("--thorough", action="store_true", help=help_)
    add_timeout(parser)
    help_ = "judge every scene and ask Mitsuba, also where an earlier run has the result of the very same inputs"
    add("--no-store", dest="store", action="store_false", help=help_)
    add_candidate(parser)
    add_reading(parser, "; with --candidate")


def shard(text: str) -> Shard:
    """The type of --shard; its module is loaded only where the option is given."""
    from mitsuba_ref.runner.shards import parse_shard

    return parse_shard(text)


def add_merge_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "verdicts",
        metavar="VERDICT.json|DIR",
        type=InputPath,
        nargs="+",
        help="of each shard: --json's file, or --out's folder",
    )
    add_verdict_files(parser)


def add_judge_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    help_ = "the scene that the rays were cast into: a scene file, or a mesh file (OBJ, PLY, STL, OFF, glTF)"
    add("--scene", metavar="SCENE", type=InputPath, required=True, help=help_)
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
    add_report_files(parser)


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


def add_rays_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add = parser.add_argument
    add("-o", "--output", metavar="RAYS", type=OutputFile, required=True, help=".npz, or .npy for the rows alone")
    help_ = "camera (default); aimed at features (corners, edges, rims), along silhouettes, from surfaces, at random; "
    help_ += "shadow: from the camera's hits to a light"
    add("--kind", choices=RAY_KINDS, default="camera", help=help_)
    add("--count", metavar="N", type=positive_int, default=4096, help="of rays that are aimed; default 4096")
    add("--seed", metavar="S", type=int, default=0, help="of random numbers; default 0")
    add("--light", metavar="I", type=int, default=0, help="number of the light of shadow rays; default 0")


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr", type=InputPath)
    add("reference", metavar="REF.exr", type=InputPath)
    add("-o", "--output", metavar="DIFF.exr", type=OutputFile, help="write the differences, and a class for each pixel")
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", type=float, metavar="TOL", help=f"tolerance {what}")
    add("--max-pixels", type=int, default=0, metavar="N", help="number of pixels that may differ (never by NaN or inf)")
    ignore = "leave a channel or group of them out"
    add("--ignore", type=str, action="append", default=[], metavar="CHANNEL", help=ignore)
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--json", action="store_true", help="as JSON")
    add = add_reading(parser)
    add("--scene", metavar="SCENE", type=InputPath, help="the scene whose camera rendered the images")


def add_approve_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, OutputFolder)
    add_timeout(parser)
    parser.add_argument("--yes", action="store_true", help="write the images; without it, changes are only shown")


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, InputPath)
    parser.add_argument("--json", action="store_true", help="as JSON")


def add_references(parser: argparse.ArgumentParser, folder: type[str]) -> None:
    """Add the options of both: scenes, and the folder of approved images."""
    add_selection(parser)
    references = "the folder of approved images, NAME.exr for each scene"
    parser.add_argument("--references", metavar="DIR", type=folder, required=True, help=references)


def add_render_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add = parser.add_argument
    add("-o", "--output", metavar="REF.exr", type=OutputFile, required=True)
    add(
        "--aov",
        type=str,
        metavar="A,B,...",
        default=DEFAULT_AOV_LIST,
        help=f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}",
    )
    add_timeout(parser)


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", type=InputPath, help="Mitsuba's .xml, or .txt of MIT 6.837")
    add("-o", "--output", metavar="SCENE.toml", type=OutputFile, required=True, help="the scene file to write")
    add("-D", type=str, dest="parameters", action="append", default=[], metavar="NAME=VALUE", help="a $NAME of the XML")
    add("--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the file's own")
    add_mesh_dirs(parser)


def add_export_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        type=OutputFolder,
        required=True,
        help="folder to write into, created if missing",
    )


def add_probe_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add_pixel(parser)
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument(
        "--save", metavar="FILE", type=OutputFile, help="write this ray and what it may hit as a scene of its own"
    )
    add_timeout(parser)
    add_candidate(parser, "another ray caster, whose answer is explained as well (docs/candidates.md)")
    add_reading(parser, "; with --candidate")
