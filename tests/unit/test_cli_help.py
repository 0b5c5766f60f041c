"""Names and defaults in --help, which loads nothing slow, are those of the modules."""

import shlex
import subprocess
import sys

import pytest

import caster.__main__
import caster.cli
import mitsuba_ref.__main__
import mitsuba_ref.cli
from caster.aovs import BY_NAME
from caster.cli.application import build_parser
from caster.cli.shared_arguments import AOV_NAMES, DEFAULT_AOV_LIST
from caster.rendering.images import DEFAULT_AOVS
from mitsuba_ref.cli import arguments
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.rendering import REFERENCE_AOVS
from mitsuba_ref.subjects import subject

PROGRAMS = {
    "caster": (caster.__main__.main, caster.cli.COMMANDS),
    "mitsuba-ref": (mitsuba_ref.__main__.main, mitsuba_ref.cli.COMMANDS),
}


def test_names_and_defaults_in_help_are_those_of_the_modules_that_are_loaded_later():
    assert AOV_NAMES.split(", ") == list(REFERENCE_AOVS) == list(BY_NAME)
    assert ",".join(DEFAULT_AOVS) == DEFAULT_AOV_LIST
    assert arguments.CANDIDATE_SECONDS == subject.DEFAULT_SECONDS
    assert arguments.REFERENCE_SECONDS == mitsuba_process.DEFAULT_TIMEOUT
    assert tuple(subject.PRECISIONS) == arguments.PRECISIONS


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_of_each_command_fits_a_terminal_and_has_an_example_that_it_accepts(program, capsys):
    main, commands = PROGRAMS[program]
    for command in commands:
        assert main([command.name, "--help"]) == 0
        printed = capsys.readouterr().out.splitlines()
        assert max(map(len, printed)) <= 80 and f"  {command.example}" in printed
        name, *words = shlex.split(command.example.partition(" > ")[0])
        parser = build_parser(program, "", commands, {}, [command.name])
        assert name == program and parser.parse_args(words).run


@pytest.mark.parametrize("words", [["validate"], ["probe", "scene.toml", "1", "2"], ["fuzz"], ["bench"]], ids=" ".join)
def test_a_command_that_loads_for_long_says_so_before_it_loads_anything(words, tmp_path):
    """NumPy cannot be imported here, so whatever is printed was printed before."""
    code = "import sys; sys.modules['numpy'] = None; sys.argv[1:] = {!r}; from mitsuba_ref.__main__ import main; main()"
    command = [sys.executable, "-c", code.format(words)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert run.stdout == "" and run.stderr.startswith(f"mitsuba-ref {words[0]}: loading "), run.stderr
