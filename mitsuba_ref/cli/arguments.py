"""The arguments of all commands but init, schema and doctor; their work is in the modules beside this one."""

from __future__ import annotations

import argparse
import os
import re
from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from typing import Any, Self

from caster.cli.shared_arguments import (
    AOV_NAMES,
    DEFAULT_AOV_LIST,
    METAVARS,
    InputPath,
    OutputFile,
    OutputFolder,
    add_mesh_dirs,
    add_pixel,
    add_scene,
    adder,
    engine,
    positive_int,
)
from mitsuba_ref.reference.interpreter import AS_IN_FILE_VARIABLE, PYTHON_VARIABLE, VARIANT_VARIABLE
from mitsuba_ref.report import builtin_scenes

RAY_KINDS = ("camera", "features", "silhouettes", "surface", "random")
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
MAX_SECONDS = 500_000.0  # of a time; the system's waits take milliseconds in 31 bits, and some are four times as long
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
    """Parse a time > 0 and <= MAX_SECONDS. Raises argparse.ArgumentTypeError."""
    match = re.fullmatch(r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([smh]?)", text)
    value = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0.0 < value <= MAX_SECONDS:
        most = f"{MAX_SECONDS:,.0f} s"
        raise argparse.ArgumentTypeError(f"expected a time such as 60s, 5m or 1h, at most {most}, got '{text}'")
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

METAVARS.update({whole: "N", seconds: "TIME"})


def add_selection(parser: ArgumentParser) -> None:
    """Add scenes, -k, --size and --mesh-dir."""
    group = parser.add_argument_group("scenes")
    add = adder(group)
    add(
        "scenes",
        ScenePath,
        "scene files, mesh files (OBJ, PLY, STL, OFF, glTF), Mitsuba's own .xml, folders of scenes, builtin:NAME; "
        "default: the folder scenes",
        metavar="SCENE|MESH|DIR",
        nargs="*",
        default=DEFAULT_SCENES,
    )
    add(
        "--builtin",
        str,
        f"scenes that are installed with the program: {', '.join(builtin_scenes.SETS)}; without a word, all",
        metavar="SET",
        nargs="?",
        const="all",
        choices=(*builtin_scenes.SETS, builtin_scenes.ALL_SETS),
    )
    add("-k", str, "scenes whose name fits, such as 'mesh and not teapot'", metavar="EXPRESSION", dest="expression")
    add("--size", int, "film in pixels, instead of the scenes' own", nargs=2, metavar=("W", "H"))
    add_mesh_dirs(group)


def add_opening(parser: argparse._ActionsContainer) -> None:
    """Add -D and --sensor, of Mitsuba files."""
    add = adder(parser)
    add("-D --define", str, "a $NAME of a Mitsuba file", action="append", default=[], metavar="NAME=VALUE")
    add("--sensor", whole, "the sensor of a Mitsuba file, counted from 0; default 0")


def add_timeout(parser: ArgumentParser) -> None:
    """Add --timeout."""
    adder(parser)(
        "--timeout",
        seconds,
        f"time that Mitsuba may take for one scene, or one band of a large film; default {REFERENCE_SECONDS:g}s",
        default=REFERENCE_SECONDS,
    )


def add_bounces(add: Callable[..., argparse.Action], about: str) -> None:
    """Add --bounces."""
    add("--bounces", whole, f"{about} (materials mirror and glass; mitsuba-ref docs scene-format)", default=0)


class SetVariable(argparse.Action):
    """Stores an option, and sets an environment variable, for this process and its children."""

    def __init__(self, option_strings: Sequence[str], dest: str, variable: str, **more: Any) -> None:
        super().__init__(option_strings, dest, **more)
        self.variable = variable

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        setattr(namespace, self.dest, values or True)
        os.environ[self.variable] = values or "1"


REFERENCE_OPTIONS = ("mitsuba", "variant", "as_in_file")  # of add_reference


def add_reference(parser: ArgumentParser, *, several: bool = False) -> None:
    """Add --mitsuba, --variant, --as-in-file. several: --mitsuba any number of times."""
    add = adder(parser.add_argument_group("the reference (mitsuba-ref docs versions)"))
    if several:
        help_ = "a Python interpreter with Mitsuba 3.6 or later, twice; once: beside the installed Mitsuba"
        add("--mitsuba", str, help_, action="append", dest="interpreters", metavar="PYTHON", required=True)
    else:
        help_ = f"a Python interpreter whose Mitsuba, 3.6 or later, is the reference; default: ${PYTHON_VARIABLE}"
        add("--mitsuba", str, help_, action=SetVariable, variable=PYTHON_VARIABLE, metavar="PYTHON")
    help_ = f"Mitsuba's variant, such as llvm_ad_rgb or cuda_ad_rgb; default: ${VARIANT_VARIABLE}, or by the shapes"
    add("--variant", str, help_, action=SetVariable, variable=VARIANT_VARIABLE, metavar="VARIANT")
    help_ = "Embree's robust mode only where the scene's own file requests it; else meshes are always closed"
    add("--as-in-file", str, help_, action=SetVariable, variable=AS_IN_FILE_VARIABLE, nargs=0)


def add_reading(parser: ArgumentParser, more: str = "") -> Callable[..., argparse.Action]:
    """Add --map, --depth and --miss; the function that adds more options to their group."""
    add = adder(parser.add_argument_group("files of other programs (mitsuba-ref docs candidates)" + more))
    map_help = "a channel or group by its name there, such as depth=range or normal=facing; any number of them"
    add("--map", str, map_help, action="append", default=[], metavar="OURS=THEIRS")
    depths = ("distance", "z", "near")
    depth_help = "what depth is: along the ray (default), along z, or along the ray from the near plane"
    add("--depth", str, depth_help, choices=depths)
    miss_help = "the depth of a miss, such as 0, 1e10 or FLT_MAX; default: a miss has alpha 0, no id, or depth inf"
    add("--miss", str, miss_help, metavar="VALUE")
    return add


def add_report_files(parser: ArgumentParser) -> None:
    """Add --out, --html, and the options of add_verdict_files."""
    add = add_verdict_files(parser)
    add("--out", OutputFolder, "write verdict.json, EXR files and reproducers into this folder")
    add_html(add)


def add_html(add: Callable[..., argparse.Action]) -> None:
    add("--html", OutputFolder, "write a report for the browser into this folder: index.html")


def add_verdict_files(parser: ArgumentParser) -> Callable[..., argparse.Action]:
    """Add --json, --junit and --summary-md; the function that adds more options to their group."""
    group = parser.add_argument_group("results")
    add = adder(group)
    add_json(group)
    add("--junit", OutputFile, "write the verdict as JUnit XML")
    help_ = "append a summary in Markdown to this file, such as $GITHUB_STEP_SUMMARY"
    add("--summary-md", OutputFile, help_)
    return add


def add_candidate(
    parser: ArgumentParser, title: str = "another ray caster, judged in place of ours (mitsuba-ref docs candidates)"
) -> Callable[..., argparse.Action]:
    """Add --candidate, its precision and its time limit; the function that adds what cannot be given beside it."""
    group = parser.add_argument_group(title)
    add, add_one = adder(group), adder(group.add_mutually_exclusive_group())
    add_one(
        "--candidate",
        str,
        "package.module:function, called as function(scene, o, d) -> (t, n); or a command that reads our scene "
        "and writes an EXR file, such as 'my-renderer {xml} -o {exr}' ({toml}, {width}, {height}); or an image of the "
        "scene's camera, FILE.exr; or a command that reads rays and writes hits, such as 'my-caster {mesh} {rays} "
        "{hits}' (mitsuba-ref docs candidates)",
        metavar="CANDIDATE",
    )
    add_one(
        "--candidate-serve",
        ServedProgram,
        "a program that is started once and answers over stdin and stdout (mitsuba-ref docs candidates)",
        dest="candidate",
        metavar="COMMAND",
    )
    add(
        "--candidate-precision",
        str,
        "its arithmetic, from which its bounds follow: float32 or float64; default: the type of what it returns",
        metavar="PRECISION",
        choices=PRECISIONS,
    )
    add("--candidate-timeout", seconds, f"time that a command may take for one scene; default {CANDIDATE_SECONDS:g}s")
    add("--no-limits", bool, "the program's interface has no t_min and t_max: a hit beyond t_max counts as a miss")
    return add_one


def add_skip_unsupported(add: Callable[..., argparse.Action], plural: str) -> None:
    """Add --skip-unsupported. plural: "scenes" or "families"."""
    add(
        "--skip-unsupported",
        bool,
        f"do not fail by {plural} that the candidate declines (NotImplementedError, exit code 77); they are counted",
    )


def add_item_selection(parser: ArgumentParser, what: str, words: str) -> None:
    """Add the items by name, and --list. what: "family" or "scene"."""
    plural = {"family": "families", "scene": "scenes"}[what]
    add = adder(parser)
    add(plural, str, words, metavar=what.upper(), nargs="*")
    add("--list", bool, f"list the {plural} and stop")


def add_json(parser: argparse._ActionsContainer) -> None:
    adder(parser)("--json", OutputFile, "write the result as JSON; - is standard output, which then holds nothing else")


# ---- commands ----


def add_validate_arguments(parser: ArgumentParser) -> None:
    add_selection(parser)
    add_opening(parser)
    add = adder(parser)
    add_workers(add, "scenes")
    add("--shard", shard, "judge part I of N of the scenes", metavar="I/N")
    add_engine(add)
    help_ = "also test our caster beyond the judged films: other routes, scales, brute force; compiles more kernels"
    add("--thorough", bool, help_)
    add_bounces(add, "also judge reflected, refracted and shadow rays, to this depth")
    add_timeout(parser)
    help_ = "judge every scene and ask Mitsuba, also where an earlier run has the result of the very same inputs"
    add("--no-store", bool, help_, dest="store", action="store_false")
    add_report_files(parser)
    add_reference(parser)
    add = adder(parser.add_argument_group("pass or fail"))
    help_ = "known failures, as --write-expected writes them: the run fails only by others, and names fixed ones"
    add("--expected", InputPath, help_, metavar="FILE")
    help_ = "write the failures of this run as a file for --expected"
    add("--write-expected", OutputFile, help_)
    add_skip_unsupported(add, "scenes")
    help_ = "fail a Mitsuba file of which not every shape is judged"
    add("--strict", bool, help_)
    help_ = "fail where fewer scenes are judged and not declined; default 1 with --skip-unsupported"
    add("--min-scenes", positive_int, help_, default=0)
    add("--maxfail", positive_int, "stop after so many scenes that fail")
    add_candidate(parser)
    add_reading(parser, "; with --candidate")


def add_workers(add: Callable[..., argparse.Action], what: str) -> None:
    """Add -j."""
    add("-j", positive_int, f"{what} at a time; default: one a core", dest="workers")


def add_engine(add: Callable[..., argparse.Action]) -> None:
    """Add --engine."""
    help_ = (
        "what runs the work: local, the processes of this machine; dask, a Dask cluster started here; or dask:ADDRESS"
    )
    add("--engine", engine, help_, metavar="ENGINE", default="local")


def shard(text: str) -> tuple[int, int]:
    """Parse I/N, part I of N. Raises argparse.ArgumentTypeError."""
    part, slash, parts = text.partition("/")
    if slash and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts):
        return int(part), int(parts)
    raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, such as 2/4, got '{text}'")


