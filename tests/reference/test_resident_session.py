"""A Mitsuba process that stays: whatever becomes of it, every request has the response of a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write

from mitsuba_ref.__main__ import main
from mitsuba_ref.reference import messages, mitsuba_process, subprocess_runner
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import ResidentSession

ROOT = Path(__file__).resolve().parents[2]
FAULTY = """
import os, signal, sys, time
from pathlib import Path
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.subprocess_runner import serve
pipe = int(sys.argv[-1])
def faulty(folders):
    for number, folder in enumerate(folders, 1):
        if number == {at}:
            {fault}
        yield from mitsuba_process.replies([folder])
serve(faulty, pipe, 60)
"""
FAULTS = {
    "abort": "print('LLVM ERROR', flush=True); os.abort()",
    "killed": "os.kill(os.getpid(), signal.SIGKILL)",
    "quiet end": "os._exit(0)",
    "bytes that are no text": "os.write(pipe, b'\\xff\\xfe\\n')",
    "a line too many": "os.write(pipe, b'noise\\n')",
    "noise without end": "os.write(pipe, b'x' * 5000000)",
    "another request": "os.write(pipe, b'done /elsewhere\\n')",
    "no response": "os.write(pipe, f'done {folder}\\n'.encode())",
    "half a response": (
        "mitsuba_process.main(Path(folder)); file = Path(folder, 'answer.npz'); "
        "file.write_bytes(file.read_bytes()[:-200]); os.write(pipe, f'done {folder}\\n'.encode())"
    ),
    "refusal": "os.write(pipe, f'refused {folder}\\n'.encode())",
}


@pytest.fixture(autouse=True)
def residents_of_this_test_alone(monkeypatch):
    mitsuba_process.close_residents()
    monkeypatch.setattr(subprocess_runner, "_running", set())  # other tests' processes stay
    yield
    mitsuba_process.close_residents()
    assert not subprocess_runner._running


@pytest.fixture
def plant(monkeypatch):
    """Have each resident process do something else when it gets its request number `at`, from 1."""

    def planted(fault: str, at: int = 2) -> None:
        program = FAULTY.format(fault=fault, at=at)
        monkeypatch.setattr(messages, "CHILD_COMMAND", (sys.executable, "-c", program))

    return planted


@pytest.fixture
def alone(monkeypatch) -> list[TraceRequest]:
    """Requests that got a process of their own."""
    sent: list[TraceRequest] = []
    send = mitsuba_process.send_alone

    def noted(request, timeout):
        sent.append(request)
        return send(request, timeout)

    monkeypatch.setattr(mitsuba_process, "send_alone", noted)
    return sent


def balls(tmp_path: Path, count: int) -> list[TraceRequest]:
    """Requests whose responses differ: spheres farther and farther away."""
    requests = []
    for i in range(count):
        folder = tmp_path / str(i)
        folder.mkdir()
        xml = write(folder, shape("sphere", f"ball{i}", 0))
        requests.append(job(xml, "scalar_rgb", [[0, 0, 5 + i], [9, 0, 5]], [[0, 0, -1], [0, 0, -1]]))
    return requests


def check_right(responses) -> None:
    for i, response in enumerate(responses):
        assert isinstance(response, TraceResponse), response
        assert response.t.tolist() == [4.0 + i, np.inf] and response.names == [f"ball{i}"]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.slow("each starts Mitsuba three times", keep=2)
def test_a_fault_amid_many_requests_loses_nothing(tmp_path, plant, alone, fault):
    plant(FAULTS[fault])
    requests = balls(tmp_path, 3)
    check_right([mitsuba_process.send_request(each, 60) for each in requests])
    assert alone == requests[1:2]


@pytest.mark.slow("waits for a time-out")
def test_a_hang_is_killed_at_the_time_out_and_loses_nothing(tmp_path, plant, alone):
    plant("time.sleep(600)")
    requests = balls(tmp_path, 3)
    first = mitsuba_process.send_request(requests[0], 60)
    begin = time.monotonic()
    second = mitsuba_process.send_request(requests[1], 6)
    assert 6 <= time.monotonic() - begin < 20
    check_right([first, second, mitsuba_process.send_request(requests[2], 60)])
    assert alone == requests[1:2]


def test_what_a_scene_makes_of_every_process_is_its_result(tmp_path, monkeypatch):
    """A crash that the scene causes is told of the process of its own; a later scene is answered."""
    (tmp_path / "mitsuba.py").write_text("import os; print('LLVM ERROR: Cannot', flush=True); os.abort()")
    first, second = balls(tmp_path, 2)
    with monkeypatch.context() as planted:
        planted.setenv("PYTHONPATH", str(tmp_path))
        found = mitsuba_process.send_request(first, 60)
    assert isinstance(found, Crash) and (found.kind, found.output) == ("abort", "LLVM ERROR: Cannot")
    assert mitsuba_process.send_request(second, 60).t.tolist() == [5.0, np.inf]


def test_one_process_serves_many_scenes_of_its_variant_also_after_a_refusal(tmp_path, alone):
    requests = balls(tmp_path, 2)
    broken = job(tmp_path / "missing.xml", "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])
    with ResidentSession() as resident:
        check_right([resident.send(requests[0])])
        pid = resident.processes["scalar_rgb"].process.pid
        refused = resident.send(broken)
        assert isinstance(refused, Crash) and "file does not exist" in refused.output and alone == [broken]
        assert resident.send(requests[1]).t[0] == 5.0
        assert resident.processes["scalar_rgb"].process.pid == pid


def test_another_environment_gets_another_process(tmp_path, monkeypatch, alone):
    """Its settings, such as libLLVM's path, are those of the time when the request is made."""
    request = balls(tmp_path, 1)[0]
    pids = set()
    with ResidentSession() as resident:
        for value in ("a", "a", "b"):
            monkeypatch.setenv("DRJIT_LIBLLVM_PATH", value)
            check_right([resident.send(request)])
            pids.add(resident.processes["scalar_rgb"].process.pid)
    assert len(pids) == 2 and not alone


