"""Path arguments of every command and option, which are enumerated so that new ones are covered."""

import argparse
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from outputs import unfolded

import caster.__main__
import mitsuba_ref.__main__
from caster.cli import COMMANDS
from caster.cli.application import build_parser
from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, _own_folder, output_file_unless_number
from caster.system import atomic_files
from caster.system.atomic_files import ScratchFolder, atomic_write, remove_temporaries
from mitsuba_ref.cli import COMMANDS as JUDGE_COMMANDS

PROGRAMS = {"caster": (caster.__main__.main, COMMANDS), "mitsuba-ref": (mitsuba_ref.__main__.main, JUDGE_COMMANDS)}
OUTPUT_TYPES = (OutputFile, output_file_unless_number)
NUMBERS = {int, float}


def parsers() -> Iterator[tuple[str, str, argparse.ArgumentParser]]:
    for program, (_, commands) in PROGRAMS.items():
        top = build_parser(program, "", commands, {})
        (sub,) = (each for each in top._actions if isinstance(each, argparse._SubParsersAction))
        yield from ((program, name, parser) for name, parser in sub.choices.items())


def valued(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [action for action in parser._actions if action.nargs != 0 and action.choices is None]


def is_input(action: argparse.Action) -> bool:
    return isinstance(action.type, type) and issubclass(action.type, InputPath)


def words(action: argparse.Action, path: str) -> list[str]:
    """An argument with this value; numbers where it takes several."""
    count = action.nargs if isinstance(action.nargs, int) else 1
    return [*action.option_strings[-1:], *["1"] * (count - 1), path]


def value_for(action: argparse.Action, folder: Path) -> str:
    """Some valid value of a required argument."""
    if is_input(action) or action.type in (*OUTPUT_TYPES, OutputFolder):
        return str(folder / f"other-{action.dest}.toml")
    return "1"


def pairs() -> Iterator[Any]:
    """Every input with every output file of the same command."""
    for program, name, parser in parsers():
        inputs = [action for action in valued(parser) if is_input(action)]
        outputs = [action for action in valued(parser) if action.type in OUTPUT_TYPES]
        for source in inputs:
            for output in outputs:
                yield pytest.param(
                    program, name, parser, source, output, id=f"{program}-{name}-{source.dest}-{output.dest}"
                )


ALIASES: dict[str, Callable[[Path], Path]] = {
    "itself": lambda path: path,
    "relative": lambda path: path.parent / "sub" / ".." / path.name,
    "symbolic": lambda path: linked(path, os.symlink),
    "hard": lambda path: linked(path, os.link),
}


def linked(path: Path, link: Callable[[Path, Path], None]) -> Path:
    name = path.parent / "alias"
    name.unlink(missing_ok=True)
    link(path, name)
    return name


@pytest.mark.parametrize(("program", "name", "parser"), [*parsers()])
def test_every_option_declares_whether_it_names_a_path(program, name, parser):
    for action in valued(parser):
        assert action.type is not None, (
            f"{program} {name} {action.dest}: expected type=InputPath, OutputFile, ... or str"
        )
        path_like = any(mark in str(action.metavar) for mark in ("FILE", "DIR", "PATH", "PNG", "IMAGE", ".exr"))
        if path_like:
            assert is_input(action) or action.type in (OutputFolder, *OUTPUT_TYPES), f"{program} {name} {action.dest}"


@pytest.mark.parametrize(("program", "name", "parser", "source", "output"), [*pairs()])
def test_no_output_is_an_input(program, name, parser, source, output, tmp_path, capsys):
    (tmp_path / "sub").mkdir()
    precious = tmp_path / "precious"
    required = [each for each in valued(parser) if each.required and each not in (source, output)]
    for group in parser._mutually_exclusive_groups:
        if group.required and not {source, output} & set(group._group_actions):
            required.append(group._group_actions[0])
    others = [words(action, value_for(action, tmp_path)) for action in required]
    for alias in ALIASES.values():
        precious.write_text("precious")
        given = [words(source, str(precious)), words(output, str(alias(precious))), *others]
        given.sort(key=lambda each: len(each) > 1)  # positional ones first
        argv = [name, *(word for each in given for word in each)]
        assert PROGRAMS[program][0](argv) == 2, argv
        assert "expected another path: it is an input" in capsys.readouterr().err
        assert precious.read_text() == "precious"


def test_a_scene_of_an_input_folder_is_no_output(tmp_path):
    (tmp_path / "a.toml").write_text("precious")
    argv = ["validate", str(tmp_path), "--json", str(tmp_path / "a.toml")]
    assert mitsuba_ref.__main__.main(argv) == 2
    assert (tmp_path / "a.toml").read_text() == "precious"


@pytest.mark.parametrize("name", ["mine.py", "run", "ours.exr", "a.obj"])
@pytest.mark.parametrize("option", ["--json", "--junit", "--write-expected", "--summary-md"])
def test_no_candidate_and_no_mesh_is_an_output(name, option, here, capsys):
    """As a module, a program, an image, and a mesh that the scene names."""
    Path(name).write_text("precious")
    candidate = "./run {mesh} {rays} {hits}" if name == "run" else "mine:trace" if name != "ours.exr" else name
    assert mitsuba_ref.__main__.main(["validate", "a.toml", "--candidate", candidate, option, name]) == 2
    assert "expected another path: it is an input" in unfolded(capsys.readouterr().err)
    assert Path(name).read_text() == "precious"


def test_two_outputs_are_two_files(tmp_path, capsys):
    argv = ["merge", str(tmp_path), "--json", str(tmp_path / "x"), "--junit", str(tmp_path / "." / "x")]
    assert mitsuba_ref.__main__.main(argv) == 2
    assert "expected a file other than that of --json" in capsys.readouterr().err


def test_a_folder_that_another_run_writes_into_is_refused_and_an_empty_one_is_removed(tmp_path, capsys):
    """A lock of another open file counts like that of another process."""
    out, missing = tmp_path / "out", str(tmp_path / "missing.toml")
    argv = ["validate", missing, "--out", str(out)]
    assert mitsuba_ref.__main__.main(argv) == 4 and not out.exists()
    out.mkdir()
    with _own_folder(out):
        assert mitsuba_ref.__main__.main(argv) == 4
    assert "another run writes into this folder" in capsys.readouterr().err and out.exists()


# ---- temporary files ----


def test_temporary_files_are_gone_after_use_and_at_a_forced_exit(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(atomic_files, "_temporaries", set())  # those of other tests stay
    with ScratchFolder() as folder, atomic_write(tmp_path / "x") as file:
        assert {path.name for path in tmp_path.iterdir()} == {Path(folder).name, file.name}
    assert [path.name for path in tmp_path.iterdir()] == ["x"]
    with ScratchFolder() as folder:
        remove_temporaries()
        assert not Path(folder).exists()