def add_versions_arguments(parser: ArgumentParser) -> None:
    add_selection(parser)
    add_reference(parser, several=True)
    add_timeout(parser)
    add_json(parser)


def add_merge_arguments(parser: ArgumentParser) -> None:
    adder(parser)(
        "verdicts", InputPath, "of each shard: --json's file, or --out's folder", metavar="VERDICT.json|DIR", nargs="+"
    )
    add_verdict_files(parser)


def add_judge_arguments(parser: ArgumentParser) -> None:
    add = adder(parser)
    help_ = "the scene that the rays were cast into: a scene file, or a mesh file (OBJ, PLY, STL, OFF, glTF)"
    add("--scene", InputPath, help_, metavar="SCENE", required=True)
    help_ = ".npz of t, and n, shape_id, prim_id, any_hit if given"
    add("--hits", InputPath, help_, metavar="FILE")
    help_ = ".npz of `rays`, (n, 8): o, d, t_min, t_max (mitsuba-ref docs candidates)"
    add("--rays", InputPath, help_, metavar="FILE", required=True)
    help_ = "judge where these rays start, in place of hits: .npz of `rays` and of `parent`, the rows of --rays after "
    help_ += "whose hits they go on"
    add("--spawned", InputPath, help_, metavar="FILE")
    help_ = "the arithmetic of the answers, from which bounds follow: float32 or float64; default: the type of t and n"
    add("--precision", str, help_, metavar="PRECISION", choices=PRECISIONS)
    add("--row", whole, "judge this ray alone")
    add_mesh_dirs(parser)
    add_reference(parser)
    add_report_files(parser)


