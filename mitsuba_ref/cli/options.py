"""Options of a candidate, and those that fuzz, stress and bench share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, Self, TextIO, TypeVar

from caster.cli.shared_arguments import InputPath, OutputFile, check_utf8_name
from caster.description.errors import SceneError, suggestion
from caster.system.terminal import StatusLine
from mitsuba_ref.report import builtin_scenes

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.conventions import Reading
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
