"""The arguments of all commands but init, schema and doctor; their work is in the modules beside this one."""

import os
import re
from argparse import Action, ArgumentTypeError, Namespace
from collections.abc import Sequence
from typing import Any, Self

from caster.cli.shared_arguments import (
    AOV_NAMES,
    DEFAULT_AOV_LIST,
    METAVARS,
    Adder,
    InputPath,
    OutputFile,
    OutputFolder,
    add_mesh_dirs,
    add_pixel,
    add_scene,
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
        raise ArgumentTypeError(f"expected a whole number >= 0, got '{text}'")
    return int(text)


UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}


def seconds(text: str) -> float:
    """Parse a time > 0 and <= MAX_SECONDS. Raises argparse.ArgumentTypeError."""
    match = re.fullmatch(r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([smh]?)", text)
    value = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0.0 < value <= MAX_SECONDS:
        raise ArgumentTypeError(f"expected a time such as 60s, 5m or 1h, at most {MAX_SECONDS:,.0f} s, got '{text}'")
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
        raise ArgumentTypeError(f"expected how many, such as 100, or from..to, such as 41..41, got '{text}'")
    return range(int(first), int(last) + 1) if dots else range(int(first))


# ---- options of several commands ----

METAVARS.update({whole: "N", seconds: "TIME"})


def add_selection(add: Adder) -> None:
    """Add scenes, -k, --size and --mesh-dir."""
    add = add.group("scenes")
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
    add_mesh_dirs(add)


def add_opening(add: Adder) -> None:
    """Add -D and --sensor, of Mitsuba files."""
    add("-D --define", str, "a $NAME of a Mitsuba file", action="append", default=[], metavar="NAME=VALUE")
    add("--sensor", whole, "the sensor of a Mitsuba file, counted from 0; default 0")


def add_timeout(add: Adder) -> None:
    """Add --timeout."""
    add(
        "--timeout",
        seconds,
        f"time that Mitsuba may take for one scene, or one band of a large film; default {REFERENCE_SECONDS:g}s",
        default=REFERENCE_SECONDS,
    )


def add_bounces(add: Adder, about: str) -> None:
    """Add --bounces."""
    add("--bounces", whole, f"{about} (materials mirror and glass; mitsuba-ref docs scene-format)", default=0)


class SetVariable(Action):
    """Stores an option, and sets an environment variable, for this process and its children."""

    def __init__(self, option_strings: Sequence[str], dest: str, variable: str, **more: Any) -> None:
        super().__init__(option_strings, dest, **more)
        self.variable = variable

    def __call__(self, parser: Any, namespace: Namespace, values: Any, option: str | None = None) -> None:
        setattr(namespace, self.dest, values or True)
        os.environ[self.variable] = values or "1"


REFERENCE_OPTIONS = ("mitsuba", "variant", "as_in_file")  # of add_reference


def add_reference(add: Adder, *, several: bool = False) -> None:
    """Add --mitsuba, --variant, --as-in-file. several: --mitsuba any number of times."""
    add = add.group("the reference (mitsuba-ref docs versions)")
    if several:
        add(
            "--mitsuba",
            str,
            "a Python interpreter with Mitsuba 3.6 or later, twice; once: beside the installed Mitsuba",
            action="append",
            dest="interpreters",
            metavar="PYTHON",
            required=True,
        )
    else:
        add(
            "--mitsuba",
            str,
            f"a Python interpreter whose Mitsuba, 3.6 or later, is the reference; default: ${PYTHON_VARIABLE}",
            action=SetVariable,
            variable=PYTHON_VARIABLE,
            metavar="PYTHON",
        )
    add(
        "--variant",
        str,
        f"Mitsuba's variant, such as llvm_ad_rgb or cuda_ad_rgb; default: ${VARIANT_VARIABLE}, or by the shapes",
        action=SetVariable,
        variable=VARIANT_VARIABLE,
        metavar="VARIANT",
    )
    add(
        "--as-in-file",
        str,
        "Embree's robust mode only where the scene's own file requests it; else meshes are always closed",
        action=SetVariable,
        variable=AS_IN_FILE_VARIABLE,
        nargs=0,
    )


def add_reading(add: Adder, more: str = "") -> Adder:
    """Add --map, --depth and --miss; the function that adds more options to their group."""
    add = add.group("files of other programs (mitsuba-ref docs candidates)" + more)
    add(
        "--map",
        str,
        "a channel or group by its name there, such as depth=range or normal=facing; any number of them",
        action="append",
        default=[],
        metavar="OURS=THEIRS",
    )
    add(
        "--depth",
        str,
        "what depth is: along the ray (default), along z, or along the ray from the near plane",
        choices=("distance", "z", "near"),
    )
    add(
        "--miss",
        str,
        "the depth of a miss, such as 0, 1e10 or FLT_MAX; default: a miss has alpha 0, no id, or depth inf",
        metavar="VALUE",
    )
    return add


def add_report_files(add: Adder) -> None:
    """Add --out, --html, and the options of add_verdict_files."""
    add = add_verdict_files(add)
    add("--out", OutputFolder, "write verdict.json, EXR files and reproducers into this folder")
    add_html(add)


def add_html(add: Adder) -> None:
    add("--html", OutputFolder, "write a report for the browser into this folder: index.html")


def add_verdict_files(add: Adder) -> Adder:
    """Add --json, --junit and --summary-md; the function that adds more options to their group."""
    add = add.group("results")
    add_json(add)
    add("--junit", OutputFile, "write the verdict as JUnit XML")
    add("--summary-md", OutputFile, "append a summary in Markdown to this file, such as $GITHUB_STEP_SUMMARY")
    return add


def add_candidate(
    add: Adder, title: str = "another ray caster, judged in place of ours (mitsuba-ref docs candidates)"
) -> Adder:
    """Add --candidate, its precision and its time limit; the function that adds what cannot be given beside it."""
    add = add.group(title)
    add_one = add.one_of_group()
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


def add_skip_unsupported(add: Adder, plural: str) -> None:
    """Add --skip-unsupported. plural: "scenes" or "families"."""
    add(
        "--skip-unsupported",
        bool,
        f"do not fail by {plural} that the candidate declines (NotImplementedError, exit code 77); they are counted",
    )


def add_item_selection(add: Adder, what: str, words: str) -> None:
    """Add the items by name, and --list. what: "family" or "scene"."""
    plural = {"family": "families", "scene": "scenes"}[what]
    add(plural, str, words, metavar=what.upper(), nargs="*")
    add("--list", bool, f"list the {plural} and stop")


def add_json(add: Adder) -> None:
    add("--json", OutputFile, "write the result as JSON; - is standard output, which then holds nothing else")


# ---- commands ----


def add_validate_arguments(add: Adder) -> None:
    add_selection(add)
    add_opening(add)
    add_workers(add, "scenes")
    add("--shard", shard, "judge part I of N of the scenes", metavar="I/N")
    add_engine(add)
    add(
        "--thorough",
        bool,
        "also test our caster beyond the judged films: other routes, scales, brute force; compiles more kernels",
    )
    add_bounces(add, "also judge reflected, refracted and shadow rays, to this depth")
    add_timeout(add)
    add(
        "--no-store",
        bool,
        "judge every scene and ask Mitsuba, also where an earlier run has the result of the very same inputs",
        dest="store",
        action="store_false",
    )
    add_report_files(add)
    add_reference(add)
    add_rule = add.group("pass or fail")
    add_rule(
        "--expected",
        InputPath,
        "known failures, as --write-expected writes them: the run fails only by others, and names fixed ones",
        metavar="FILE",
    )
    add_rule("--write-expected", OutputFile, "write the failures of this run as a file for --expected")
    add_skip_unsupported(add_rule, "scenes")
    add_rule("--strict", bool, "fail a Mitsuba file of which not every shape is judged")
    add_rule(
        "--min-scenes",
        positive_int,
        "fail where fewer scenes are judged and not declined; default 1 with --skip-unsupported",
        default=0,
    )
    add_rule("--maxfail", positive_int, "stop after so many scenes that fail")
    add_candidate(add)
    add_reading(add, "; with --candidate")


def add_workers(add: Adder, what: str) -> None:
    """Add -j."""
    add("-j", positive_int, f"{what} at a time; default: one a core", dest="workers")


def add_engine(add: Adder) -> None:
    """Add --engine."""
    add(
        "--engine",
        engine,
        "what runs the work: local, the processes of this machine; dask, a Dask cluster started here; or dask:ADDRESS",
        metavar="ENGINE",
        default="local",
    )


def shard(text: str) -> tuple[int, int]:
    """Parse I/N, part I of N. Raises argparse.ArgumentTypeError."""
    part, slash, parts = text.partition("/")
    if slash and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts):
        return int(part), int(parts)
    raise ArgumentTypeError(f"expected I/N with 1 <= I <= N, such as 2/4, got '{text}'")


