"""A share of the hostile inputs of `make hostile`, and that each of its rules can fail."""

import os
import time
from pathlib import Path

import hostile_runs
import pytest
from hostile_cases import Case, cases, lines, parsers, split
from hostile_runs import Bench
from programs import printed_by

from caster.cli.shared_arguments import InputPath
from mitsuba_ref.cli.arguments import ScenePath

HERE = Path(__file__).resolve().parent


@pytest.mark.parametrize(("seed", "share"), [(1, 8), (2, 112)])
@pytest.mark.slow("a hundred commands, each a process", keep=1)
def test_a_share_of_the_cases(seed, share):
    """Of other seeds than that of `make hostile`."""
    path = os.pathsep.join([str(each) for each in (HERE, HERE.parent, HERE.parents[1])])
    words = ("-m", "hostile_runs", "--seed", str(seed), "--count", str(share))
    assert f"{share} hostile inputs" in printed_by("-P", *words, PYTHONPATH=path)


def test_every_command_is_tried():
    tried = {(program, words[0]) for program, words in (split(line) for _, line in lines())}
    assert tried == set(parsers()), "a line of hostile_samples.py for each command"


def test_every_input_is_tried():
    """Each option and argument that names an input has a line with a file there."""
    tried = set()
    for _, line in lines():
        program, (name, *words) = split(line)
        given = vars(parsers()[program, name].parse_args(words))
        for dest, values in given.items():
            flat = values if isinstance(values, list) else [values]
            tried |= {(program, name, dest) for value in flat if isinstance(value, InputPath)}
    inputs = {
        (program, name, action.dest)
        for (program, name), parser in parsers().items()
        for action in parser._actions
        if action.type in (InputPath, ScenePath) and action.dest != "mesh_dir"
    }
    assert inputs <= tried, f"no line of hostile_samples.py names {inputs - tried}"


def test_a_seed_gives_the_same_cases_and_every_option_has_one():
    many = cases(3, 3000)
    assert many[:50] == cases(3, 50) and cases(4, 50) != cases(3, 50)
    options = {case.what for case in many if case.what.startswith("option ")}
    actions = [action for parser in parsers().values() for action in parser._actions if action.nargs != 0]
    known = {f"option {action.option_strings[-1]}" for action in actions if action.option_strings}
    assert options == known


# ---- each rule, broken


def traceback(words):
    raise_in_print = "Traceback (most recent call last):\n  File"
    print(raise_in_print)
    return 70


def changes_input(words):
    Path("in/scene.toml").write_text("changed")
    return 0


def writes_beside(words):
    Path("in/new").write_text("x")
    return 0


def leaves_scratch(words):
    Path("tmp/mitsuba-ref-scratch-x").mkdir()
    Path("out/.0123456789abcdef.part").write_text("x")
    return 0


def writes_half(words):
    Path("out/x.json").write_text('{"a": ')
    return 0


def sends_escapes(words):
    print("\x1b[2J")
    return 2


def takes_memory(words):
    held = bytearray(1_100_000_000)
    return len(held) % 2


def spins(words):
    end = time.process_time() + 1.4
    while time.process_time() < end:
        pass
    return 0


FAULTS = {
    "internal error": traceback,
    "changed or wrote among inputs: in/scene.toml": changes_input,
    "changed or wrote among inputs: in/new": writes_beside,
    "left behind": leaves_scratch,
    "half-written: out/x.json": writes_half,
    "control character": sends_escapes,
    "MB": takes_memory,
    "takes ": spins,
    "hangs": lambda words: time.sleep(60),
    "undocumented exit code": lambda words: 42,
    "fails without a word": lambda words: 2,
}


@pytest.fixture
def bench(tmp_path):
    made = object.__new__(Bench)
    made.folder, made.samples = tmp_path, tmp_path / "samples"
    for folder in ("in", "out"):
        (made.samples / folder).mkdir(parents=True)
    (made.samples / "in" / "scene.toml").write_text("x")
    return made


@pytest.mark.parametrize("says", FAULTS)
@pytest.mark.slow("one waits until a hang is ended, each starts a process", keep=6)
def test_a_command_that_breaks_a_rule_is_named(bench, says, monkeypatch):
    monkeypatch.setitem(hostile_runs.MAINS, "caster", FAULTS[says])
    monkeypatch.setattr(hostile_runs, "MAX_WALL_SECONDS", 8.0)
    monkeypatch.setattr(hostile_runs, "MAX_SECONDS", 1)
    (run,) = bench.run([Case(0, "caster", ("check", "in/scene.toml"))], 1)
    assert any(says in wrong for wrong in run.wrong), run.wrong


def test_a_command_that_breaks_none_is_good(bench, monkeypatch):
    monkeypatch.setitem(hostile_runs.MAINS, "caster", lambda words: print("not a scene") or 2)
    (run,) = bench.run([Case(0, "caster", ("check", "in/scene.toml"))], 1)
    assert run.wrong == () and run.code == 2 and run.said == "not a scene", run.said