def file_or_folder(text: str) -> str:
    """The type of an output that is a file, or a folder of them."""
    return OutputFolder(text) if os.path.isdir(text) else OutputFile(text)


def add_rays_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add = adder(parser)
    add("-o --output", file_or_folder, ".npz; with --bounces a folder", metavar="RAYS", required=True)
    help_ = "camera (default), or aimed: features (corners, edges, rims), silhouettes, surface (from surfaces), random"
    add("--kind", str, help_, metavar="KIND", choices=RAY_KINDS)
    add("--count", positive_int, "of rays that are aimed; default 4096")
    add("--seed", int, "of the random numbers of aimed rays; default 0", metavar="SEED")
    add_bounces(add, "the camera's rays, and the secondary ones of each bounce to this depth, a file each")


def add_compare_arguments(parser: ArgumentParser) -> None:
    add = adder(parser)
    add("ours", InputPath, "an image, or a folder of images", metavar="OURS.exr|DIR")
    add("reference", InputPath, "another one, or a folder of images of the same names", metavar="REF.exr|DIR")
    ignore = "leave a channel or group of them out"
    add("--ignore", str, ignore, action="append", default=[], metavar="CHANNEL")
    add("--other-scene", bool, "compare images of different scenes, too")
    add = adder(parser.add_argument_group("results"))
    add_html(add)
    add("--json", bool, "print the comparison as JSON")
    add = adder(parser.add_argument_group("tolerances"))
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", float, f"tolerance {what}", metavar="TOL")
    add("--max-pixels", int, "number of pixels that may differ (never by NaN or inf)", default=0, metavar="N")
    add = add_reading(parser)
    add("--scene", InputPath, "the scene whose camera rendered the images", metavar="SCENE")