def add_versions_arguments(add: Adder) -> None:
    add_selection(add)
    add_reference(add, several=True)
    add_timeout(add)
    add_json(add)


def add_merge_arguments(add: Adder) -> None:
    add("verdicts", InputPath, "of each shard: --json's file, or --out's folder", metavar="VERDICT.json|DIR", nargs="+")
    add_verdict_files(add)


def add_judge_arguments(add: Adder) -> None:
    add(
        "--scene",
        InputPath,
        "the scene that the rays were cast into: a scene file, or a mesh file (OBJ, PLY, STL, OFF, glTF)",
        metavar="SCENE",
        required=True,
    )
    add("--hits", InputPath, ".npz of t, and n, shape_id, prim_id, any_hit if given", metavar="FILE")
    add(
        "--rays",
        InputPath,
        ".npz of `rays`, (n, 8): o, d, t_min, t_max (mitsuba-ref docs candidates)",
        metavar="FILE",
        required=True,
    )
    add(
        "--spawned",
        InputPath,
        "judge where these rays start, in place of hits: .npz of `rays` and of `parent`, the rows of --rays after "
        "whose hits they go on",
        metavar="FILE",
    )
    add(
        "--precision",
        str,
        "the arithmetic of the answers, from which bounds follow: float32 or float64; default: the type of t and n",
        metavar="PRECISION",
        choices=PRECISIONS,
    )
    add("--row", whole, "judge this ray alone")
    add_mesh_dirs(add)
    add_reference(add)
    add_report_files(add)