def test_another_test_of_pytest_gets_the_same_process(tmp_path, monkeypatch, alone):
    request = balls(tmp_path, 1)[0]
    pids = set()
    with ResidentSession() as resident:
        for name in ("test_a (call)", "test_b (setup)"):
            monkeypatch.setenv("PYTEST_CURRENT_TEST", name)
            check_right([resident.send(request)])
            pids.add(resident.processes["scalar_rgb"].process.pid)
    assert len(pids) == 1 and not alone


def test_a_process_that_has_grown_or_has_nothing_to_do_ends_and_is_replaced(tmp_path, plant, alone):
    requests = balls(tmp_path, 4)
    for fault in ("mitsuba_process.RESIDENT_BYTES = 1", "sys.stdin.close(); pipe = None"):
        plant(fault, at=2)
        with ResidentSession() as resident:
            check_right([resident.send(each) for each in requests])


def test_without_requests_a_process_ends_by_itself(tmp_path):
    serve = "from mitsuba_ref.reference.subprocess_runner import serve"
    program = f"{serve}; import sys; serve(iter, int(sys.argv[1]), 0.2)"
    with subprocess_runner.ResidentProcess([sys.executable, "-c", program]) as process:
        assert process.request("hello", 30) == "hello"
        assert process.process.wait(30) == 0 and not process.alive


def test_noise_on_stdout_stays_out(tmp_path, plant, alone, capfd):
    plant("print('noise ' * 100000); os.system('echo more noise')", at=1)
    check_right([mitsuba_process.send_request(each, 60) for each in balls(tmp_path, 2)])
    assert capfd.readouterr() == ("", "") and not alone


def test_a_fork_has_residents_of_its_own(tmp_path):
    """It neither uses nor ends those of the process that it comes from."""
    requests = balls(tmp_path, 2)
    check_right([mitsuba_process.send_request(requests[0], 60)])
    (pid,) = subprocess_runner._running
    child = os.fork()
    if child == 0:
        code = 1
        try:
            own = mitsuba_process.send_request(requests[0], 60).t.tolist() == [4.0, np.inf]
            code = 0 if own and pid not in subprocess_runner._running else 2
            subprocess_runner.kill_subprocesses()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert mitsuba_process.send_request(requests[1], 60).t[0] == 5.0
    assert subprocess_runner._running == {pid}


ASK = """
import sys, time
from pathlib import Path
from mitsuba_ref.reference import mitsuba_process, subprocess_runner
mitsuba_process.send_request(mitsuba_process.TraceRequest.read(Path(sys.argv[1])), 60)
print(*subprocess_runner._running, flush=True)
time.sleep(float(sys.argv[2]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it ends once it has nothing to do")
@pytest.mark.parametrize("how", [None, signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.slow("each starts Mitsuba, and ends it", keep=1)
def test_a_resident_goes_with_its_parent(tmp_path, how):
    balls(tmp_path, 1)[0].write(tmp_path)
    words = [sys.executable, "-c", ASK, tmp_path, "600" if how else "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT) as parent:
        pid = int(parent.stdout.readline())
        if how:
            parent.send_signal(how)
    deadline = time.monotonic() + 30
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path(f"/proc/{pid}").exists()


SCENES = ("one-sphere", "cylinders", "triangles", "orthographic")


def verdicts(tmp_path: Path) -> list[dict]:
    files = [str(ROOT / "scenes" / f"{name}.toml") for name in SCENES]
    assert main(["validate", *files, "--size", "24", "20", "-j", "1", "--json", str(tmp_path / "v.json")]) == 0
    found = json.loads((tmp_path / "v.json").read_text())["scenes"]
    times = ("seconds", "reference_seconds", "exact_seconds")
    return [{name: value for name, value in scene.items() if name not in times} for scene in found]


@pytest.fixture(scope="module")
def verdicts_without_residents(tmp_path_factory) -> list[dict]:
    """Each scene with a process of its own."""
    with pytest.MonkeyPatch.context() as residents_fail:
        residents_fail.setattr(messages, "CHILD_COMMAND", (sys.executable, "-c", "raise SystemExit(1)"))
        return verdicts(tmp_path_factory.mktemp("alone"))


@pytest.mark.parametrize("at", [1, 2, 3])
@pytest.mark.slow("each starts Mitsuba three times")
def test_verdicts_are_equal_when_the_resident_dies_at_any_scene(tmp_path, plant, verdicts_without_residents, at):
    plant("os.kill(os.getpid(), signal.SIGKILL)", at)
    assert verdicts(tmp_path) == verdicts_without_residents
