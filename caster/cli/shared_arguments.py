"""Arguments that commands of `caster` and `mitsuba-ref` share: scenes, their selection, and paths.

Options declare the paths they name by their `type`: InputPath, OutputFile or OutputFolder.
tests/unit/test_path_arguments.py walks all parsers, so that none is left undeclared.
"""

from __future__ import annotations

import contextlib
import os
import re
from argparse import ArgumentTypeError, Namespace
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from caster.description.errors import FileMissing, SceneError, error_prefix
from caster.description.input_files import MESH_SUFFIXES, SCENE_SUFFIXES
from caster.jit.kernel_cache import claim
from caster.system.atomic_files import OutputError, check_folder, check_writable

__all__ = [
    "AOV_NAMES",
    "DEFAULT_AOV_LIST",
    "METAVARS",
    "Adder",
    "InputPath",
    "OutputFile",
    "OutputFolder",
    "add_mesh_dirs",
    "add_pixel",
    "add_scene",
    "check_exr_suffix",
    "check_film_size",
    "check_utf8_name",
    "comma_separated",
    "display_names",
    "engine",
    "load",
    "positive_int",
    "resized",
    "scene_files",
]

if TYPE_CHECKING:
    from argparse import _ActionsContainer

    from caster.scene.model import Scene

SCENE_FILE = "a scene file, .toml or .json; or a mesh file: OBJ, PLY, STL, OFF, glTF"

# Copies of the registry and of caster.rendering's default, as loading AOVs loads the kernels
# (tests/unit/test_cli_help.py compares them).
AOV_NAMES = "hit, depth, normal, shading_normal, position, uv, albedo, diffuse, shape_id, prim_id"
DEFAULT_AOV_LIST = "hit,depth,normal,position,diffuse"


class Adder(NamedTuple):
    """Adds an argument to a parser or a group of it: add(names, type, help, ...); bool is a flag."""

    place: _ActionsContainer

    def __call__(self, names: str, kind: Any, about: str | None = None, **more: Any) -> None:
        usual = {"action": "store_true"} if kind is bool else {"type": kind, "metavar": METAVARS.get(kind)}
        self.place.add_argument(*names.split(), help=about, **(usual | more))

    def group(self, title: str) -> Adder:
        """Adds to a new group with a title in the help."""
        return Adder(self.place.add_argument_group(title))

    def one_of_group(self) -> Adder:
        """Adds to a new group of which only one argument may be given."""
        return Adder(self.place.add_mutually_exclusive_group())


def add_scene(add: Adder, kind: type[InputPath] | None = None) -> None:
    """Add SCENE, --mesh-dir and --size. kind: of the path that is typed for the scene."""
    add("scene", kind or InputPath, SCENE_FILE, metavar="SCENE")
    add_mesh_dirs(add)
    add("--size", int, "film in pixels, instead of the scene's own", nargs=2, metavar=("W", "H"))


def add_mesh_dirs(add: Adder) -> None:
    """Add --mesh-dir, which may be repeated."""
    add(
        "--mesh-dir",
        InputPath,
        "a folder beyond the scene's own in which its meshes are looked for; may be given several times",
        action="append",
        default=[],
        metavar="DIR",
    )


def add_threads(add: Adder) -> None:
    """Add --threads."""
    add("--threads", thread_number, "default: one for each core", metavar="N")


MAX_THREADS = 1024  # more than the processors of any machine


def thread_number(text: str) -> int:
    """Parse a number of threads, or raise argparse's error."""
    number = positive_int(text)
    if number > MAX_THREADS:
        raise ArgumentTypeError(f"expected at most {MAX_THREADS} threads, got {text}")
    return number


def positive_int(text: str) -> int:
    """Parse an integer >= 1, or raise argparse's error."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"expected a whole number >= 1, got '{text}'")
    return int(text)


def engine(text: str) -> str:
    """Parse the name of an engine, or raise argparse's error."""
    if text in ("local", "dask") or re.fullmatch(r"dask:(tcp|tls)://.+:\d+", text):
        return text
    raise ArgumentTypeError(f"expected local, dask or dask:tcp://HOST:PORT, got '{text}'")


def comma_separated(text: str | None) -> list[str]:
    """The distinct words of "A,B,...", in order; none for None."""
    return [] if text is None else list(dict.fromkeys(text.split(",")))


def check_exr_suffix(output: str) -> None:
    """Raise SceneError for an output name that other programs would not recognise as an EXR file."""
    if Path(output).suffix.lower() != ".exr":
        raise SceneError(f"-o {output}: expected a name that ends in .exr")


def add_pixel(add: Adder) -> None:
    """Add X and Y."""
    add("x", coordinate, "column of the pixel, 0 at the left", metavar="X")
    add("y", coordinate, "row of the pixel, 0 at the top", metavar="Y")


def coordinate(text: str) -> int:
    """Parse a column or row. Raises argparse.ArgumentTypeError."""
    try:
        return int(text)
    except ValueError:
        order = "expected SCENE X Y in this order, such as scene.toml 160 120"
        raise ArgumentTypeError(f"{order}, with whole numbers; got '{text}'") from None


def load(args: Namespace) -> Scene:
    """Load the scene of the arguments of `add_scene`, at the film size of --size."""
    from caster.scene.files import load_scene

    return resized(load_scene(args.scene, args.mesh_dir), args.size)


