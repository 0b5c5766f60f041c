"""Options, progress and output that `fuzz`, `stress` and `bench` have in common."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Protocol, TextIO, TypeVar

from caster.cli.path_arguments import OutputFile
from caster.cli.progress import StatusLine
from caster.description.errors import SceneError, suggestion


def whole(text: str) -> int:
    """A whole number >= 0, or an error in argparse's way."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got '{text}'")
    return int(text)


def add_selection(parser: argparse.ArgumentParser, what: str, words: str) -> None:
    """The items by name, -k and --list. what: "family" or "scene"."""
    plural = {"family": "families", "scene": "scenes"}[what]
    add = parser.add_argument
    add(plural, metavar=what.upper(), type=str, nargs="*", help=words)
    example = "'scale and not mesh'" if what == "family" else "'mesh and not lit'"
    add(
        "-k",
        type=str,
        metavar="EXPR",
        dest="expression",
        help=f"{plural} whose name matches, such as {example}",
    )
    add("--list", action="store_true", help=f"list the {plural} and stop")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json",
        type=OutputFile,
        metavar="FILE",
        help="write the result as JSON; - is standard output, which then holds nothing else",
    )


def check_json(args: argparse.Namespace) -> None:
    """Raise OutputError now, and not after all the work."""
    from caster.image.atomic_files import check_writable

    if args.json and args.json != "-":
        check_writable(args.json)


def table_stream(args: argparse.Namespace) -> TextIO:
    """Where tables go: not to standard output if that takes the JSON."""
    return sys.stderr if args.json == "-" else sys.stdout


class Progress:
    """One line on a terminal's stderr, overwritten by each call; nothing elsewhere."""

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
    """Items by name, or by the part of it before a dash; all of them without words. In the registry's order.

    what: "scene" or "family", for messages. Raises SceneError for a word that is neither, or an invalid expression.
    """
    names = [item.name for item in items]
    known = [*names, *(name.partition("-")[0] for name in names)]
    for word in words:
        if word not in known:
            raise SceneError(f"{what} '{word}': unknown{suggestion(word, known)} (known: {', '.join(names)})")
    from mitsuba_ref.runner.scene_selection import matching

    matches = matching(expression)
    chosen = (item for item in items if not words or {item.name, item.name.partition("-")[0]} & set(words))
    return [item for item in chosen if matches(item.name)]
