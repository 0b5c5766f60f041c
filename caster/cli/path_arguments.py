"""Paths among the arguments of a command: no output is an input, and no two runs write into one folder.

Options declare what they name by their `type`: InputPath, OutputFile or OutputFolder. tests/unit/test_path_arguments.py
walks all parsers, so that none is left undeclared.
"""

import argparse
import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.description.input_files import file_id, record_input, recorded_inputs
from caster.image.atomic_files import OutputError, check_folder, locked

__all__ = ["InputPath", "OutputFile", "OutputFolder", "checked_paths", "output_file_unless_number"]

SCENE_SUFFIXES = (".toml", ".json")


class InputPath(str):
    """A file that is read, or a folder of such files."""


class OutputFile(str):
    """A file that is written; - is standard output, where an option allows it."""


class OutputFolder(str):
    """A folder that files are written into; created if it does not exist."""


def output_file_unless_number(text: str) -> str:
    """The type of an option that takes numbers and an output file."""
    try:
        float(text)
    except ValueError:
        return OutputFile(text)
    return text


@contextlib.contextmanager
def checked_paths(args: argparse.Namespace) -> Iterator[None]:
    """Refuse outputs that are inputs, now and while the body runs; lock output folders for this process.

    Raises SceneError for such an output, OutputError for a folder that another process writes into.
    """
    given = [(name, value) for name, values in vars(args).items() for value in _flat(values)]
    inputs = [each for each in given if isinstance(each[1], InputPath)]
    outputs = [each for each in given if isinstance(each[1], (OutputFile, OutputFolder)) and each[1] != "-"]
    for place, (name, path) in enumerate(outputs):
        for other, source in inputs:
            if _is_or_contains(source, path):
                raise SceneError(
                    f"{_option(name)} {path}: expected another path than the input {_option(other)} {source}: "
                    "it would be overwritten"
                )
        for other, earlier in outputs[:place]:
            if isinstance(path, OutputFile) and _same(path, earlier):
                raise SceneError(
                    f"{_option(name)} {path}: expected another file than that of {_option(other)}"
                )
    with recorded_inputs(), contextlib.ExitStack() as stack:
        for _, source in inputs:
            for file in _files(source):
                record_input(file)
        for folder in {os.path.realpath(path): path for _, path in outputs if isinstance(path, OutputFolder)}:
            stack.enter_context(_own_folder(Path(folder)))
        yield


@contextlib.contextmanager
def _own_folder(folder: Path) -> Iterator[None]:
    """Create and lock an output folder; remove it again if nothing was written."""
    created = not folder.exists()
    check_folder(folder)
    with locked(folder) as alone:
        if not alone:
            raise OutputError(
                f"{folder}: another run writes into this folder: wait for its end, or name another folder"
            )
        try:
            yield
        finally:
            if created:
                with contextlib.suppress(OSError):
                    folder.rmdir()


def _flat(values: Any) -> Iterator[Any]:
    if isinstance(values, (list, tuple)):
        for each in values:
            yield from _flat(each)
    else:
        yield values


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _same(a: str, b: str) -> bool:
    """Whether two paths name one file or folder, which need not exist."""
    if os.path.realpath(a) == os.path.realpath(b):
        return True
    found = file_id(a)
    return found is not None and found == file_id(b)


def _is_or_contains(source: str, output: str) -> bool:
    """Whether an output is an input, or a scene file of an input folder."""
    return _same(source, output) or (
        isinstance(output, OutputFile)
        and (found := file_id(output)) is not None
        and any(file_id(file) == found for file in _files(source))
    )


def _files(source: str) -> Iterator[str]:
    """The files that an input path stands for: itself, or the scene files of a folder."""
    try:
        is_folder = stat.S_ISDIR(os.stat(source).st_mode)
    except (OSError, ValueError):
        return
    if not is_folder:
        yield source
        return
    with contextlib.suppress(OSError), os.scandir(source) as entries:
        yield from (each.path for each in entries if each.name.lower().endswith(SCENE_SUFFIXES))
