"""Options of a candidate, and those that fuzz, stress and bench share."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from caster.cli.shared_arguments import check_utf8_name, load
from caster.description.errors import SceneError, suggestion
from caster.scene.model import Scene
from caster.system.process import NOTHING_SELECTED, OK
from mitsuba_ref.cli.arguments import CANDIDATE_SECONDS, ServedProgram
from mitsuba_ref.exr_compare.conventions import Reading, candidate_image
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.original_files import Opening, is_original, open_scene
from mitsuba_ref.report.output import STANDARD_OUTPUT, print_lines
from mitsuba_ref.subjects.command import CommandSubject, ExrFile, RayProgram
from mitsuba_ref.subjects.requests import parse_candidate
from mitsuba_ref.subjects.subject import Subject

# ---- Mitsuba files ----

OPENING_OPTIONS = ("define", "sensor", "strict")


def opening_of(args: Namespace) -> Opening:
    """How -D, --sensor and --strict open Mitsuba files. Raises SceneError for a word that is not NAME=VALUE."""
    words = getattr(args, "define", [])
    for word in words:
        if "=" not in word:
            raise SceneError(f"-D {word}: expected NAME=VALUE")
    parameters = dict(word.split("=", 1) for word in words)
    return Opening(parameters, getattr(args, "sensor", None) or 0, getattr(args, "strict", False))


def load_scene_or_original(args: Namespace) -> Scene:
    """The scene of add_scene, at the film size of --size; of a Mitsuba file, with that file as its reference."""
    if is_original(args.scene):
        return open_scene(args.scene, opening_of(args), size=args.size, mesh_dirs=args.mesh_dir)
    return load(args)


# ---- a candidate ----


def requested_candidate(args: Namespace, *, takes_rays: bool = False) -> Subject | None:
    """The candidate of --candidate; None: our caster is judged. Raises SceneError for one that cannot be used.

    takes_rays: one that renders images of its own camera cannot.
    """
    if args.candidate is None:
        refuse(args, "expected --candidate X beside it, whose answers it is about", *CANDIDATE_OPTIONS)
        return None
    served, seconds = isinstance(args.candidate, ServedProgram), args.candidate_timeout or CANDIDATE_SECONDS
    found = parse_candidate(args.candidate, args.candidate_precision, seconds, served=served)
    if takes_rays and not found.takes_rays:
        raise SceneError(
            f"--candidate {args.candidate!r}: expected one that casts rays it is given: package.module:function, "
            "a command with {rays} and {hits}, or --candidate-serve (mitsuba-ref docs candidates)"
        )
    if args.no_limits and not isinstance(found, RayProgram):
        raise SceneError("--no-limits: expected a program that reads rays with limits: {rays} or --candidate-serve")
    if isinstance(found, RayProgram):
        return replace(found, takes_limits=not args.no_limits)
    if isinstance(found, CommandSubject | ExrFile):
        return replace(found, convert=partial(candidate_image, reading=reading_of(args)))
    why = "expected a --candidate with {exr} beside it, or an .exr file, whose image it is about"
    refuse(args, why, *READING_OPTIONS)
    return found


READING_OPTIONS = ("map", "depth", "miss")  # of add_reading
CANDIDATE_OPTIONS = ("candidate_precision", "candidate_timeout", "no_limits", *READING_OPTIONS)  # beside --candidate


def candidate_words(args: Namespace) -> tuple[str, ...]:
    """The options of the candidate, for a replay with the same one; () without one."""
    return given_words(args, "candidate", *CANDIDATE_OPTIONS)


def given_words(args: Namespace, *names: str) -> tuple[str, ...]:
    """Those of these options that were given, as words of a command line. Raises SceneError unless they are UTF-8."""
    words: list[str] = []
    for name in names:
        value = getattr(args, name, None)
        option = "--candidate-serve" if isinstance(value, ServedProgram) else f"--{name.replace('_', '-')}"
        if value is None or isinstance(value, bool):
            words += [option] if value else []
            continue
        for each in value if isinstance(value, list) else [value]:
            words += [option, repr(each).removesuffix(".0") if isinstance(each, float) else str(each)]
            check_utf8_name(words[-1])
    return tuple(words)


def refuse(args: Namespace, why: str, *names: str) -> None:
    """Raise SceneError where one of these options was given."""
    for option in given_words(args, *names)[:1]:
        raise SceneError(f"{option}: {why}")


def reading_of(args: Namespace) -> Reading:
    """The options of add_reading, the defaults where the command has none. Raises SceneError."""
    maps, depth, miss = (getattr(args, name, None) for name in READING_OPTIONS)
    return Reading(tuple(maps or ()), depth, miss)


# ---- reports ----


def report_address(folder: str) -> str:
    """A line with the address of a report, for a browser."""
    return f"report:     {(Path(folder).absolute() / 'index.html').as_uri()}"


# ---- experiments: fuzz, stress, bench ----


def missing_variants() -> str:
    """A line on the variants of Mitsuba that do not work here; "" if all do."""
    works = variants.usable_variants()
    missing = [name for name in variants.VARIANT_NAMES if name not in works.names]
    return f"{', '.join(missing)}: does not work here: {works.why}\n" if missing else ""


def table_stream(args: Namespace) -> TextIO:
    """The stream for tables: standard error if the JSON goes to standard output."""
    return sys.stderr if args.json == STANDARD_OUTPUT else sys.stdout


class NothingSelected(SceneError):  # noqa: N818 - an outcome
    """The options leave nothing to do, or nothing that can be judged."""

    exit_code = NOTHING_SELECTED


def select(items: Sequence[Any], what: str, words: Sequence[str]) -> list[Any]:
    """Select named items by name or by its part before a dash, in the order of the registry; all without words.

    what: "scene" or "family", for messages. Raises SceneError for an unknown word.
    """
    names = [item.name for item in items]
    known = [*names, *(name.partition("-")[0] for name in names)]
    for word in words:
        if word not in known:
            raise SceneError(f"{what} '{word}': unknown{suggestion(word, known)} (known: {', '.join(names)})")
    return [item for item in items if not words or {item.name, item.name.partition("-")[0]} & set(words)]


def print_list(items: Sequence[Any]) -> int:
    """Print the names and titles that --list asks for."""
    width = max(len(item.name) for item in items) + 2
    print_lines("\n".join(f"{item.name:{width}}{item.title}" for item in items))
    return OK