def check_film_size(option: str, width: int, height: int) -> None:
    """Raise SceneError for numbers of pixels that no film has."""
    from caster.scene.model import Film

    with error_prefix(option, width, height):
        Film(width=width, height=height)


def resized(scene: Scene, size: Sequence[int] | None) -> Scene:
    """The scene with a film of this width and height, if they are given. Raises SceneError."""
    if size is None:
        return scene
    with error_prefix("--size", *size):
        return scene.with_film(width=size[0], height=size[1])


def scene_files(paths: Iterable[str]) -> list[str]:
    """Expand folders into their sorted scene files, without duplicates. Raises FileMissing, SceneError."""
    found: list[str] = []
    for path_text in paths:
        path = Path(path_text)
        if path.is_dir():
            found += _scene_files_in(path_text)
        elif path.is_file():
            found.append(path_text)
        else:
            raise FileMissing(f"{path_text}: expected a scene file or a folder of them, found nothing")
    for file in found:
        check_utf8_name(file)
    return list({os.path.realpath(file): file for file in reversed(found)}.values())[::-1]


def check_utf8_name(name: str) -> None:
    """Raise SceneError for a name that is not UTF-8: reports could not contain it."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise SceneError(f"{name!a}: expected a name in UTF-8, got other bytes; rename it") from None


def display_names(files: Sequence[str]) -> list[str]:
    """Distinct names for files: the stem, or the whole path if another file has the same stem."""
    stems = Counter(Path(file).stem for file in files)
    names: dict[str, None] = {}
    for file in files:
        name = Path(file).stem if stems[Path(file).stem] == 1 else file.replace(os.sep, "-").lstrip(".-")
        numbered = (f"{name}-{number}" for number in count(2))  # ../scenes/a.toml and scenes/a.toml
        names[next(each for each in chain([name], numbered) if each not in names)] = None
    return list(names)


# ---- paths: no output is an input ----


class InputPath(str):
    """A file that is read, or a folder of such files."""


class OutputFile(str):
    """A file that is written; - is standard output, where an option allows it."""


class OutputFolder(str):
    """A folder that files are written into; created if it does not exist."""


# By the type of an argument: the name of its values in --help. Modules with types of their own add them.
METAVARS: dict[Any, str] = {OutputFile: "FILE", OutputFolder: "DIR", positive_int: "N"}


def output_file_unless_number(text: str) -> str:
    """The type of an option that takes numbers and an output file."""
    try:
        float(text)
    except ValueError:
        return OutputFile(text)
    return text


@contextlib.contextmanager
def checked_paths(args: Namespace) -> Iterator[None]:
    """Check outputs, and lock output folders for this process while the body runs.

    Raises SceneError for an output that is an input, a scene file of an input folder, or another output; OutputError
    for a file that cannot be written or a folder that another process writes into.
    """
    given = [(name, value) for name, values in vars(args).items() for value in _flat(values)]
    sources = (value for _, value in given if isinstance(value, InputPath))
    inputs = {_file_id(file) for source in sources for file in [source, *_scene_files_in(source)]}
    # the files that a candidate is or names: a program, an image, module:function
    values = [str(value) for _, value in given if not isinstance(value, (OutputFile, OutputFolder))]
    words = {word for value in values for word in (value, *value.replace(":", " ").split())}
    named = (name for word in words for name in (word, word.replace(".", "/") + ".py"))
    inputs |= {_file_id(name) for name in named if os.path.isfile(name)}
    option_of: dict[str, str] = {}  # by the path of its output
    with contextlib.ExitStack() as stack:
        for name, path in given:
            if not isinstance(path, (OutputFile, OutputFolder)) or path == "-":
                continue
            option = f"--{name.replace('_', '-')}"
            if os.path.exists(path) and (_file_id(path) in inputs or path.lower().endswith(MESH_SUFFIXES)):
                raise SceneError(f"{option} {path}: expected another path: it is an input, and would be overwritten")
            other = option_of.setdefault(os.path.realpath(path), option)
            if isinstance(path, OutputFile) and other != option:
                raise SceneError(f"{option} {path}: expected a file other than that of {other}")
            if isinstance(path, OutputFile):
                check_writable(path)
            if isinstance(path, OutputFolder) and other == option:
                stack.enter_context(_own_folder(Path(path)))
        yield


@contextlib.contextmanager
def _own_folder(folder: Path) -> Iterator[None]:
    """Create and lock an output folder; remove it again if nothing was written."""
    created = not folder.exists()
    check_folder(folder)
    try:
        with claim(folder / ".mitsuba-ref", wait=False) as alone:
            if not alone:
                raise OutputError(
                    f"{folder}: another run writes into this folder: wait for its end, or name another folder"
                )
            yield
    finally:
        if created:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _file_id(path: str) -> tuple[int, int] | None:
    """Device and inode: equal for links and other spellings of a path. None if there is no such file."""
    with contextlib.suppress(OSError, ValueError):
        status = os.stat(path)
        return status.st_dev, status.st_ino
    return None


def _flat(values: Any) -> Iterator[Any]:
    if isinstance(values, (list, tuple)):
        for each in values:
            yield from _flat(each)
    else:
        yield values


def _scene_files_in(source: str) -> list[str]:
    """The scene files of a folder, sorted; none of anything else."""
    if not os.path.isdir(source):
        return []
    return [str(file) for file in sorted(Path(source).iterdir()) if file.suffix.lower() in SCENE_SUFFIXES]
