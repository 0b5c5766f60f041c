"""Options that several commands share: selection of scenes, a candidate, report files, and those of experiments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol, Self, TextIO, TypeVar

from caster.cli.shared_arguments import (
    InputPath,
    OutputFile,
    OutputFolder,
    add_mesh_dirs,
    check_utf8_name,
    display_names,
    positive_int,
    scene_files,
)
from caster.description.errors import SceneError, error_prefix, suggestion
from caster.system.terminal import StatusLine
from mitsuba_ref.report import builtin_scenes

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.conventions import Reading
    from mitsuba_ref.judge.verdict import Verdict
    from mitsuba_ref.runner.many_scenes import SceneEntry
    from mitsuba_ref.subjects.subject import Subject

# Copies, since the judge's modules load the kernels (tests/unit/test_cli_help.py compares them).
CANDIDATE_SECONDS = REFERENCE_SECONDS = 300.0
PRECISIONS = ("float32", "float64")
MAX_SECONDS = 100_000.0  # about a day; the system's waits take milliseconds in 31 bits, and some are multiples of it
BUILTIN_SETS = ("triangles", "spheres", "others", "all")  # folders of mitsuba_ref/runner/builtin, and all of them
DEFAULT_SCENES = [InputPath("scenes")]


def whole(text: str) -> int:
    """Parse a whole number >= 0. Raises argparse.ArgumentTypeError."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got '{text}'")
    return int(text)