def file_or_folder(text: str) -> str:
    """The type of an output that is a file, or a folder of them."""
    return OutputFolder(text) if os.path.isdir(text) else OutputFile(text)


def add_rays_arguments(add: Adder) -> None:
    add_scene(add, ScenePath)
    add("-o --output", file_or_folder, ".npz; with --bounces a folder", metavar="RAYS", required=True)
    add(
        "--kind",
        str,
        "camera (default), or aimed: features (corners, edges, rims), silhouettes, surface (from surfaces), random",
        metavar="KIND",
        choices=RAY_KINDS,
    )
    add("--count", positive_int, "of rays that are aimed; default 4096")
    add("--seed", int, "of the random numbers of aimed rays; default 0", metavar="SEED")
    add_bounces(add, "the camera's rays, and the secondary ones of each bounce to this depth, a file each")


def add_compare_arguments(add: Adder) -> None:
    add("ours", InputPath, "an image, or a folder of images", metavar="OURS.exr|DIR")
    add("reference", InputPath, "another one, or a folder of images of the same names", metavar="REF.exr|DIR")
    add("--ignore", str, "leave a channel or group of them out", action="append", default=[], metavar="CHANNEL")
    add("--other-scene", bool, "compare images of different scenes, too")
    add_result = add.group("results")
    add_html(add_result)
    add_result("--json", bool, "print the comparison as JSON")
    add_tolerance = add.group("tolerances")
    for name, what in NUMBERS.items():
        add_tolerance(f"--{name.replace('_', '-')}", float, f"tolerance {what}", metavar="TOL")
    add_tolerance("--max-pixels", int, "number of pixels that may differ (never by NaN or inf)", default=0, metavar="N")
    add_reading(add)("--scene", InputPath, "the scene whose camera rendered the images", metavar="SCENE")


def add_render_arguments(add: Adder) -> None:
    add_scene(add, ScenePath)
    add_opening(add)
    add("-o --output", OutputFile, metavar="REF.exr", required=True)
    add("--aov", str, f"of {AOV_NAMES}; default: {DEFAULT_AOV_LIST}", metavar="AOV,...", default=DEFAULT_AOV_LIST)
    add_reference(add)
    add_timeout(add)


def add_import_arguments(add: Adder) -> None:
    add("file", InputPath, "Mitsuba's .xml, or .txt of MIT 6.837", metavar="FILE")
    add("-o --output", OutputFile, "the scene file to write", metavar="SCENE.toml", required=True)
    add_opening(add)
    add("--size", int, "film in pixels, instead of the file's own", nargs=2, metavar=("W", "H"))
    add_mesh_dirs(add)