def add_render_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add_opening(parser)
    add = adder(parser)
    add("-o --output", OutputFile, metavar="REF.exr", required=True)
    add("--aov", str, f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}", metavar="AOV,...", default=DEFAULT_AOV_LIST)
    add_reference(parser)
    add_timeout(parser)


def add_import_arguments(parser: ArgumentParser) -> None:
    add = adder(parser)
    add("file", InputPath, "Mitsuba's .xml, or .txt of MIT 6.837", metavar="FILE")
    add("-o --output", OutputFile, "the scene file to write", metavar="SCENE.toml", required=True)
    add_opening(parser)
    add("--size", int, "film in pixels, instead of the file's own", nargs=2, metavar=("W", "H"))
    add_mesh_dirs(parser)


def add_export_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add_opening(parser)
    add = adder(parser)
    add("-o --output", OutputFolder, "folder to write into, created if missing", required=True)
    add("--toml", bool, "write scene.toml as well: our format, with the float32 values that are traced")


def add_probe_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ScenePath)
    add_opening(parser)
    add_pixel(parser)
    add = adder(parser)
    add("--brief", bool, "the verdict and who is right, without the numbers")
    add("--json", bool, "as JSON")
    add("--save", OutputFile, "write this ray and what it may hit as a scene of its own")
    add_bounces(add, "follow the pixel's path of reflected, refracted and shadow rays, to this depth")
    add_reference(parser)
    add_timeout(parser)
    add_candidate(parser, "another ray caster, explained as well (mitsuba-ref docs candidates)")
    add_reading(parser, "; with --candidate")