def positive_seconds(text: str) -> float:
    """Parse a duration in seconds, > 0 and <= MAX_SECONDS. Raises argparse.ArgumentTypeError."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= MAX_SECONDS:
        raise argparse.ArgumentTypeError(
            f"expected a number of seconds > 0 and at most {MAX_SECONDS:,.0f}, got '{text}'"
        )
    return value


# ---- scenes ----


class ScenePath(InputPath):
    """A scene argument: a path, or builtin:NAME, whose path it is. Raises SceneError for an unknown name."""

    def __new__(cls, text: str) -> Self:
        return super().__new__(cls, builtin_scenes.scene_path(text))


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


def selected_entries(args: argparse.Namespace) -> list[SceneEntry]:
    """The selected scenes, not loaded yet; prints a message if there are none. Raises SceneError."""
    from caster.scene.files import types_in_file
    from caster.scene.model import Film
    from mitsuba_ref.runner.many_scenes import SceneEntry, matching

    fits = matching(args.expression, types_in_file)
    for folder in args.mesh_dir:
        check_utf8_name(folder)
    named = [] if args.builtin and args.scenes is DEFAULT_SCENES else args.scenes
    places = [*builtin_folders(args.builtin), *named]
    files = [file for file in scene_files(places) if fits(file)]
    if args.size:
        with error_prefix("--size", *args.size):
            Film(width=args.size[0], height=args.size[1])
    size, mesh_dirs, again = tuple(args.size) if args.size else None, tuple(args.mesh_dir), candidate_words(args)
    names = display_names(files)
    entries = [SceneEntry(name, file, size, mesh_dirs, again) for name, file in zip(names, files, strict=True)]
    if not entries:
        fitting = f" that fits -k {args.expression!r}" if args.expression else ""
        print(f"nothing selected: no scene file{fitting} in {', '.join(places)}", file=sys.stderr)
    return entries


def builtin_folders(name: str | None) -> list[str]:
    """Folders of a set of built-in scenes; none for None."""
    if name is None:
        return []
    chosen = BUILTIN_SETS[:-1] if name == BUILTIN_SETS[-1] else (name,)
    return [str(builtin_scenes.ROOT / each) for each in chosen]


def add_timeout(parser: argparse.ArgumentParser) -> None:
    """Add --timeout."""
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=positive_seconds,
        default=REFERENCE_SECONDS,
        help=f"seconds that Mitsuba may take for one scene, or one band of a large film; default {REFERENCE_SECONDS:g}",
    )


# ---- a candidate ----


class ServedProgram(str):
    """The command of --candidate-serve."""


def add_candidate(
    parser: argparse.ArgumentParser, title: str = "another ray caster, judged in place of ours (docs/candidates.md)"
) -> None:
    """Add --candidate, its precision and its time limit."""
    group = parser.add_argument_group(title)
    one = group.add_mutually_exclusive_group()
    one.add_argument(
        "--candidate",
        "--candidate-rays",
        dest="candidate",
        type=str,
        metavar="X",
        help="package.module:function, called as function(scene, o, d) -> (t, n); or a command that reads our scene "
        "and writes an EXR file, such as 'my-renderer {xml} -o {exr}' ({toml}, {width}, {height}); or one that reads "
        "rays and writes hits, such as 'my-caster {mesh} {rays} {hits}' (docs/rays-and-hits.md)",
    )
    one.add_argument(
        "--candidate-serve",
        dest="candidate",
        type=ServedProgram,
        metavar="PROG",
        help="a program that is started once and answers over stdin and stdout (docs/rays-and-hits.md)",
    )
    group.add_argument(
        "--candidate-precision",
        metavar="P",
        choices=PRECISIONS,
        help="its arithmetic, from which its bounds follow; default: the type of what it returns",
    )
    group.add_argument(
        "--candidate-timeout",
        metavar="S",
        type=positive_seconds,
        help=f"seconds that a command may take for one scene; default {CANDIDATE_SECONDS:g}",
    )


def requested_candidate(args: argparse.Namespace, *, takes_rays: bool = False) -> Subject | None:
    """The candidate of --candidate; None: our caster is judged. Raises SceneError for one that cannot be used.

    takes_rays: one that renders images of its own camera cannot.
    """
    if args.candidate is None:
        for word in given_words(args, "candidate_precision", "candidate_timeout", *READING_OPTIONS)[:1]:
            raise SceneError(f"{word}: expected --candidate X beside it, whose answers it is about")
        return None
    from mitsuba_ref.subjects.command import CommandSubject
    from mitsuba_ref.subjects.requests import parse_candidate

    served, seconds = isinstance(args.candidate, ServedProgram), args.candidate_timeout or CANDIDATE_SECONDS
    found = parse_candidate(args.candidate, args.candidate_precision, seconds, served=served)
    if takes_rays and not found.takes_rays:
        raise SceneError(
            f"--candidate {args.candidate!r}: expected one that casts rays it is given: package.module:function, "
            "a command with {rays} and {hits}, or --candidate-serve (docs/rays-and-hits.md)"
        )
    if isinstance(found, CommandSubject):
        from dataclasses import replace
        from functools import partial

        from mitsuba_ref.exr_compare.conventions import candidate_image

        return replace(found, convert=partial(candidate_image, reading=reading_of(args)))
    for word in given_words(args, *READING_OPTIONS)[:1]:
        raise SceneError(f"{word}: expected a --candidate with {{exr}} beside it, whose images it is about")
    return found


READING_OPTIONS = ("map", "depth", "miss")  # of add_reading


def candidate_words(args: argparse.Namespace) -> tuple[str, ...]:
    """The options of the candidate, for a replay with the same one; () without one."""
    return given_words(args, "candidate", "candidate_precision", "candidate_timeout", *READING_OPTIONS)


def given_words(args: argparse.Namespace, *names: str) -> tuple[str, ...]:
    """Those of these options that were given, as words of a command line. Raises SceneError unless they are UTF-8."""
    words: list[str] = []
    for name in names:
        value = getattr(args, name, None)
        option = "--candidate-serve" if isinstance(value, ServedProgram) else f"--{name.replace('_', '-')}"
        for each in value if isinstance(value, list) else [] if value is None else [value]:
            words += [option, repr(each).removesuffix(".0") if isinstance(each, float) else str(each)]
            check_utf8_name(words[-1])
    return tuple(words)


# ---- files of other programs ----


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


def reading_of(args: argparse.Namespace) -> Reading:
    """The options of add_reading, the defaults where the command has none. Raises SceneError."""
    from mitsuba_ref.exr_compare.conventions import Reading

    maps, depth, miss = (getattr(args, name, None) for name in READING_OPTIONS)
    return Reading(tuple(maps or ()), depth, miss)


def add_skip_unsupported(parser: argparse.ArgumentParser, plural: str) -> None:
    """Add --skip-unsupported. plural: "scenes" or "families"."""
    parser.add_argument(
        "--skip-unsupported",
        action="store_true",
        help=f"do not fail by {plural} that the candidate declines (NotImplementedError, exit code 77); "
        "they are counted",
    )


# ---- files of results ----


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


def write_verdict_files(verdict: Verdict, args: argparse.Namespace, seconds: float) -> None:
    """Write --json, --junit and --summary-md. Raises OutputError."""
    from caster.system.atomic_files import write_text
    from mitsuba_ref.report.ci_summaries import append, junit
    from mitsuba_ref.report.out_folder import verdict_json

    if args.json:
        write_text(args.json, verdict_json(verdict))
    if args.junit:
        write_text(args.junit, junit(verdict))
    if args.summary_md:
        append(args.summary_md, verdict, seconds)


# ---- experiments: fuzz, stress, bench ----


def add_item_selection(parser: argparse.ArgumentParser, what: str, words: str) -> None:
    """Add the items by name, -k and --list. what: "family" or "scene"."""
    plural = {"family": "families", "scene": "scenes"}[what]
    add = parser.add_argument
    add(plural, metavar=what.upper(), type=str, nargs="*", help=words)
    example = "'scale and not mesh'" if what == "family" else "'mesh and not lit'"
    add("-k", type=str, metavar="EXPR", dest="expression", help=f"{plural} whose name matches, such as {example}")
    add("--list", action="store_true", help=f"list the {plural} and stop")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json",
        type=OutputFile,
        metavar="FILE",
        help="write the result as JSON; - is standard output, which then holds nothing else",
    )


def check_json(args: argparse.Namespace) -> None:
    """Raise OutputError before any work if the file cannot be written."""
    from caster.system.atomic_files import check_writable

    if args.json and args.json != "-":
        check_writable(args.json)


def table_stream(args: argparse.Namespace) -> TextIO:
    """The stream for tables: standard error if the JSON goes to standard output."""
    return sys.stderr if args.json == "-" else sys.stdout


class Progress:
    """A line on a terminal's standard error that each call overwrites; nothing elsewhere."""

    def __init__(self, what: str) -> None:
        self.what, self.line = what, StatusLine()

    def __call__(self, words: str) -> None:
        self.line.show(f"{self.what}: {words}")

    def clear(self) -> None:
        self.line.erase()


class Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)


def select(items: Sequence[T], what: str, words: Sequence[str], expression: str | None) -> list[T]:
    """Select items by name or by its part before a dash, in the registry's order; all of them without words.

    what: "scene" or "family", for messages. Raises SceneError for an unknown word or an invalid expression.
    """
    names = [item.name for item in items]
    known = [*names, *(name.partition("-")[0] for name in names)]
    for word in words:
        if word not in known:
            raise SceneError(f"{what} '{word}': unknown{suggestion(word, known)} (known: {', '.join(names)})")
    from mitsuba_ref.runner.many_scenes import matching

    matches = matching(expression)
    chosen = (item for item in items if not words or {item.name, item.name.partition("-")[0]} & set(words))
    return [item for item in chosen if matches(item.name)]