def add_export_arguments(add: Adder) -> None:
    add_scene(add, ScenePath)
    add_opening(add)
    add("-o --output", OutputFolder, "folder to write into, created if missing", required=True)
    add("--toml", bool, "write scene.toml as well: our format, with the float32 values that are traced")


def add_probe_arguments(add: Adder) -> None:
    add_scene(add, ScenePath)
    add_opening(add)
    add_pixel(add)
    add("--brief", bool, "the verdict and who is right, without the numbers")
    add("--json", bool, "as JSON")
    add("--save", OutputFile, "write this ray and what it may hit as a scene of its own")
    add_bounces(add, "follow the pixel's path of reflected, refracted and shadow rays, to this depth")
    add_reference(add)
    add_timeout(add)
    add_candidate(add, "another ray caster, explained as well (mitsuba-ref docs candidates)")
    add_reading(add, "; with --candidate")


def add_fuzz_arguments(add: Adder) -> None:
    add("--time", seconds, "stop after this time, such as 60s, 5m, 1h; default: 60s")
    add("--examples", numbers, "number of examples, or those from A to B", metavar="N|A..B")
    add("--seed", whole, "example i of seed S is always the same; default: 0", metavar="SEED", default=0)
    add(
        "--family",
        str,
        "only this family of scenes; may be given several times",
        metavar="NAME",
        action="append",
        default=[],
    )
    add("--out", OutputFolder, "where failing scenes are kept; default: fuzz-failures", default="fuzz-failures")
    add(
        "--keep",
        whole,
        "findings of one kind in one family that are shrunk and kept; all are counted; default: 3",
        default=3,
    )
    add_json(add)
    add(
        "--judge-every",
        whole,
        "one scene in N, on average, gets --thorough checks and is compared with Mitsuba; 0: none; default: 16",
        default=16,
    )
    add("--replay", InputPath, "check kept scenes again, and nothing else", metavar="FILE|DIR")
    add("--rays", positive_int, "rays aimed at each scene; default: 40", default=40)
    add_workers(add, "examples")
    add_engine(add)
    add_candidate(add)


def add_campaign_arguments(add: Adder) -> None:
    add(
        "file",
        InputPath,
        "a campaign file (mitsuba-ref docs campaign), which is run or continued; or a history, which is reported",
        metavar="CAMPAIGN.toml|HISTORY.sqlite",
    )
    add("--history", OutputFile, "where results are kept; default: NAME.history.sqlite beside the campaign file")
    add("--unit", str, "run this unit alone, in this process, and keep nothing", metavar="NAME")
    add("--strict", bool, "fail by every failure, not only by those that are new since the last run")
    add_workers(add, "units")
    add_engine(add)
    add_json(add)
    add("--html", OutputFile, "write the report as a page")
    add_reference(add)


def add_stress_arguments(add: Adder) -> None:
    add_item_selection(add, "family", "such as tangency, or watertight for both; default: all")
    add("--rays", positive_int, "rays of each setting; default: 400, watertight 10000")
    add("--seed", whole, "of the rays; default: 0", metavar="SEED", default=0)
    add_workers(add, "families")
    add_engine(add)
    add(
        "--out",
        OutputFolder,
        "where the first wrong ray of each setting is kept, as a scene; default: stress-failures",
        default="stress-failures",
    )
    add_json(add)
    add_one = add_candidate(add, "another ray caster, which takes rays (mitsuba-ref docs candidates)")
    add_one(
        "--spawn",
        str,
        "in place of ray casters, judge a rule of where rays start: of (points, normals, directions)",
        metavar="MODULE:FUNCTION",
    )
    add_skip_unsupported(add, "families")


def add_bench_arguments(add: Adder) -> None:
    add_item_selection(add, "scene", "such as mesh-70k, or a scene or mesh file; default: all that --list names")
    add("--aov", str, "AOVs of images, such as depth,normal,diffuse; default: depth,normal", metavar="AOV,...")
    add("--size", positive_int, f"pixels a side; default: {DEFAULT_SIZE}", default=DEFAULT_SIZE)
    add("--alternations", positive_int, f"turns of each; default: {DEFAULT_ALTERNATIONS}", default=DEFAULT_ALTERNATIONS)
    add_engine(add)
    add_json(add)
    add_mesh_dirs(add)
    add_candidate(add, "another ray caster, which takes rays (mitsuba-ref docs candidates)")
