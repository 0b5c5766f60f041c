"""The arguments of all commands but init, schema and doctor; their work is in the modules beside this one."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

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
from mitsuba_ref.report import builtin_scenes

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
DEFAULT_SIZE, DEFAULT_ALTERNATIONS = 1024, 7  # of bench
# Copies, since the judge's modules load the kernels (tests/unit/test_cli_help.py compares them).
CANDIDATE_SECONDS = REFERENCE_SECONDS = 300.0
MAX_SECONDS = 100_000.0  # about a day; the system's waits take milliseconds in 31 bits, and some are multiples of it
DEFAULT_SCENES = [InputPath("scenes")]
PRECISIONS = ("float32", "float64")


# ---- types of values ----


def whole(text: str) -> int:
    """Parse a whole number >= 0. Raises argparse.ArgumentTypeError."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got '{text}'")
    return int(text)


UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}


def seconds(text: str) -> float:
    """Parse a time > 0. Raises argparse.ArgumentTypeError."""
    match = re.fullmatch(r"([\d.e+-]+)\s*([smh]?)", text)
    try:
        value = float(match[1]) * UNITS[match[2]] if match else 0.0
    except ValueError:
        value = 0.0
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a time such as 60s, 5m or 1h, got '{text}'")
    return value


def deadline(text: str) -> float:
    """Parse a time > 0 and <= MAX_SECONDS. Raises argparse.ArgumentTypeError."""
    value = seconds(text)
    if value > MAX_SECONDS:
        raise argparse.ArgumentTypeError(f"expected at most {MAX_SECONDS:,.0f} s, got '{text}'")
    return value


class ScenePath(InputPath):
    """A scene argument: a path, or builtin:NAME, whose path it is. Raises SceneError for an unknown name."""

    def __new__(cls, text: str) -> Self:
        return super().__new__(cls, builtin_scenes.scene_path(text))


class ServedProgram(str):
    """The command of --candidate-serve."""


def numbers(text: str) -> range:
    """Parse numbers of examples: N for the first N, A..B for A to B. Raises argparse.ArgumentTypeError."""
    first, dots, last = text.partition("..")
    if not first.isdecimal() or (dots and not last.isdecimal()) or (dots and int(first) > int(last)):
        raise argparse.ArgumentTypeError(f"expected how many, such as 100, or from..to, such as 41..41, got '{text}'")
    return range(int(first), int(last) + 1) if dots else range(int(first))


# ---- options of several commands ----


def add_selection(parser: argparse.ArgumentParser) -> None:
    """Add scenes, -k, --size and --mesh-dir, and -j."""
    group = parser.add_argument_group("scenes")
    add = group.add_argument
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
        choices=(*builtin_scenes.SETS, builtin_scenes.ALL_SETS),
        help=f"scenes that are installed with the program: {', '.join(builtin_scenes.SETS)}; without a word, all",
    )
    add(
        "-k",
        type=str,
        metavar="EXPRESSION",
        dest="expression",
        help="scenes whose name fits, such as 'mesh and not teapot'; type:mesh is true of those with such a shape or "
        "camera, type:triangles of those with any made of triangles",
    )
    add("--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scenes' own")
    add_mesh_dirs(group)
    help_ = "scenes at a time; default: one a core"
    parser.add_argument("-j", metavar="N", dest="workers", type=positive_int, help=help_)


def add_timeout(parser: argparse.ArgumentParser) -> None:
    """Add --timeout."""
    parser.add_argument(
        "--timeout",
        metavar="TIME",
        type=deadline,
        default=REFERENCE_SECONDS,
        help=f"time that Mitsuba may take for one scene, or one band of a large film; default {REFERENCE_SECONDS:g}s",
    )


def add_reading(parser: argparse.ArgumentParser, more: str = "") -> Callable[..., argparse.Action]:
    """Add --map, --depth and --miss; the function that adds more options to their group."""
    add = parser.add_argument_group("files of other programs (mitsuba-ref docs candidates)" + more).add_argument
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
    add = add_verdict_files(parser)
    add(
        "--out", metavar="DIR", type=OutputFolder, help="write verdict.json, EXR files and reproducers into this folder"
    )
    add_html(add)


def add_html(add: Callable[..., argparse.Action]) -> None:
    add("--html", metavar="DIR", type=OutputFolder, help="write a report for the browser into this folder: index.html")


def add_verdict_files(parser: argparse.ArgumentParser) -> Callable[..., argparse.Action]:
    """Add --json, --junit and --summary-md; the function that adds more options to their group."""
    add = parser.add_argument_group("results").add_argument
    add("--json", metavar="FILE", type=OutputFile, help="write the verdict as JSON")
    add("--junit", metavar="FILE", type=OutputFile, help="write the verdict as JUnit XML")
    help_ = "append a summary in Markdown to this file, such as $GITHUB_STEP_SUMMARY"
    add("--summary-md", metavar="FILE", type=OutputFile, help=help_)
    return add


