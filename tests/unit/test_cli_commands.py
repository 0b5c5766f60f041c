"""The commands as a whole: their help, small commands, and how they end."""

import io
import os
import signal
import subprocess
import sys
import time

import pytest
from places import ROOT

import caster
from caster.__main__ import main
from caster.cli import COMMANDS
from caster.description.errors import FileMissing, SceneError
from caster.system import process
from mitsuba_ref.cli import COMMANDS as JUDGE_COMMANDS

SLOW = {"numba", "PIL", "llvmlite", "mitsuba", "drjit"}
PROGRAMS = [
    ("caster", "caster", COMMANDS, SLOW | {"OpenEXR", "numpy", "pydantic", "pydantic_core", "rich"}),
    ("mitsuba_ref", "mitsuba-ref", JUDGE_COMMANDS, SLOW),
]


def python(*argv, **options):
    environment = {"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"], "CASTER_JIT": "0"}
    return subprocess.Popen(
        [sys.executable, *argv], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


# ---- help ----


@pytest.mark.parametrize(("module", "program", "commands", "slow"), PROGRAMS, ids=["caster", "mitsuba-ref"])
def test_help_of_every_command_loads_nothing_slow(module, program, commands, slow):
    source = (
        f"import sys; from {module}.__main__ import main; "
        "print([main([n, '--help']) for n in sys.argv[1:]], *sys.modules)"
    )
    out, err = python("-c", source, *(command.name for command in commands)).communicate()
    codes, modules = out.splitlines()[-1].split("] ")
    assert (set(codes), err) == (set("[0, "), "") and out.count(f"usage: {program} ") == len(commands)
    assert not slow & {loaded.partition(".")[0] for loaded in modules.split()}


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"caster {caster.__version__}\n"


# ---- how a command ends ----


def failing(error):
    def command():
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (SceneError("s.toml:1:1: no"), 2, "s.toml:1:1: no\n"),
        (FileMissing("no.toml: no"), 4, "no.toml: no\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (MemoryError("Unable to allocate 64. GiB"), 2, "not enough memory: Unable to allocate 64. GiB\n"),
        (MemoryError(), 2, "not enough memory\n"),
        (PermissionError(13, "Permission denied", "x"), 4, "x: Permission denied\n"),
        (OSError(28, "No space left on device"), 4, "No space left on device (a file without a name; "),
        (SystemExit(2), 2, ""),
        (SystemExit(0), 0, ""),
        (SystemExit(None), 0, ""),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_an_error_that_was_foreseen_is_one_sentence(capsys, error, code, said):
    assert process.run_command(failing(error)) == code
    told = capsys.readouterr()
    assert told.out == "" and told.err.startswith(said) and "Traceback" not in told.err
    assert told.err.count("\n") == (1 if said else 0)


def test_an_error_that_was_not_shows_a_traceback_and_one_line(capsys):
    assert process.run_command(failing(ZeroDivisionError("division by zero"))) == 70
    told = capsys.readouterr().err.splitlines()
    assert told[0] == "Traceback (most recent call last):"
    assert told[-1] == "internal error, please report it: ZeroDivisionError: division by zero"


def test_a_reader_that_goes_away_is_no_news():
    started = python("-m", "caster", "schema")
    started.stdout.close()  # before anything was written
    assert (started.wait(), started.stderr.read()) == (process.PIPE_CLOSED, "")
    started.stderr.close()


def test_a_full_device_is_reported(capfd):
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "caster", "schema"],
            cwd=ROOT,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (run.returncode, run.stderr) == (4, "standard output: No space left on device\n")


def test_a_name_the_terminal_cannot_show_is_escaped(monkeypatch):
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", terminal)
    assert main(["check", "b\u00e4lle.toml"]) == 4
    terminal.flush()
    assert terminal.buffer.getvalue().startswith(rb"b\xe4lle.toml: cannot read this scene file")


def test_an_interrupted_render_leaves_nothing_and_ends_with_130(tmp_path):
    """Plain Python needs minutes for this film; the signal comes when the work has begun."""
    (tmp_path / "s.toml").write_text(
        '[film]\nwidth = 2048\nheight = 2048\n[camera]\ntype = "panorama"\neye = [0, 0, 0]\n'
        'direction = [0, 0, 1]\n[[shape]]\ntype = "teapot"\n'
    )
    source = (
        "import sys, caster.rendering.images as f; from caster.__main__ import main\n"
        "shoot = f.generate_camera_rays\n"
        "def announced(*a):\n    print('begun', flush=True)\n    return shoot(*a)\n"
        "f.generate_camera_rays = announced\n"
        "sys.exit(main(['render', 's.toml', '--threads', '1']))"
    )
    process = python("-c", source, cwd=tmp_path)
    assert process.stdout.readline() == "begun\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "interrupted\n")
    assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]
