"""Signals end every command in the same way and leave nothing behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import ROOT
from programs import python

from caster.system import process

COMMAND = """
import hashlib, sys, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from caster.system import process
from caster.cli.application import Command, main
from caster.system.atomic_files import ScratchFolder, atomic_write
process.GRACE_SECONDS = 0.5
def add_arguments(add):
    add("what", str, choices=("threads", "orderly", "done"))
def endless():
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)  # without the interpreter's lock, and not to be interrupted
def run(args):
    if args.what == "done":
        Path("ready").touch()
        return 0
    with ScratchFolder(), atomic_write("out.txt"):
        Path("ready").touch()
        if args.what == "threads":
            with ThreadPoolExecutor(1) as pool:
                pool.submit(endless).result()
        try:
            time.sleep(60)
        finally:
            Path("kept").touch()
sys.modules["command"] = sys.modules["__main__"]
main("program", "", [Command("go", "", "command")], {}, None)
time.sleep(60)  # as the interpreter may wait for threads
"""


def started(folder: Path, what: str) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "go", what],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder), "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 30.0
    while not (folder / "ready").exists():
        assert child.poll() is None and time.monotonic() < deadline, child.stderr and child.stderr.read()
        time.sleep(0.01)
    return child


@pytest.mark.parametrize(
    ("what", "number"), [("threads", signal.SIGTERM), ("threads", signal.SIGHUP), ("orderly", signal.SIGINT)]
)
def test_a_signal_ends_the_command_in_time_without_leftovers(what, number, tmp_path):
    child = started(tmp_path, what)
    child.send_signal(number)
    _, err = child.communicate(timeout=5.0)
    assert child.returncode == 130
    assert "interrupted" in err and "Traceback" not in err
    assert {path.name for path in tmp_path.iterdir()} <= {"ready", "kept"}
    assert (tmp_path / "kept").exists() == (what == "orderly")


def test_a_second_signal_ends_the_command_at_once(tmp_path):
    child = started(tmp_path, "threads")
    begin = time.monotonic()
    child.send_signal(signal.SIGTERM)
    time.sleep(0.05)
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=5.0)
    assert (child.returncode, time.monotonic() - begin < 0.4) == (130, True)


def test_a_signal_after_the_command_shows_no_traceback(tmp_path):
    child = started(tmp_path, "done")
    time.sleep(0.3)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=5.0)
    assert (child.returncode, err) == (-signal.SIGINT, "")


@pytest.mark.parametrize("words", ["caster check", "mitsuba_ref validate --candidate mine:trace --size 4 4"])
def test_a_closed_standard_output_is_no_error(words, tmp_path):
    (tmp_path / "mine.py").write_text(
        "import caster\ndef trace(scene, o, d):\n    hits = caster.cast(scene, o, d)\n    return hits.t, hits.normal\n"
    )
    command = f"{sys.executable} -P -m {words} {ROOT}/scenes/one-sphere.toml >&-"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
    assert done.returncode == 0 and b"Traceback" not in done.stderr, done.stderr


def test_an_ignored_signal_stays_ignored():
    """nohup starts a command with SIGHUP ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with process.handled_signals():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_child_of_a_dead_parent_ends():
    """The parent may end before the child has asked for its death signal."""
    source = "from caster.system.process import die_with_parent; die_with_parent(); print('lives')"
    found = {}
    for parent in (os.getpid(), 1):
        found[parent] = python("-c", source, **{process.PARENT_VARIABLE: str(parent)}).stdout
    assert found == {os.getpid(): "lives\n", 1: ""}