def add_candidate(
    parser: argparse.ArgumentParser,
    title: str = "another ray caster, judged in place of ours (mitsuba-ref docs candidates)",
) -> None:
    """Add --candidate, its precision and its time limit."""
    group = parser.add_argument_group(title)
    one = group.add_mutually_exclusive_group()
    one.add_argument(
        "--candidate",
        "--candidate-rays",
        dest="candidate",
        type=str,
        metavar="CANDIDATE",
        help="package.module:function, called as function(scene, o, d) -> (t, n); or a command that reads our scene "
        "and writes an EXR file, such as 'my-renderer {xml} -o {exr}' ({toml}, {width}, {height}); or an image of the "
        "scene's camera, FILE.exr; or a command that reads rays and writes hits, such as 'my-caster {mesh} {rays} "
        "{hits}' (mitsuba-ref docs candidates)",
    )
    one.add_argument(
        "--candidate-serve",
        dest="candidate",
        type=ServedProgram,
        metavar="COMMAND",
        help="a program that is started once and answers over stdin and stdout (mitsuba-ref docs candidates)",
    )
    group.add_argument(
        "--candidate-precision",
        metavar="PRECISION",
        choices=PRECISIONS,
        help="its arithmetic, from which its bounds follow: float32 or float64; default: the type of what it returns",
    )
    group.add_argument(
        "--candidate-timeout",
        metavar="TIME",
        type=deadline,
        help=f"time that a command may take for one scene; default {CANDIDATE_SECONDS:g}s",
    )
    group.add_argument(
        "--no-limits",
        action="store_const",
        const=True,
        help="the program's interface has no t_min and t_max: a hit beyond t_max counts as a miss",
    )


def add_skip_unsupported(add: Callable[..., argparse.Action], plural: str) -> None:
    """Add --skip-unsupported. plural: "scenes" or "families"."""
    add(
        "--skip-unsupported",
        action="store_true",
        help=f"do not fail by {plural} that the candidate declines (NotImplementedError, exit code 77); "
        "they are counted",
    )


def add_item_selection(parser: argparse.ArgumentParser, what: str, words: str) -> None:
    """Add the items by name, -k and --list. what: "family" or "scene"."""
    plural = {"family": "families", "scene": "scenes"}[what]
    add = parser.add_argument
    add(plural, metavar=what.upper(), type=str, nargs="*", help=words)
    example = "'scale and not mesh'" if what == "family" else "'mesh and not lit'"
    add("-k", type=str, metavar="EXPRESSION", dest="expression", help=f"{plural} whose name matches, such as {example}")
    add("--list", action="store_true", help=f"list the {plural} and stop")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json",
        type=OutputFile,
        metavar="FILE",
        help="write the result as JSON; - is standard output, which then holds nothing else",
    )


# ---- commands ----


def add_validate_arguments(parser: argparse.ArgumentParser) -> None:
    add_selection(parser)
    add = parser.add_argument
    add("--shard", metavar="I/N", type=shard, help="judge part I of N of the scenes, balanced by pixels")
    help_ = "also test our caster beyond the judged films: other routes, scales, brute force; compiles more kernels"
    add("--thorough", action="store_true", help=help_)
    add_timeout(parser)
    help_ = "judge every scene and ask Mitsuba, also where an earlier run has the result of the very same inputs"
    add("--no-store", dest="store", action="store_false", help=help_)
    add_report_files(parser)
    add = parser.add_argument_group("pass or fail").add_argument
    help_ = "known failures, as --write-expected writes them: the run fails only by others, and names fixed ones"
    add("--expected", metavar="FILE", type=InputPath, help=help_)
    help_ = "write the failures of this run as a file for --expected"
    add("--write-expected", metavar="FILE", type=OutputFile, help=help_)
    add_skip_unsupported(add, "scenes")
    help_ = "fail where fewer scenes are judged and not declined; default 1 with --skip-unsupported"
    add("--min-scenes", metavar="N", type=positive_int, default=0, help=help_)
    add("--maxfail", metavar="N", type=positive_int, help="stop after so many scenes that fail")
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
    help_ = ".npz of t, and n, shape_id, prim_id, any_hit if given; or .npy of shape (n, 1), (n, 4), (n, 5)"
    add("--hits", metavar="FILE", type=InputPath, required=True, help=help_)
    help_ = ".npz of `rays`, or .npy, (n, 8): o, d, t_min, t_max (mitsuba-ref docs candidates)"
    add("--rays", metavar="FILE", type=InputPath, required=True, help=help_)
    help_ = "the arithmetic of the answers, from which bounds follow: float32 or float64; default: the type of t and n"
    add("--precision", metavar="PRECISION", choices=PRECISIONS, help=help_)
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
    help_ = "camera (default), shadow (from the camera's hits to a light), or aimed: features (corners, edges, rims), "
    help_ += "silhouettes, surface (from surfaces), random"
    add("--kind", metavar="KIND", choices=RAY_KINDS, default="camera", help=help_)
    add("--count", metavar="N", type=positive_int, default=4096, help="of rays that are aimed; default 4096")
    add("--seed", metavar="SEED", type=int, default=0, help="of random numbers; default 0")
    add("--light", metavar="N", type=int, default=0, help="number of the light of shadow rays; default 0")


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr", type=InputPath)
    add("reference", metavar="REF.exr", type=InputPath)
    ignore = "leave a channel or group of them out"
    add("--ignore", type=str, action="append", default=[], metavar="CHANNEL", help=ignore)
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add = parser.add_argument_group("results").add_argument
    add("-o", "--output", metavar="DIFF.exr", type=OutputFile, help="write the differences, and a class for each pixel")
    add_html(add)
    add("--json", action="store_true", help="print the comparison as JSON")
    add = parser.add_argument_group("tolerances").add_argument
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", type=float, metavar="TOL", help=f"tolerance {what}")
    add("--max-pixels", type=int, default=0, metavar="N", help="number of pixels that may differ (never by NaN or inf)")
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
        metavar="AOV,...",
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
    parser.add_argument(
        "--toml",
        action="store_true",
        help="write scene.toml as well: our format, with the float32 values that are traced",
    )


