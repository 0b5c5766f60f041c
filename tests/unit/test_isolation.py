"""What ends the process of a scene is a row with its name; the other scenes are judged, and every file is written."""

import ctypes
import json
import os
import signal
import threading
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from verdict_factory import scene as made

from mitsuba_ref.__main__ import main
from mitsuba_ref.runner import isolation, many_scenes
from mitsuba_ref.runner.isolation import Isolated, ResultNotSent, WorkerEnded

SCENE = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\n'


def crash():
    ctypes.string_at(0)


def allocate():
    raise MemoryError("Unable to allocate 9 TiB")


ENDS = {
    "segfault": (crash, "the process that casts and judges ended: SIGSEGV"),
    "exit": (lambda: os._exit(3), "the process that casts and judges ended: exit code 3"),
    "killed": (lambda: os.kill(os.getpid(), signal.SIGKILL), "the process that casts and judges ended: SIGKILL"),
    "memory": (allocate, "cannot be judged: not enough memory: Unable to allocate 9 TiB"),
    "hang": (lambda: time.sleep(60), "the process that casts and judges ended: killed after 1 s without an answer"),
}


@pytest.fixture
def judging(tmp_path, monkeypatch):
    """Scenes named after how they end, two of which pass; forks judge them."""
    monkeypatch.chdir(tmp_path)
    Path("scenes").mkdir()
    for name in ("a", *ENDS, "z"):
        Path(f"scenes/{name}.toml").write_text(SCENE)

    def validate(scene, name, path, **options):
        ENDS.get(name, (lambda: None,))[0]()
        return made(name)

    monkeypatch.setattr(many_scenes, "validate_scene", validate)
    monkeypatch.setattr(many_scenes.ISOLATED, "seconds", 1.0)


@pytest.mark.parametrize("workers", ["1", "3"])
def test_every_end_is_a_row_and_the_rest_is_judged(judging, capsys, workers, tmp_path):
    words = ["--json", "v.json", "--junit", "j.xml", "--html", "report"]
    assert main(["validate", "scenes", "-j", workers, *words]) == 1
    out = capsys.readouterr().out
    found = {scene["name"]: scene for scene in json.loads(Path("v.json").read_text())["scenes"]}
    assert list(found) == sorted(("a", *ENDS, "z"))
    assert found["a"]["ok"] and found["z"]["ok"]
    for name, (_, problem) in ENDS.items():
        assert found[name]["problem"].splitlines()[0] == problem
        assert not found[name]["ok"] and f"FAIL  {name}  {problem}" in out
    assert "test_isolation.py" in found["segfault"]["problem"]  # the calls that led there
    cases = {case.get("name"): case for case in ElementTree.parse("j.xml").iter("testcase")}
    assert {name for name, case in cases.items() if len(case)} >= set(ENDS) and Path("report/index.html").exists()


def test_a_fork_serves_many_calls_and_a_dead_one_is_replaced():
    isolated = Isolated(lambda action: action())
    with isolated.kept():
        first = isolated(_pid)
        assert first != os.getpid() and isolated(_pid) == first
        os.kill(first, signal.SIGKILL)
        os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
        second = isolated(_pid)
        assert second not in (first, os.getpid())
        with pytest.raises(WorkerEnded, match="SIGSEGV"):
            isolated(crash)
        with pytest.raises(ZeroDivisionError):
            isolated(_divide)
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)


def test_nothing_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(isolation.tempfile, "tempdir", str(tmp_path))
    isolated = Isolated(lambda action: action())
    with isolated.kept(), pytest.raises(WorkerEnded):
        isolated(_leave_a_file)
    assert list(tmp_path.iterdir()) == []


def _pid():
    return os.getpid()


def _divide():
    return 1 // 0


def _leave_a_file():
    Path(isolation.tempfile.mkdtemp(), "file").write_text("left")
    crash()


def test_a_result_without_a_pickle_is_a_mistake_of_this_package_not_a_crash_of_a_scene(capfd):
    isolated = Isolated(lambda action: action())
    with isolated.kept():
        with pytest.raises(ResultNotSent, match=r"cannot pickle '_thread\.lock' object"):
            isolated(threading.Lock)
        assert isolated(int) == 0
    assert capfd.readouterr().err == ""
