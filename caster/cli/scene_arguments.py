"""What the commands that read a scene share."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

from caster.description.errors import FileMissing, SceneError

__all__ = [
    "add_mesh_dirs",
    "add_pixel",
    "add_scene",
    "display_names",
    "error_prefix",
    "load",
    "mesh_dir_options",
    "scene_files",
]

if TYPE_CHECKING:
    from caster.scene.model import Scene

SCENE_FILE = "a scene file, .toml or .json"
SUFFIXES = (".toml", ".json")  # of the files of a folder that are scenes


def add_scene(parser: argparse.ArgumentParser) -> None:
    """SCENE, --mesh-dir and --size."""
    parser.add_argument("scene", metavar="SCENE", help=SCENE_FILE)
    add_mesh_dirs(parser)
    parser.add_argument(
        "--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scene's own"
    )


def add_mesh_dirs(parser: argparse.ArgumentParser) -> None:
    """--mesh-dir, as often as one likes."""
    parser.add_argument(
        "--mesh-dir",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder beyond the scene's own whose meshes it may use; may be given several times",
    )


def mesh_dir_options(args: argparse.Namespace) -> tuple[str, ...]:
    """The words of --mesh-dir, for a command that is to see the same scene."""
    return tuple(word for folder in args.mesh_dir for word in ("--mesh-dir", folder))


def add_pixel(parser: argparse.ArgumentParser) -> None:
    """X and Y."""
    parser.add_argument("x", metavar="X", type=int, help="column of the pixel, 0 at the left")
    parser.add_argument("y", metavar="Y", type=int, help="row of the pixel, 0 at the top")


def load(args: argparse.Namespace) -> Scene:
    """The scene that was asked for, at the size that was asked for."""
    from caster.scene.files import load_scene

    scene = load_scene(args.scene, args.mesh_dir)
    if args.size is None:
        return scene
    with error_prefix("--size", *args.size):
        return scene.with_film(width=args.size[0], height=args.size[1])


def scene_files(paths: Iterable[str]) -> list[str]:
    """Scene files, as given or inside the folders given, sorted within each. Raises FileMissing, SceneError."""
    found: list[str] = []
    for path_text in paths:
        path = Path(path_text)
        if path.is_dir():
            found += [str(file) for file in sorted(path.iterdir()) if file.suffix.lower() in SUFFIXES]
        elif path.is_file():
            found.append(path_text)
        else:
            raise FileMissing(f"{path_text}: expected a scene file or a folder of them, found nothing")
    for file in found:
        check_utf8_name(file)
    return list({os.path.realpath(file): file for file in reversed(found)}.values())[::-1]


def check_utf8_name(file: str) -> None:
    """Raises SceneError for a name that no text file can hold: verdicts and pages name their scenes."""
    try:
        file.encode("utf-8")
    except UnicodeEncodeError:
        raise SceneError(f"{file!a}: expected a file name in UTF-8, got other bytes; rename it") from None


def display_names(files: Sequence[str]) -> list[str]:
    """What to call each: its stem, or its whole path where another file has the same stem. No two are the same."""
    stems = Counter(Path(file).stem for file in files)
    names: dict[str, None] = {}
    for file in files:
        name = Path(file).stem if stems[Path(file).stem] == 1 else path_as_name(file)
        numbered = (f"{name}-{number}" for number in count(2))  # ../scenes/a.toml and scenes/a.toml
        names[next(each for each in chain([name], numbered) if each not in names)] = None
    return list(names)


def path_as_name(file: str) -> str:
    """A path that may be the name of a file."""
    return file.replace(os.sep, "-").lstrip(".-")


@contextlib.contextmanager
def error_prefix(*words: object) -> Iterator[None]:
    """Let an error begin with the words it comes from: an option with its numbers, or a file."""
    try:
        yield
    except SceneError as error:
        raise type(error)(f"{' '.join(map(str, words))}: {error}") from None
