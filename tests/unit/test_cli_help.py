"""Names and defaults in --help, which loads nothing slow, are those of the modules."""

import subprocess
import sys

import pytest

from caster.aovs import BY_NAME
from caster.cli.shared_arguments import AOV_NAMES, DEFAULT_AOV_LIST
from caster.rendering.images import DEFAULT_AOVS
from mitsuba_ref.cli import arguments
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.rendering import REFERENCE_AOVS
from mitsuba_ref.subjects import subject


def test_names_and_defaults_in_help_are_those_of_the_modules_that_are_loaded_later():
    assert AOV_NAMES.split(", ") == list(REFERENCE_AOVS) == list(BY_NAME)
    assert ",".join(DEFAULT_AOVS) == DEFAULT_AOV_LIST
    assert arguments.CANDIDATE_SECONDS == subject.DEFAULT_SECONDS
    assert arguments.REFERENCE_SECONDS == mitsuba_process.DEFAULT_TIMEOUT
    assert tuple(subject.PRECISIONS) == arguments.PRECISIONS


@pytest.mark.parametrize("words", [["validate"], ["probe", "scene.toml", "1", "2"], ["fuzz"], ["bench"]], ids=" ".join)
def test_a_command_that_loads_for_long_says_so_before_it_loads_anything(words, tmp_path):
    """NumPy cannot be imported here, so whatever is printed was printed before."""
    code = "import sys; sys.modules['numpy'] = None; sys.argv[1:] = {!r}; from mitsuba_ref.__main__ import main; main()"
    command = [sys.executable, "-c", code.format(words)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert run.stdout == "" and run.stderr.startswith(f"mitsuba-ref {words[0]}: loading "), run.stderr
