"""What --help says without loading anything slow, compared with what there really is."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from caster.aovs import BY_NAME
from caster.cli.shared_arguments import AOV_NAMES, DEFAULT_AOV_LIST
from caster.rendering.images import DEFAULT_AOVS
from mitsuba_ref.cli import COMMANDS as REFERENCE_COMMANDS
from mitsuba_ref.cli import exr_comparison, options, scene_exchange
from mitsuba_ref.exr_compare import approved
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.rendering import REFERENCE_AOVS
from mitsuba_ref.subjects import subject

ROOT = Path(__file__).resolve().parents[2]


def test_the_aovs_that_help_names_are_those_of_the_registry():
    assert AOV_NAMES.split(", ") == list(BY_NAME)


def test_the_reference_gives_every_aov_there_is():
    assert scene_exchange.KNOWN_AOVS == list(REFERENCE_AOVS) == list(BY_NAME)


def test_both_renderers_write_the_same_channels_by_default():
    assert DEFAULT_AOV_LIST == scene_exchange.DEFAULT_AOV_LIST == ",".join(DEFAULT_AOVS)


def test_every_default_exists():
    assert set(re.split(",", DEFAULT_AOV_LIST)) <= set(BY_NAME)


def test_the_modes_of_approval_are_those_of_its_table():
    assert exr_comparison.MODES == approved.MODES


def test_a_candidate_gets_the_seconds_and_has_the_precisions_that_help_names():
    assert options.CANDIDATE_SECONDS == subject.DEFAULT_SECONDS
    assert options.REFERENCE_SECONDS == mitsuba_process.DEFAULT_TIMEOUT
    assert tuple(subject.PRECISIONS) == options.PRECISIONS


LOADING = {command.name: command for command in REFERENCE_COMMANDS if command.starts_with}
FIRST_WORDS = {name: [name] for name in LOADING} | {
    "approve": ["approve", "scene.toml", "--references", "refs"],
    "check": ["check", "scene.toml", "--references", "refs"],
    "candidate": ["validate", "--candidate", "package.module:function"],
    "probe": ["probe", "scene.toml", "1", "2"],
    "judge": ["judge", "--scene", "scene.toml", "--rays", "r.npz", "--hits", "h.npz"],
}


@pytest.mark.parametrize("words", FIRST_WORDS.values(), ids=FIRST_WORDS)
def test_a_command_that_loads_for_long_says_so_before_it_loads_anything(words, tmp_path):
    """numpy cannot be imported here, so that whatever is said was said before."""
    code = "import sys; sys.modules['numpy'] = None; sys.argv[1:] = {!r}; from mitsuba_ref.__main__ import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code.format(words)], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert run.stdout == "" and run.stderr.startswith(f"mitsuba-ref {words[0]}: loading "), run.stderr


def test_the_commands_that_judge_are_among_those_that_say_so():
    assert {"validate", "judge", "probe", "fuzz", "stress", "bench", "approve", "check"} <= set(LOADING)


def test_a_process_of_one_command_starts_no_threads_of_blas_and_collects_seldom():
    """In a program that calls `main` with words of its own, nothing of this is changed."""
    code = (
        "import gc, os, sys; sys.path[:0] = [{root!r}]; from caster.__main__ import main\n"
        "assert 'numpy' not in sys.modules, 'threads start as NumPy is loaded'\n"
        "os.environ.pop('OPENBLAS_NUM_THREADS', None); sys.argv = ['caster', '--version']\n"
        "first = gc.get_threshold(); main({given})\n"
        "print(gc.get_threshold() == first, os.environ.get('OPENBLAS_NUM_THREADS'))"
    )
    for given, expected in (("", "False 1"), ("['--version']", "True None")):
        words = [sys.executable, "-c", code.format(root=str(ROOT), given=given)]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == expected