def add_fuzz_arguments(parser: ArgumentParser) -> None:
    add = adder(parser)
    add("--time", seconds, "stop after this time, such as 60s, 5m, 1h; default: 60s")
    add("--examples", numbers, "number of examples, or those from A to B", metavar="N|A..B")
    add("--seed", whole, "example i of seed S is always the same; default: 0", metavar="SEED", default=0)
    help_ = "only this family of scenes; may be given several times"
    add("--family", str, help_, metavar="NAME", action="append", default=[])
    help_ = "where failing scenes are kept; default: fuzz-failures"
    add("--out", OutputFolder, help_, default="fuzz-failures")
    help_ = "findings of one kind in one family that are shrunk and kept; all are counted; default: 3"
    add("--keep", whole, help_, default=3)
    add_json(parser)
    help_ = "one scene in N, on average, gets --thorough checks and is compared with Mitsuba; 0: none; default: 16"
    add("--judge-every", whole, help_, default=16)
    add("--replay", InputPath, "check kept scenes again, and nothing else", metavar="FILE|DIR")
    add("--rays", positive_int, "rays aimed at each scene; default: 40", default=40)
    add_workers(add, "examples")
    add_engine(add)
    add_candidate(parser)


def add_campaign_arguments(parser: ArgumentParser) -> None:
    add = adder(parser)
    help_ = "a campaign file (mitsuba-ref docs campaign), which is run or continued; or a history, which is reported"
    add("file", InputPath, help_, metavar="CAMPAIGN.toml|HISTORY.sqlite")
    help_ = "where results are kept; default: NAME.history.sqlite beside the campaign file"
    add("--history", OutputFile, help_)
    add("--unit", str, "run this unit alone, in this process, and keep nothing", metavar="NAME")
    add("--strict", bool, "fail by every failure, not only by those that are new since the last run")
    add_workers(add, "units")
    add_engine(add)
    add_json(parser)
    add("--html", OutputFile, "write the report as a page")
    add_reference(parser)


def add_stress_arguments(parser: ArgumentParser) -> None:
    add_item_selection(parser, "family", "such as tangency, or watertight for both; default: all")
    add = adder(parser)
    add("--rays", positive_int, "rays of each setting; default: 400, watertight 10000")
    add("--seed", whole, "of the rays; default: 0", metavar="SEED", default=0)
    add_workers(add, "families")
    add_engine(add)
    help_ = "where the first wrong ray of each setting is kept, as a scene; default: stress-failures"
    add("--out", OutputFolder, help_, default="stress-failures")
    add_json(parser)
    add_one = add_candidate(parser, "another ray caster, which takes rays (mitsuba-ref docs candidates)")
    help_ = "in place of ray casters, judge a rule of where rays start: of (points, normals, directions)"
    add_one("--spawn", str, help_, metavar="MODULE:FUNCTION")
    add_skip_unsupported(add, "families")


def add_bench_arguments(parser: ArgumentParser) -> None:
    add_item_selection(parser, "scene", "such as mesh-70k, or a scene or mesh file; default: all that --list names")
    add = adder(parser)
    add("--aov", str, "AOVs of images, such as depth,normal,diffuse; default: depth,normal", metavar="AOV,...")
    add("--size", positive_int, f"pixels a side; default: {DEFAULT_SIZE}", default=DEFAULT_SIZE)
    help_ = f"turns of each; default: {DEFAULT_ALTERNATIONS}"
    add("--alternations", positive_int, help_, default=DEFAULT_ALTERNATIONS)
    add_engine(add)
    add_json(parser)
    add_mesh_dirs(parser)
    title = "another ray caster, which takes rays (mitsuba-ref docs candidates)"
    add_candidate(parser, title)
