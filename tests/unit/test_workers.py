"""A scene whose process ends is a failing row; the other scenes are judged, and every file is written."""

import ctypes
import os
import signal
import tempfile
import threading
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from outputs import json_of, unfolded
from verdict_factory import scene as made

from caster.system.cluster import CallEnded
from mitsuba_ref.__main__ import main
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.runner import many_scenes
from mitsuba_ref.runner.workers import Workers

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


def test_every_end_is_a_row_and_the_rest_is_judged(here, monkeypatch, capsys):
    """Scenes named after how they end, two of which pass."""
    Path("scenes").mkdir()
    for name in ("a", *ENDS, "z"):
        Path(f"scenes/{name}.toml").write_text(SCENE)

    def validate(task, **options):
        ENDS.get(task.name, (lambda: None,))[0]()
        return made(task.name)

    monkeypatch.setattr(many_scenes, "validate_scene", validate)
    monkeypatch.setattr("mitsuba_ref.runner.validation_run.CALL_TIMEOUTS", 1.0 / DEFAULT_TIMEOUT)
    words = ["--json", "v.json", "--junit", "j.xml", "--html", "report"]
    assert main(["validate", "scenes", "-j", "3", *words]) == 1
    out = unfolded(capsys.readouterr().out)
    found = {scene["name"]: scene for scene in json_of("v.json")["scenes"]}
    assert list(found) == sorted(("a", *ENDS, "z"))
    assert found["a"]["ok"] and found["z"]["ok"]
    for name, (_, problem) in ENDS.items():
        assert found[name]["problem"].splitlines()[0] == problem
        assert not found[name]["ok"] and f"FAIL {name} {problem}" in out
    assert "test_workers.py" in found["segfault"]["problem"]  # the calls that led there
    cases = {case.get("name"): case for case in ElementTree.parse("j.xml").iter("testcase")}
    assert {name for name, case in cases.items() if len(case)} >= set(ENDS) and Path("report/index.html").exists()


def test_a_worker_serves_many_calls_and_a_dead_one_is_replaced():
    with Workers() as pool:
        first = pool.call(os.getpid)
        assert first != os.getpid() and pool.call(os.getpid) == first
        os.kill(first, signal.SIGKILL)
        os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
        second = pool.call(os.getpid)
        assert second not in (first, os.getpid())
        with pytest.raises(CallEnded, match="SIGSEGV"):
            pool.call(crash)
        with pytest.raises(ZeroDivisionError):
            pool.call(divmod, 1, 0)
        with pytest.raises(TypeError, match=r"cannot pickle '_thread\.lock' object"):
            pool.call(threading.Lock)
        third = pool.call(os.getpid)
    for pid in (second, third):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def leave_a_file():
    Path(tempfile.mkdtemp(), "file").write_text("left")
    crash()


def test_nothing_is_left_behind_and_stopped_calls_end(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Workers() as pool:
        with pytest.raises(CallEnded):
            pool.call(leave_a_file)
        threading.Timer(0.5, pool.stop).start()
        begin = time.monotonic()
        with pytest.raises(CallEnded):
            pool.call(time.sleep, 60)
        with pytest.raises(CallEnded, match="before it began"):
            pool.call(os.getpid)
    assert time.monotonic() - begin < 10 and list(tmp_path.iterdir()) == []