def add_probe_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add_pixel(parser)
    parser.add_argument("--brief", action="store_true", help="the verdict and who is right, without the numbers")
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument(
        "--save", metavar="FILE", type=OutputFile, help="write this ray and what it may hit as a scene of its own"
    )
    add_timeout(parser)
    add_candidate(parser, "another ray caster, explained as well (mitsuba-ref docs candidates)")
    add_reading(parser, "; with --candidate")


def add_fuzz_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--time", metavar="TIME", type=seconds, help="stop after this time, such as 60s, 5m, 1h; default: 60s")
    add("--examples", metavar="N|A..B", type=numbers, help="number of examples, or those from A to B")
    add("--seed", metavar="SEED", type=whole, default=0, help="example i of seed S is always the same; default: 0")
    help_ = "only this family of scenes; may be given several times"
    add("--family", type=str, metavar="NAME", action="append", default=[], help=help_)
    help_ = "where failing scenes are kept; default: fuzz-failures"
    add("--out", type=OutputFolder, metavar="DIR", default="fuzz-failures", help=help_)
    help_ = "findings of one kind in one family that are shrunk and kept; all are counted; default: 3"
    add("--keep", metavar="N", type=whole, default=3, help=help_)
    add_json(parser)
    help_ = "one scene in N, on average, gets --thorough checks and is compared with Mitsuba; 0: none; default: 16"
    add("--judge-every", metavar="N", type=whole, default=16, help=help_)
    add("--replay", metavar="FILE|DIR", type=InputPath, help="check kept scenes again, and nothing else")
    add("--rays", metavar="N", type=positive_int, default=40, help="rays aimed at each scene; default: 40")
    add_candidate(parser, "another ray caster, judged in place of ours (mitsuba-ref docs candidates)")


def add_stress_arguments(parser: argparse.ArgumentParser) -> None:
    add_item_selection(parser, "family", "such as tangency, or watertight for both; default: all")
    add = parser.add_argument
    add("--rays", metavar="N", type=positive_int, help="rays of each setting; default: 400, watertight 10000")
    add("--seed", metavar="SEED", type=whole, default=0, help="of the rays; default: 0")
    help_ = "where the first wrong ray of each setting is kept, as a scene; default: stress-failures"
    add("--out", type=OutputFolder, metavar="DIR", default="stress-failures", help=help_)
    add_json(parser)
    add_candidate(parser, "another ray caster, which takes rays (mitsuba-ref docs candidates)")
    add_skip_unsupported(add, "families")


def add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    add_item_selection(parser, "scene", "such as mesh-70k, or a scene or mesh file; default: all that --list names")
    add = parser.add_argument
    help_ = "AOVs of images, such as depth,normal,diffuse; again: another set. Default: depth,normal"
    add("--aov", metavar="AOV,...", type=str, action="append", help=help_)
    add("--size", metavar="N", type=positive_int, default=DEFAULT_SIZE, help=f"pixels a side; default: {DEFAULT_SIZE}")
    help_ = f"turns of each; default: {DEFAULT_ALTERNATIONS}"
    add("--alternations", metavar="N", type=positive_int, default=DEFAULT_ALTERNATIONS, help=help_)
    add("--threads", metavar="N", type=positive_int, help="processors that each may use; default: all")
    help_ = "of the rays that errors are measured on; default: 0"
    add("--seed", metavar="SEED", type=whole, default=0, help=help_)
    add_json(parser)
    add_mesh_dirs(parser)
    title = "another ray caster, which takes rays (mitsuba-ref docs candidates)"
    add_candidate(parser, title)
